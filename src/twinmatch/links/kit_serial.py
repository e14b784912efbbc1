"""A Temperature Control Lab on its serial line, by means of the package `tclab`.

The package's class finds its port by itself and takes none that it does not know from the USB bus, reads
whatever line comes next as the answer, and makes of a command that is not a number 100 %. So it is given its
port here, its answers are checked, and what is not a number never reaches it.
"""

from __future__ import annotations

import contextlib
import io
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import serial
import tclab
from tclab import tclab as package

from twinmatch.links.kit_errors import KitAbsentError, KitError
from twinmatch.links.kit_link import require_port

__all__ = ["Kit", "Reading", "open_kit"]

_BAUDS = (115200, 9600)
"""Firmware before 1.2.3 speaks slowly."""
_ANSWER = 0.25
"""Longest wait for an answer, s; a kit gives it within 0.03 s."""
_TRIES = 2
_POSSIBLE = (-60.0, 300.0)
"""Readings that ten bits of its converter can give, °C."""
_ROUNDED = 1.0
"""Firmware before 1.4 takes whole percents."""


class Reading(NamedTuple):
    """What a kit says."""

    first: float
    """Temperature T1, °C."""
    second: float
    """Temperature T2, °C."""
    power: float
    """Heater 1 as it is set, %."""
    other: float
    """Heater 2, %."""


class Kit(tclab.TCLab):
    """The package's class on a port that it is given; its constructor looks for one on the USB bus alone."""

    def __init__(self, port: str) -> None:
        self.port, self.debug, self.baud = port, False, 0
        for baud in _BAUDS:
            try:
                self.connect(baud)
                break
            except serial.SerialException as error:
                raise KitAbsentError(f"kit at {port}: the port cannot be opened: {error}") from error
            except (ValueError, OSError):
                package._connected = False  # as the package's own constructor does before it tries again
                with contextlib.suppress(OSError):
                    self.sp.close()
        else:
            raise KitAbsentError(
                f"kit at {port}: what is there does not answer as a Temperature Control Lab does; is it "
                "another device, or another port?"
            )
        self.sp.timeout = _ANSWER
        self.version = self._asked("VER")
        if "TCLab" not in self.version:
            raise KitAbsentError(f"kit at {port}: {self.version[:40]!r} answers, which is no TCLab firmware")

    def drive(self, power: float, other: float) -> Reading:
        """Set both heaters, %, and read both sensors.

        Raises:
            KitError: a command that is not a number within 0 and 100, or answers that are none.
            OSError: the line is gone.
        """
        for value in (power, other):
            if not 0.0 <= value <= 100.0:  # nor is what is not a number
                raise KitError(f"kit: the command is {value}; 0 to 100 % is possible")
        set_to = [self._heater(name, value) for name, value in (("Q1", power), ("Q2", other))]
        return Reading(self._temperature("T1"), self._temperature("T2"), *set_to)

    def off(self) -> None:
        """Switch both heaters off, whatever is on the line.

        Raises:
            KitError: the kit does not say that they are.
            OSError: the line is gone.
        """
        self.drive(0.0, 0.0)

    def _asked(self, words: str, kind: Callable[[str], Any] = str) -> Any:
        """Ask once more if the answer is none.

        Raises:
            KitError: it is none again.
        """
        for _ in range(_TRIES):
            self.sp.reset_input_buffer()  # an old answer, or what somebody else said
            try:
                answer = self.send_and_receive(words, kind)
            except ValueError:
                continue
            if answer != "":
                return answer
        raise KitError(
            f"kit at {self.port}: no answer to {words!r} that makes sense; is another program on it?"
        )

    def _heater(self, name: str, value: float) -> float:
        answer = float(self._asked(f"{name} {value:.2f}", float))
        if not abs(answer - value) < _ROUNDED:
            raise KitError(
                f"kit: heater {name} was set to {value:.2f} % and says {answer:g} %; is it ours alone?"
            )
        return answer

    def _temperature(self, name: str) -> float:
        answer = float(self._asked(name, float))
        if not (math.isfinite(answer) and _POSSIBLE[0] <= answer <= _POSSIBLE[1]):
            raise KitError(f"kit: {name} says {answer:g} °C, which its sensor cannot")
        return answer


def open_kit(port: str) -> Kit:
    """The kit on a port, or the first that is found on the USB bus where none is named. Takes 2 s.

    Raises:
        KitAbsentError: there is none.
    """
    with contextlib.redirect_stdout(io.StringIO()):  # the package talks
        if not port:
            port, _ = package.find_arduino()
            if port is None:
                raise KitAbsentError("kit: none on the USB bus; plug it in, or name its port with --port")
        else:
            require_port(port)
        return Kit(port)
