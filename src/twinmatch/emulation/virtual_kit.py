"""An emulated Temperature Control Lab: the model of the package `tclab` behind a real serial line.

The model's equations differ from those of our plant file: they are linear, with a sensor lag of 140 s, a
heater lag of 20 s, and readings truncated to steps of 0.3223 °C. It runs on plant time; the host opens the
port as if it were a real one.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import random
from contextlib import ExitStack
from typing import Any, ClassVar

from twinmatch.emulation.kit_board import KitBoard
from twinmatch.emulation.virtual_rig_time import VirtualPlantTime, VirtualRigError

__all__ = ["VirtualKit"]

_WARMER = 10.0
"""Temperature step of `ambient-step`, °C."""
_NOISE = b"\x00\xff12.3\r\n\xfe"
"""Bytes of another program on the line."""


class VirtualKit(VirtualPlantTime):
    """A simulated kit on a pseudo-terminal.

    Raises:
        VirtualRigError: the package `tclab` is not installed.
    """

    KINDS: ClassVar = frozenset(
        {"drive-lost", "sensor-frozen", "cable-pulled", "garbage-serial", "ambient-step", "board-hung"}
    )

    def make(self, stack: ExitStack) -> dict[str, str]:
        """Create board and model."""
        if importlib.util.find_spec("tclab") is None:
            raise VirtualRigError(
                "virtual kit: the package tclab is not installed; pip install 'twinmatch[tclab]'"
            )
        import tclab  # noqa: PLC0415 (an optional dependency)

        random.seed(self.settings.seed)  # the model draws its noise there
        with contextlib.redirect_stdout(io.StringIO()):
            self._model: Any = tclab.TCLabModel(synced=False)
        self._model.tlast = 0.0
        self._shown = {1: float(self._model.T1), 2: float(self._model.T2)}
        self.board = KitBoard(self.folder / "ttyACM0", self._reading)
        self.board_kind, self.board_remark = "python", "the firmware's line protocol; the model is tclab's"
        stack.callback(self.board.unplug)
        return {"serial": self.board.port}

    def rest(self, seconds: float) -> None:
        """Answer the host while waiting."""
        self.board.wait(seconds)

    def advance(self) -> None:
        """Advance by one slice of plant time."""
        self.board.attend()
        if "garbage-serial" in self.schedule.active and random.random() < 0.05:  # noqa: S311
            self.board.say(_NOISE)
        q1, q2 = self.board.heaters
        self._model.Q1(0.0 if "drive-lost" in self.schedule.active else q1)
        self._model.Q2(q2)
        self.ms += self.slice
        self._model.update(self.elapsed)

    def state(self) -> dict[str, object]:
        """Time, temperatures, powers, speed and active faults."""
        return {
            "time": self.elapsed,
            "heater": self._model._H1,
            "sensor": self._model._T1,
            "power": self.board.heaters[0],
            "second": self.board.heaters[1],
            "speed": self.pace.achieved(),
            "faults": list(self.schedule.active),
        }

    def turn(self, kind: str, *, on: bool) -> None:
        """Start or end a fault."""
        if kind == "ambient-step":
            self._model.Ta += _WARMER if on else -_WARMER
        elif kind == "cable-pulled":
            (self.board.unplug if on else self.board.plug)()
        elif kind == "board-hung":
            self.board.hung = on

    def _reading(self, number: int) -> float:
        if "sensor-frozen" not in self.schedule.active:
            self._shown[number] = float(self._model.T1 if number == 1 else self._model.T2)
        return self._shown[number]
