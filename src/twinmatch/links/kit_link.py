"""Our end of a Temperature Control Lab: commands in, readings out, by the process that holds its port."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import select
import stat
import subprocess
import sys
import time
from pathlib import Path

from twinmatch.links.kit_errors import KitAbsentError, KitError, KitSilentError

__all__ = ["KitLink", "KitReading", "require_package", "require_port"]

_START = 20.0
"""Longest start, s: the package waits 2 s at each of two speeds."""
_ANSWER = 3.0
"""Longest wait for an answer, s; the process gives up on the kit before."""

KitReading = tuple[float, float, float, float]
"""T1 and T2, °C, and both heaters as they are set, %."""


def require_package() -> None:
    """Refuse a Python that has no package `tclab`.

    Raises:
        KitAbsentError: it has none.
    """
    if importlib.util.find_spec("tclab") is None:
        raise KitAbsentError("kit: the package tclab is not installed; pip install 'twinmatch[tclab]'")


def require_port(port: str) -> None:
    """Refuse a port at which nothing can be.

    Raises:
        KitAbsentError: there is none, or it is no serial port.
    """
    try:
        device = stat.S_ISCHR(Path(port).stat().st_mode)
    except OSError as error:
        raise KitAbsentError(
            f"kit at {port}: {error.strerror}; is it plugged in, is the port right?"
        ) from error
    if not device:
        raise KitAbsentError(f"kit at {port}: is no serial port")


class KitLink:
    """One kit; open it, drive it, and close it, from one thread."""

    def __init__(self, port: str, deadline: float = 1.0) -> None:
        """`port` may be empty: the first on the USB bus. `deadline` s without a command switch heaters off.

        Raises:
            KitAbsentError: the package `tclab` is not installed.
        """
        require_package()
        self.port, self.firmware = port, ""
        self._wanted, self._deadline = port, deadline
        self._process: subprocess.Popen[bytes] | None = None
        self._heard = b""

    @property
    def is_open(self) -> bool:
        """Whether there is a process that holds the port."""
        return self._process is not None

    def open(self) -> None:
        """Start the process; both heaters are off then.

        Raises:
            KitAbsentError: there is no kit.
            KitError: it does not work with us.
        """
        words = [sys.executable, "-m", "twinmatch.links.kit_keeper", self._wanted, f"{self._deadline}"]
        # A session of its own: Ctrl-C reaches those who command it, and they let it end.
        self._process = subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
        )
        self._heard = b""
        kind, rest = self._answer(_START)
        if kind != "ready":
            self.close()
            raise KitAbsentError(rest) if kind == "absent" else KitError(rest)
        self.port, _, self.firmware = rest.partition(" ")

    def drive(self, power: float, other: float) -> KitReading:
        """Set both heaters, %, and read both sensors.

        Raises:
            KitSilentError: the heaters were switched off, and stay so until `clear`.
            KitError: the kit or its process is lost; close the link.
        """
        kind, rest = self._ask(f"drive {power!r} {other!r}")
        if kind == "silent":
            raise KitSilentError(rest)
        if kind != "read":
            raise KitError(rest)
        first, second, set_to, other_set = map(float, rest.split())
        return first, second, set_to, other_set

    def clear(self) -> None:
        """Let heaters be driven again after a silence.

        Raises:
            KitError: the kit or its process is lost; close the link.
        """
        kind, rest = self._ask("clear")
        if kind != "cleared":
            raise KitError(rest)

    def close(self) -> None:
        """Let the process switch off and end; returns when it has."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None and process.stdout is not None  # noqa: S101, PT018 — we asked for them
        with contextlib.suppress(OSError):
            process.stdin.close()
        try:
            process.wait(_ANSWER)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()

    def _ask(self, line: str) -> tuple[str, str]:
        if self._process is None or self._process.stdin is None:
            raise KitError("kit: the link is closed")
        try:
            os.write(self._process.stdin.fileno(), f"{line}\n".encode())
        except OSError as error:
            raise KitError(f"kit: the process that holds its port is gone ({error.strerror})") from error
        return self._answer(_ANSWER)

    def _answer(self, patience: float) -> tuple[str, str]:
        """The first word of an answer, and the rest."""
        assert self._process is not None and self._process.stdout is not None  # noqa: S101, PT018 — just asked
        pipe, deadline = self._process.stdout.fileno(), time.monotonic() + patience
        while b"\n" not in self._heard:
            if not select.select([pipe], [], [], max(0.0, deadline - time.monotonic()))[0]:
                raise KitError(f"kit: the process that holds its port gave no answer for {patience:g} s")
            piece = os.read(pipe, 4096)
            if not piece:
                raise KitError("kit: the process that holds its port has ended")
            self._heard += piece
        line, _, self._heard = self._heard.partition(b"\n")
        kind, _, rest = line.decode(errors="replace").partition(" ")
        return kind, rest
