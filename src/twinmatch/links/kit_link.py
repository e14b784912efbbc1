"""Host side of a Temperature Control Lab: commands and readings, through the process that holds its port."""

from __future__ import annotations

import contextlib
import importlib.util
import math
import os
import select
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

from twinmatch.errors import TwinmatchError


class KitError(TwinmatchError):
    """The kit or the link to it failed."""


class KitAbsentError(KitError):
    """No kit was found: the package or the port is missing, or another device is on the port."""


class KitSilentError(KitError):
    """The heaters were switched off because no command came in time."""


class KitReading(NamedTuple):
    """A kit's answer to a command."""

    first: float
    """Temperature T1, °C."""
    second: float
    """Temperature T2, °C."""
    power: float
    """Set power of heater 1, %."""
    other: float
    """Set power of heater 2, %."""


def require_package() -> None:
    """Check that the package `tclab` is installed.

    Raises:
        KitAbsentError: it is not.
    """
    if importlib.util.find_spec("tclab") is None:
        raise KitAbsentError(
            "kit: the package tclab is not installed; pip install 'twinmatch[tclab]'"
        )


def require_port(port: str) -> None:
    """Check that a port is a serial port.

    Raises:
        KitAbsentError: it does not exist, or is not a serial port.
    """
    try:
        device = stat.S_ISCHR(Path(port).stat().st_mode)
    except OSError as error:
        raise KitAbsentError(
            f"kit at {port}: {error.strerror}; is it plugged in, and is the port right?"
        ) from error
    if not device:
        raise KitAbsentError(
            f"kit at {port}: this is not a serial port; give another --port"
        )


def is_pseudo_terminal(port: str) -> bool:
    """Whether there is a program at the other end, such as the virtual kit, and no board that restarts."""
    return os.path.realpath(port).startswith("/dev/pts/")


class KitLink:
    """One kit; to be opened, driven and closed from one thread."""

    _START: Final = 20.0
    """Longest start, s: the package waits 2 s at each of two speeds."""
    _ANSWER: Final = 3.0
    """Longest wait for an answer, s; the process gives up on the kit earlier."""
    _ANSWER_OF_PROGRAM: Final = 10.0
    """Longest wait for an answer where a program is in place of the kit, s; a command is four requests, each
    with two tries of 1 s."""
    _ANSWER_IN_STEP: Final = 30.0
    """Longest wait for an answer of a virtual kit in step, which may be suspended, s."""
    _DEADLINE_IN_STEP: Final = 12.0
    """Time after which the process gives up on a kit in step, s."""
    _END: Final = 4.0
    """Longest wait for the end of the process, s: its three attempts to switch off take 3 s with a kit."""
    _SHORT: Final = 0.005
    """Wait for an answer of a kit in step, s."""

    def __init__(self, port: str, deadline: float = 1.0) -> None:
        """An empty `port` is the first on the USB bus; heaters go off `deadline` s after the last command.

        Raises:
            KitAbsentError: the package `tclab` is not installed.
        """
        require_package()
        self.port = port
        self.firmware = ""
        self.plant_time: Callable[[], object] | None = None
        """Called while an answer of a virtual kit in step is awaited, to let a moment of plant time pass."""
        self._wanted = port
        self._deadline = deadline
        self.keeper: subprocess.Popen[bytes] | None = None
        """The process that holds the port, and switches the heaters off once this one is silent or gone; None
        while it is not open."""
        self._heard = b""

    @property
    def is_open(self) -> bool:
        """Whether there is a process that holds the port."""
        return self.keeper is not None

    def open(self) -> None:
        """Start the process; both heaters are then off.

        Raises:
            KitAbsentError: there is no kit.
            KitError: the kit does not work.
        """
        words = [
            sys.executable,
            "-m",
            "twinmatch.links.kit_keeper",
            self._wanted,
            f"{self._deadline}",
        ]
        if self.plant_time is not None:
            words.append(f"{self._DEADLINE_IN_STEP}")
        # In its own session: Ctrl-C reaches only the commanding process, which then ends this one.
        self.keeper = subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
        )
        self._heard = b""
        kind, text = self._answer(self._START)
        if kind != "ready":
            self.close()
            raise KitAbsentError(text) if kind == "absent" else KitError(text)
        self.port, _, self.firmware = text.partition(" ")

    def drive(self, power: float, second_power: float) -> KitReading:
        """Set both heaters, %, and read both sensors.

        Raises:
            KitSilentError: the heaters were switched off, and stay so until `clear`.
            KitError: the kit or its process is lost; close the link.
        """
        kind, text = self._ask(f"drive {power!r} {second_power!r}")
        if kind == "silent":
            raise KitSilentError(text)
        if kind != "read":
            raise KitError(text)
        return KitReading(*map(float, text.split()))

    def clear(self) -> None:
        """Allow the heaters to be driven again after the deadline has passed.

        Raises:
            KitError: the kit or its process is lost; close the link.
        """
        kind, text = self._ask("clear")
        if kind != "cleared":
            raise KitError(text)

    def close(self) -> None:
        """Let the process switch the heaters off and end; returns when it has ended."""
        process = self.keeper
        self.keeper = None
        if process is None:
            return
        assert process.stdin is not None and process.stdout is not None  # noqa: PT018, S101
        with contextlib.suppress(OSError):
            process.stdin.close()
        try:
            process.wait(self._END)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()

    def _ask(self, line: str) -> tuple[str, str]:
        if self.keeper is None or self.keeper.stdin is None:
            raise KitError("kit: the link is closed")
        try:
            os.write(self.keeper.stdin.fileno(), f"{line}\n".encode())
        except OSError as error:
            raise KitError(
                f"kit: the process that holds its port is gone ({error.strerror})"
            ) from error
        return self._answer(self._patience)

    @property
    def _patience(self) -> float:
        """Longest wait for an answer to a command, s."""
        if self.plant_time is not None:
            return self._ANSWER_IN_STEP
        return (
            self._ANSWER_OF_PROGRAM if is_pseudo_terminal(self.port) else self._ANSWER
        )

    def _answer(self, patience: float) -> tuple[str, str]:
        assert self.keeper is not None and self.keeper.stdout is not None  # noqa: PT018, S101
        pipe = self.keeper.stdout.fileno()
        deadline = time.monotonic() + patience
        while b"\n" not in self._heard:
            seconds_left = deadline - time.monotonic()
            wait = math.inf
            if self.plant_time is not None:
                self.plant_time()
                wait = self._SHORT
            if not select.select([pipe], [], [], max(0.0, min(seconds_left, wait)))[0]:
                if seconds_left > wait:
                    continue
                raise KitError(
                    f"kit: the process that holds its port gave no answer for {patience:g} s"
                )
            piece = os.read(pipe, 4096)
            if not piece:
                raise KitError("kit: the process that holds its port has ended")
            self._heard += piece
        line, _, self._heard = self._heard.partition(b"\n")
        kind, _, text = line.decode(errors="replace").partition(" ")
        return kind, text
