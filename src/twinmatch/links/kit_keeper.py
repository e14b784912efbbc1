"""A watchdog process that holds a kit's serial port, and switches the heaters off when commands stop.

The firmware of a Temperature Control Lab has no deadline: without a host its heaters stay as they are. So
this small process holds the port, and outlives the commanding process just long enough to switch off. It
reads one line per command and answers each with one line.

    drive POWER OTHER     →  read T1 T2 POWER OTHER
    clear                 →  cleared
                             error WHAT: both heaters were switched off, and this process ends
                             silent WHAT: heaters are off because no command arrived, until cleared

The class of the package `tclab` searches the USB bus for its port and accepts no other, takes the next line
as the answer whatever it is, and turns NaN into 100 %. So here the port is passed in, answers are checked,
and NaN never reaches the package.

Usage: python -m twinmatch.links.kit_keeper PORT DEADLINE [LONGEST WAIT FOR AN ANSWER]
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import select
import signal
import sys
import termios
import time
from collections.abc import Callable
from typing import Any, Final

import serial
import tclab
from tclab import tclab as package

from twinmatch.errors import EXIT_USER_ERROR
from twinmatch.links.kit_link import (
    KitAbsentError,
    KitError,
    KitReading,
    is_pseudo_terminal,
    require_port,
)

_BAUDS = (115200, 9600)
"""Firmware before 1.2.3 uses the lower rate."""
_ANSWER = 0.25
"""Longest wait for an answer, s; a kit gives it within 0.03 s."""
_ANSWER_OF_PROGRAM = 1.0
"""Longest wait for an answer of a program in place of a kit, s: a busy machine lets it wait for its turn."""
_POSSIBLE = (-60.0, 300.0)
"""Range of its 10-bit converter, °C."""


class Kit(tclab.TCLab):
    """The package's class on a given port; the original constructor only searches the USB bus."""

    _RESTART: Final = 2.0
    """Time in which a board restarts, s."""
    _TRIES: Final = 2
    _ROUNDED: Final = 1.0
    """Rounding of the command, %: firmware before 1.4 takes whole percents."""

    def __init__(self, port: str, patience: float) -> None:
        self.port = port
        self.debug = False
        self.baud = 0
        for baud in _BAUDS:
            try:
                self.connect(baud)
                break
            except serial.SerialException as error:
                raise KitAbsentError(
                    f"kit at {port}: the port cannot be opened: {error}"
                ) from error
            except (ValueError, OSError):
                with contextlib.suppress(OSError):
                    self.sp.close()
        else:
            raise KitAbsentError(
                f"kit at {port}: the device does not answer like a Temperature Control Lab; is the port "
                "right?"
            )
        self.sp.timeout = patience
        self.version = self._ask("VER")
        if "TCLab" not in self.version:
            raise KitAbsentError(
                f"kit at {port}: the device reports {self.version[:40]!r}, which is not TCLab firmware"
            )
        self.drive(0.0, 0.0)  # the package switches off heater 1 only

    def connect(self, baud: int) -> None:
        """Open the port, which restarts a real board, and switch heater 1 off, as the package does.

        The package's own method takes a failed attempt for an open connection, and refuses the next one.

        Raises:
            ValueError: the answer is not that of a kit.
            OSError: the port cannot be opened or used.
        """
        self.sp = serial.Serial(port=self.port, baudrate=baud, timeout=self._RESTART)
        if not is_pseudo_terminal(self.port):
            time.sleep(self._RESTART)
        self.Q1(0)
        self.baud = baud

    def drive(self, power: float, second_power: float) -> KitReading:
        """Set both heaters, %, and read both sensors.

        Raises:
            KitError: a command is not within 0 to 100, or an answer is invalid.
            OSError: the port is gone.
        """
        for value in (power, second_power):
            if not 0.0 <= value <= 100.0:  # true for NaN too
                raise KitError(
                    f"kit: the command is {value}; it must be within 0 to 100 %"
                )
        set_to = (self._heater("Q1", power), self._heater("Q2", second_power))
        return KitReading(self._temperature("T1"), self._temperature("T2"), *set_to)

    def off(self) -> None:
        """Switch both heaters off: each is set to zero, whether or not the kit confirms the other.

        Raises:
            KitError: the kit does not confirm it.
            OSError: the port is gone.
        """
        errors = []
        for heater in ("Q1", "Q2"):
            try:
                self._heater(heater, 0.0)
            except KitError as error:
                errors.append(error)
        if errors:
            raise errors[0]

    def _ask(self, words: str, kind: Callable[[str], Any] = str) -> Any:
        """The answer to a request, which is retried once."""
        for _ in range(self._TRIES):
            try:
                # drop late answers and those to other programs
                self.sp.reset_input_buffer()
            except termios.error as error:
                # pyserial passes it on, and it is not an OSError
                raise OSError(*error.args) from error
            try:
                answer = self.send_and_receive(words, kind)
            except ValueError:
                continue
            if answer != "":
                return answer
        raise KitError(
            f"kit at {self.port}: no valid answer to {words!r}; is another program using the port?"
        )

    def _heater(self, name: str, value: float) -> float:
        answer = float(self._ask(f"{name} {value:.2f}", float))
        if not abs(answer - value) < self._ROUNDED:
            raise KitError(
                f"kit: heater {name} was set to {value:.2f} % but reports {answer:g} %; is another program "
                "using the port?"
            )
        return answer

    def _temperature(self, name: str) -> float:
        answer = float(self._ask(name, float))
        if not (math.isfinite(answer) and _POSSIBLE[0] <= answer <= _POSSIBLE[1]):
            raise KitError(
                f"kit: {name} reads {answer:g} °C, which its sensor cannot give; check the sensor"
            )
        return answer


def open_kit(port: str, patience: float | None = None) -> Kit:
    """The kit on a port, or the first on the USB bus if the port is empty. Takes 2 s with a board.

    `patience` is the longest wait for an answer, s; by default that of a kit, or of a program in its place.

    Raises:
        KitAbsentError: there is no kit.
    """
    with contextlib.redirect_stdout(io.StringIO()):  # the package prints
        if not port:
            port, _ = package.find_arduino()
            if port is None:
                raise KitAbsentError(
                    "kit: none on the USB bus; plug it in, or name its port with --port"
                )
        else:
            require_port(port)
        if patience is None:
            patience = _ANSWER_OF_PROGRAM if is_pseudo_terminal(port) else _ANSWER
        return Kit(port, patience)


class _Keeper:
    _OFFS: Final = 3
    """Attempts to switch the heaters off before giving up, each of 1 s at most with a kit."""

    def __init__(self, kit: Kit, deadline: float) -> None:
        self._kit = kit
        self._deadline = deadline
        self._driving = False
        self._silent = False
        self._heard = b""

    def serve(self) -> int:
        """Answer commands until the input ends."""
        while True:
            try:
                for line in self._lines():
                    if line is None:
                        return 0
                    self._say(self._answer(line.split()))
            except (KitError, OSError) as error:
                self._say(f"error {error}")
                return 1

    def off(self) -> None:
        """Switch the heaters off; from now on no signal ends this process before it has tried."""
        for number in (signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
        for _ in range(self._OFFS):
            with contextlib.suppress(KitError, OSError):
                self._kit.off()
                return

    def _lines(self) -> list[str | None]:
        """The received lines; None at the end of input. Waits at most the deadline while a heater is on."""
        if not select.select([0], [], [], self._deadline if self._driving else None)[0]:
            self._kit.off()
            self._driving = False
            self._silent = True
            return []
        heard = os.read(0, 4096)
        *lines, self._heard = (self._heard + heard).split(b"\n")
        return [line.decode(errors="replace") for line in lines] if heard else [None]

    def _answer(self, words: list[str]) -> str:
        if words == ["clear"]:
            self._silent = False
            return "cleared"
        if len(words) != 3 or words[0] != "drive":
            raise KitError(f"kit: {' '.join(words)!r} is not a command")
        power, second_power = (_number(word) for word in words[1:])
        wanted = power > 0.0 or second_power > 0.0
        if self._silent and wanted:
            return f"silent the kit received no command for {self._deadline:g} s; its heaters were switched off"
        self._driving = wanted
        return "read {:.4f} {:.4f} {:.4f} {:.4f}".format(
            *self._kit.drive(power, second_power)
        )

    @staticmethod
    def _say(line: str) -> None:
        with contextlib.suppress(OSError):
            # the reader is gone, which the end of our input will show
            os.write(1, f"{line}\n".encode())


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise KitError(f"kit: {word!r} is not a number") from None


def main(arguments: list[str]) -> int:
    """Hold a port until the standard input ends; returns the exit code."""
    port = arguments[0]
    deadline = float(arguments[1])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # ends at the end of its input instead
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    signal.signal(signal.SIGHUP, lambda *_: sys.exit(0))
    try:
        kit = open_kit(port, *map(float, arguments[2:]))
    except KitAbsentError as error:
        os.write(1, f"absent {error}\n".encode())
        return EXIT_USER_ERROR
    except (KitError, OSError) as error:
        os.write(1, f"error {error}\n".encode())
        return 1
    keeper = _Keeper(kit, deadline)
    try:
        os.write(1, f"ready {kit.port} {kit.version}\n".encode())
        return keeper.serve()
    finally:
        keeper.off()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
