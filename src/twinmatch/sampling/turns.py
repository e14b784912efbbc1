"""Readings that begin again after a turn, as a heading does after 360°, counted on without end.

A compass that goes from 359.9° to 0.4° has moved by half a degree, not by −359.5°. Between two readings a plant
is taken to have moved the shorter way, so that readings have to be closer together than half a turn takes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from twinmatch.settings import Rule
from twinmatch.signals import FloatArray


class ShownTurns(Rule):
    """What a column of an angle looks like that begins again after a turn."""

    jump: float = 0.75
    """Least movement from one reading to the next at which it begins again, in turns."""
    step: float = 0.25
    """Largest movement elsewhere, and at a beginning once turns are counted, in turns."""
    reach: float = 0.9
    """Least range of the readings, in turns; the largest is one turn."""
    rounding: float = 0.01
    """By how much more than a turn the readings may differ, as those of a sensor whose ends overlap, in turns."""


_SHOWN: Final = ShownTurns()
_FULL_CIRCLE: Final = {
    **dict.fromkeys(("deg", "degree", "degrees", "°"), 360.0),
    **dict.fromkeys(("rad", "radian", "radians"), 2.0 * math.pi),
}
"""A turn in units of an angle."""
_ANGLES: Final = (
    "angle",
    "azimuth",
    "bearing",
    "course",
    "direction",
    "heading",
    "kurs",
    "phase",
    "winkel",
    "yaw",
)
"""Words in the names of angles, whose columns often have no unit."""


class TurnCounter:
    """Counts the turns of a reading, one value after another."""

    def __init__(self, turn: float) -> None:
        """Begin without a reading.

        Args:
            turn: what a reading loses where it begins again, in its unit; positive.
        """
        self.turn = turn
        self._turns = 0.0
        self._before: float | None = None

    def counted(self, reading: float) -> float:
        """The next reading with the turns since the first one; as it is, if it is not finite."""
        if not math.isfinite(reading):
            return reading
        if self._before is not None:
            self._turns -= round((reading - self._before) / self.turn)
        self._before = reading
        return reading + self.turn * self._turns


def counted_on(readings: FloatArray, turn: float) -> FloatArray:
    """Readings with the turns since the first one, shape (N,); nan stays nan."""
    is_reading = np.isfinite(readings)
    steps = np.diff(readings[is_reading])
    turns = np.concatenate([[0.0], -np.cumsum(np.rint(steps / turn))])
    counted = np.array(readings, dtype=np.float64)
    counted[is_reading] += turn * turns[: counted[is_reading].size]
    return counted


def beside(set_point: float, reading: float, turn: float) -> float:
    """A set-point in the turn in which it is nearest to a counted reading: a loop goes the shorter way."""
    return set_point + turn * round((reading - set_point) / turn)


def all_beside(set_points: FloatArray, readings: FloatArray, turn: float) -> FloatArray:
    """Set-points in the turns in which they are nearest to counted readings, shape (N,) each; nan without one."""
    return set_points + turn * np.rint((readings - set_points) / turn)


def shown_turn(readings: FloatArray, unit: str, name: str) -> float:
    """The turn after which a column of readings begins again, in its unit; 0 if it shows none.

    Only angles are recognised: by their unit or, where they have none, by a word in their name.

    Args:
        readings: shape (N,), nan without a reading.
        unit: their unit, empty without one.
        name: their name.
    """
    is_called_angle = any(word in name.lower() for word in _ANGLES)
    if unit.lower() in _FULL_CIRCLE:
        candidates: Iterable[float] = (_FULL_CIRCLE[unit.lower()],)
    elif not unit and is_called_angle:
        candidates = sorted(set(_FULL_CIRCLE.values()))
    else:
        candidates = ()
    finite = readings[np.isfinite(readings)]
    return next((turn for turn in candidates if _begins_again(finite, turn)), 0.0)


def angle_words(name: str, turn: float) -> str:
    """That a signal shows a turn, as a main clause."""
    return f"{name} begins again after {turn:.6g}, as an angle does"


def _begins_again(readings: FloatArray, turn: float) -> bool:
    """Whether readings, shape (N,), jump by about a turn and else move little, within one turn."""
    if readings.size < 2:
        return False
    reach = float(np.ptp(readings)) / turn
    if not _SHOWN.reach <= reach <= 1.0 + _SHOWN.rounding:
        return False
    steps = np.abs(np.diff(readings)) / turn
    largest_counted = np.abs(np.diff(counted_on(readings, turn))).max() / turn
    return bool(steps.max() >= _SHOWN.jump and largest_counted <= _SHOWN.step)


def uncertain_gaps(
    seconds: FloatArray, readings: FloatArray, turn: float, gaps: Sequence[int]
) -> list[int]:
    """Those gaps in which a plant may have moved by more than half a turn, so that nobody knows which way.

    Args:
        seconds: times of the readings, s, shape (N,).
        readings: counted readings, shape (N,).
        turn: a turn, in their unit.
        gaps: the readings behind which the gaps are.

    Returns:
        Those across which the fastest movement elsewhere would take it as far.
    """
    steps = np.diff(seconds)
    is_step = steps > 0
    is_step[list(gaps)] = False
    if not is_step.any():
        return []
    rates = np.abs(np.diff(readings))[is_step] / steps[is_step]
    fastest = float(rates.max())
    return [gap for gap in gaps if fastest * abs(steps[gap]) > turn / 2]
