"""Readings that jump: they move at once, and stand before and afterwards, as no plant does."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from twinmatch.health.recent_samples import RecentSamples
from twinmatch.health.sensors import LearnedSensor
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray


class _Jumping(Rule):
    """When a reading has jumped."""

    at_once: float = 0.5
    """Share of what a reading is said to be off by from which on it has jumped, and of a jump by which one that
    follows its plant moves on behind it."""
    samples: int = 3
    """Most samples in which a reading jumps, however slow the plant is: a fast output of it has moved by as much in a
    few more."""
    step: float = 0.1
    """Share of its range by which a drive has stepped."""


_JUMPING: Final = _Jumping()


class JumpsOfReadings:
    """Which readings of one plant have jumped."""

    def __init__(
        self,
        sensors: Sequence[LearnedSensor],
        recent: RecentSamples,
        drive_ranges: FloatArray,
    ) -> None:
        """Begin with what is learned of the sensors, the newest samples, and how far the command of each drive can
        move, shape (m,)."""
        self._sensors = sensors
        self._recent = recent
        self._drive_ranges = drive_ranges
        self._samples = min(recent.between_onsets, _JUMPING.samples - 1) + 1
        """Most samples in which a reading jumps."""

    def together(self, age: int) -> list[int]:
        """Outputs whose readings have jumped at once, `age` samples ago or the one after, and have stayed
        there; none unless there are two."""
        newest = {
            output: sensor.jump
            for output, sensor in enumerate(self._sensors)
            if sensor.jump.stays
        }
        if not any(jump.age == age for jump in newest.values()):
            return []
        at_once = [
            output for output, jump in newest.items() if jump.age in {age - 1, age}
        ]
        return at_once if len(at_once) > 1 else []

    def any_but_of(self, output: int) -> bool:
        """Whether another reading than that of an output has jumped in the newest sample."""
        return any(
            sensor.jump.age == 0 and sensor.jump.size != 0.0
            for other, sensor in enumerate(self._sensors)
            if other != output
        )

    def explain(self, output: int, off: float, age: int) -> bool:
        """Whether a reading that is said to be off by `off`, in its unit, since so many samples has moved, about where
        that began, by much of it at once, and stood before and afterwards.

        What moves on, or has moved already, may be the plant, which the equations expected elsewhere. An onset is
        known to four seconds; a jump that came after it counts once it is seen whether the reading moves on. What
        follows a step of a drive at once may be its effect, which is larger here than the equations say.
        """
        readings = self._recent.readings_of(output)
        moved = np.sign(off) * readings
        unsure = 2 * self._recent.between_onsets
        onset = max(readings.size - age - 1, 0)
        seen_through = readings.size - 2 * self._samples - 1
        earliest = max(onset - unsure, 0)
        latest = max(onset, min(onset + unsure, seen_through))
        return any(
            _jumps_at_once(moved, begin, abs(off), self._samples)
            and not self._has_drive_stepped(readings.size - 1 - begin)
            for begin in range(earliest, latest + 1)
        )

    def _has_drive_stepped(self, age: int) -> bool:
        """Whether a drive has moved by much of its range within the samples of a jump, the last of them `age` samples
        before the newest."""
        commands = self._recent.commands
        end = len(commands) - age
        newest = commands[max(end - self._samples - 1, 0) : end]
        if not newest.size:
            return False
        moved = newest.max(axis=0) - newest.min(axis=0)
        return bool((moved > _JUMPING.step * self._drive_ranges).any())


def _jumps_at_once(moved: FloatArray, begin: int, off: float, samples: int) -> bool:
    """Whether a reading moves within so many samples from `begin` on by much of what it is said to be off, and
    stands before and afterwards; `moved` is by how much it has moved, up to a constant."""
    since = moved[begin:] - moved[begin]
    at_once = float(since[: samples + 1].max())
    afterwards = float(since[samples : 2 * samples + 1].max(initial=0.0))
    before = moved[begin] - float(moved[max(begin - samples, 0) : begin + 1].min())
    stands_afterwards = afterwards < (1.0 + _JUMPING.at_once) * at_once
    stands_before = before < _JUMPING.at_once * at_once
    return at_once >= _JUMPING.at_once * off and stands_before and stands_afterwards
