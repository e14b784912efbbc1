"""An emulated Temperature Control Lab: the model of the package `tclab` behind a real serial line.

The board behaves like the public firmware (github.com/jckantor/TCLab-sketch, 1.4): a command is a word and a
number and ends with a carriage return or a newline; an unknown command switches both heaters off and is
echoed; numbers have two decimals. There is no deadline: a host that falls silent leaves the heaters on.

The model's equations differ from those of our plant file: they are linear, with a sensor lag of 140 s, a
heater lag of 20 s, and readings truncated to steps of 0.3223 °C. It runs on plant time; the host opens the
port as if it were a real one.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import random
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, ClassVar, Final

from twinmatch.emulation.arduino import SerialPort
from twinmatch.emulation.clock import ClockServer
from twinmatch.emulation.faults import OF_READINGS
from twinmatch.emulation.plant_time import VirtualPlantTime, VirtualRigError

_NOISE = b"\x00\xff12.3\r\n\xfe"
"""Bytes of another program on the line."""


class KitBoard:
    """Answers on a serial port. `heaters` are the set powers, %; `read` returns a sensor's temperature."""

    _LONGEST: Final = 64
    """Longest command that the firmware accepts, characters."""

    VERSION = "TCLab Firmware 1.4.0 Arduino Uno"

    def __init__(self, port: Path, read: Callable[[int], float]) -> None:
        self.port = str(port)
        self.heaters = [0.0, 0.0]
        self.hung = False
        """Whether it ignores commands; the heaters stay as they are."""
        self._read_sensor = read
        self._received = b""
        self._line = SerialPort(port)
        self._line.plug()

    def plug(self) -> None:
        """Create the port. The board is powered by USB, so its heaters are off."""
        self._received = b""
        self._line.plug()

    def unplug(self) -> None:
        """Remove the port, and with it the power."""
        self.heaters = [0.0, 0.0]
        self._line.unplug()

    def wait(self, seconds: float) -> None:
        """Wait at most this time for a command, and answer it."""
        self._line.wait(seconds)
        self.attend()

    def attend(self) -> None:
        """Answer the commands received."""
        heard = self._line.read(4096)
        if self.hung:
            return
        for byte in heard:
            if byte in b"\r\n" or len(self._received) >= self._LONGEST:
                command = self._received
                self._received = b""
                if command.strip():
                    self.say(
                        self._obey(command.decode(errors="replace")).encode() + b"\r\n"
                    )
            else:
                self._received += bytes([byte])

    def say(self, data: bytes) -> None:
        """Put bytes on the line; a host that does not read loses them."""
        self._line.write(data)

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


class VirtualKit(VirtualPlantTime):
    """A simulated kit on a pseudo-terminal.

    Raises:
        VirtualRigError: the package `tclab` is not installed.
    """

    _WARMER: Final = 10.0
    """Temperature step of `ambient-step`, °C."""

    STANDING = 0.002  # its host waits for answers meanwhile
    EACH: ClassVar = (
        "drive-lost",
        "sensor-frozen",
        *OF_READINGS,
    )
    """Faults of one heater or sensor; without a number, of heater 1 or of both sensors."""
    KINDS: ClassVar = frozenset(EACH).union(
        ("cable-pulled", "garbage-serial", "ambient-step", "board-hung"),
        (f"{kind}.{number}" for kind in EACH for number in (1, 2)),
    )

    def make(self, stack: ExitStack) -> dict[str, str]:
        """Create board and model."""
        if importlib.util.find_spec("tclab") is None:
            raise VirtualRigError(
                "virtual kit: the package tclab is not installed; pip install 'twinmatch[tclab]'"
            )
        import tclab  # noqa: PLC0415

        random.seed(self.settings.seed)  # the model draws its noise there
        with contextlib.redirect_stdout(io.StringIO()):
            self._model: Any = tclab.TCLabModel(synced=False)
        self._model.tlast = 0.0
        self._shown = {1: float(self._model.T1), 2: float(self._model.T2)}
        self.board = KitBoard(self.folder / "ttyACM0", self.reading)
        self.board_kind = "python"
        self.board_remark = "the firmware's line protocol; the model is tclab's"
        stack.callback(self.board.unplug)
        return {"serial": self.board.port}

    def rest(self, seconds: float) -> None:
        """Answer the host while waiting."""
        self.board.wait(seconds)

    def settled(self, clock: ClockServer) -> bool:  # noqa: ARG002
        """Answer the host; there are no images."""
        self.board.attend()
        return True

    def advance(self) -> None:
        """Advance by one slice of plant time."""
        self.board.attend()
        if "garbage-serial" in self.schedule.active and random.random() < 0.05:  # noqa: S311
            self.board.say(_NOISE)
        q1, q2 = self.board.heaters
        self._model.Q1(0.0 if self.schedule.acts("drive-lost", 1) else q1)
        self._model.Q2(0.0 if "drive-lost.2" in self.schedule.active else q2)
        self.ms += self.slice
        self._model.update(self.elapsed)

    def state(self) -> dict[str, object]:
        """Time, temperatures, powers, speed and active faults."""
        return {
            "time": self.elapsed,
            "heater": self._model._H1,
            "second_heater": self._model._H2,
            "sensor": self._model._T1,
            "second_sensor": self._model._T2,
            "power": self.board.heaters[0],
            "second": self.board.heaters[1],
            "speed": self.pace.achieved(),
            "faults": list(self.schedule.active),
        }

    def turn(self, kind: str, *, on: bool) -> None:
        """Start or end a fault."""
        if kind == "ambient-step":
            self._model.Ta += self._WARMER if on else -self._WARMER
        elif kind == "cable-pulled":
            (self.board.unplug if on else self.board.plug)()
        elif kind == "board-hung":
            self.board.hung = on

    def reading(self, number: int) -> float:
        """What the sensor of this number shows now, °C."""
        if not self.schedule.acts("sensor-frozen", number):
            true = float(self._model.T1 if number == 1 else self._model.T2)
            self._shown[number] = self.schedule.told(
                true, float(self._model.Ta), self.elapsed, number
            )
        return self._shown[number]
