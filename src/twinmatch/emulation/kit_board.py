"""The board of a Temperature Control Lab behind a pseudo-terminal: only its line protocol, no heaters.

It behaves like the public firmware (github.com/jckantor/TCLab-sketch, 1.4): a command is a word and a number
and ends with a carriage return or a newline; an unknown command switches both heaters off and is echoed;
numbers have two decimals. There is no deadline: a host that falls silent leaves the heaters on.
"""

from __future__ import annotations

import contextlib
import os
import pty
import select
import tty
from collections.abc import Callable
from pathlib import Path

__all__ = ["KitBoard"]

_LONGEST = 64
"""Longest command that the firmware accepts, characters."""


class KitBoard:
    """Answers on a serial port. `heaters` are the set powers, %; `read` returns a sensor's temperature."""

    VERSION = "TCLab Firmware 1.4.0 Arduino Uno"

    def __init__(self, port: Path, read: Callable[[int], float]) -> None:
        self.port = str(port)
        self.heaters = [0.0, 0.0]
        self.hung = False
        """Whether it ignores commands; the heaters stay as they are."""
        self._read_sensor = read
        self._line = b""
        self._master: int | None = None
        self.plug()

    def plug(self) -> None:
        """Create the port. The board is powered by USB, so its heaters are off."""
        if self._master is not None:
            return
        self.heaters = [0.0, 0.0]
        self._line = b""
        master, slave = pty.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        Path(self.port).symlink_to(os.ttyname(slave))
        os.close(slave)
        self._master = master

    def unplug(self) -> None:
        """Remove the port, and with it the power."""
        self.heaters = [0.0, 0.0]
        if self._master is not None:
            Path(self.port).unlink(missing_ok=True)
            os.close(self._master)
        self._master = None

    def wait(self, seconds: float) -> None:
        """Wait at most this time for a command, and answer it."""
        if self._master is None:
            select.select([], [], [], seconds)
            return
        look = select.poll()
        look.register(self._master, select.POLLIN)
        ready = look.poll(1000.0 * seconds)
        # Without a host the line is hung up, which ends every wait at once.
        if ready and not ready[0][1] & select.POLLIN:
            select.select([], [], [], seconds)
        self.attend()

    def attend(self) -> None:
        """Answer the commands received."""
        if self._master is None:
            return
        try:
            heard = os.read(self._master, 4096)
        except OSError:  # nothing there, or no host
            return
        if self.hung:
            return
        for byte in heard:
            if byte in b"\r\n" or len(self._line) >= _LONGEST:
                command, self._line = self._line, b""
                if command.strip():
                    self.say(self._obey(command.decode(errors="replace")).encode() + b"\r\n")
            else:
                self._line += bytes([byte])

    def say(self, data: bytes) -> None:
        """Put bytes on the line; a host that does not read loses them."""
        if self._master is not None:
            with contextlib.suppress(OSError):
                os.write(self._master, data)

    def _obey(self, line: str) -> str:
        word, _, data = line.strip().partition(" ")
        word = word.upper()
        if word in ("Q1", "Q2"):
            number = int(word[1]) - 1
            self.heaters[number] = max(0.0, min(100.0, _number(data)))
            return f"{self.heaters[number]:.2f}"
        if word in ("R1", "R2"):
            return f"{self.heaters[int(word[1]) - 1]:.2f}"
        if word in ("T1", "T2"):
            return f"{self._read_sensor(int(word[1])):.2f}"
        if word == "VER":
            return self.VERSION
        if word in ("LED", "P1", "P2"):
            return f"{_number(data):.2f}"
        self.heaters = [0.0, 0.0]
        return "Start" if word == "A" else word


def _number(text: str) -> float:
    """Parse like the firmware's `toFloat`: 0 if it is not a number."""
    try:
        value = float(text)
    except ValueError:
        return 0.0
    return value if abs(value) < 1e9 else 0.0
