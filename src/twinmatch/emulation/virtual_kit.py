"""A Temperature Control Lab without the kit: the model of the package `tclab` behind a real serial line.

The model's equations are others than those of our plant file: linear, a sensor that follows its heater with
140 s, a heater with 20 s, readings cut off to 0.3223 °C. It lives by the plant's time; the host opens the
port and cannot tell the difference.
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
"""What `ambient-step` adds to the room, °C."""
_NOISE = b"\x00\xff12.3\r\n\xfe"
"""What another program leaves on the line."""


class VirtualKit(VirtualPlantTime):
    """A simulated kit on a pseudo-terminal.

    Raises:
        VirtualRigError: the package `tclab` is not installed.
    """

    KINDS: ClassVar = frozenset(
        {"drive-lost", "sensor-frozen", "cable-pulled", "garbage-serial", "ambient-step", "board-hung"}
    )

    def make(self, stack: ExitStack) -> dict[str, str]:
        """Board and model."""
        if importlib.util.find_spec("tclab") is None:
            raise VirtualRigError(
                "virtual kit: the package tclab is not installed; pip install 'twinmatch[tclab]'"
            )
        import tclab  # noqa: PLC0415 (not everybody has it)

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
        """Answer the host meanwhile."""
        self.board.wait(seconds)

    def advance(self) -> None:
        """One slice of plant time."""
        self.board.attend()
        if "garbage-serial" in self.schedule.active and random.random() < 0.05:  # noqa: S311
            self.board.say(_NOISE)
        q1, q2 = self.board.heaters
        self._model.Q1(0.0 if "drive-lost" in self.schedule.active else q1)
        self._model.Q2(q2)
        self.ms += self.slice
        self._model.update(self.elapsed)

    def state(self) -> dict[str, object]:
        """What there is to know."""
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
        """Let a fault begin or end."""
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
