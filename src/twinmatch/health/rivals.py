"""What explains the newest readings of a slow plant as well as a drive that has lost its effect, or better.

A reading that has shifted, one that stands still, and heat from elsewhere leave an effect of the drive
missing, too. Where the effect shows only after many samples, the last reading does not tell them apart; all
readings of the last minute do. So each cause is given the onset and the size that explain them best, from
states estimated before, and the squares that it leaves are compared.
"""

from __future__ import annotations

import math
from enum import Enum, auto
from typing import Final

import numpy as np

from twinmatch.dynamics import Parameters, simulate_driven
from twinmatch.signals import FloatArray

_EVERY: Final = 2
"""Spacing of the onsets that are tried of causes that need a simulation, samples."""
_LASTING: Final = 4
"""Samples whose readings count as one: errors of the equations last."""
_LOST: Final = (0.6, 1.0)
"""Range of the share of its effect that a lost drive lacks."""
_STEP: Final = 0.2
"""Size of the push that is simulated, in the range of the drive: to first order, all others are multiples."""


class Cause(Enum):
    """What may have moved the readings away from what the equations expect."""

    DRIVE = auto()
    """The drive has lost its effect."""
    PUSH = auto()
    """Something else pushes the plant where the drive does."""
    SHIFTED = auto()
    """The readings have shifted."""
    FROZEN = auto()
    """The readings stand still."""


def costs_of_causes(
    twin: Parameters,
    states: FloatArray,
    inputs: FloatArray,
    readings: FloatArray,
    *,
    rows: FloatArray,
    period: float,
    slow_error: bool = True,
) -> dict[Cause, float]:
    """How badly each cause explains the last N readings, in nats beyond the best one.

    Args:
        twin: the plant as it was before.
        states: estimated at the first of these samples.
        inputs: of the drive, shape (N,).
        readings: of the output, shape (N,).
        rows: disturbances, shape (N, m).
        period: sample time, s.
        slow_error: whether the equations may err by an amount that grows evenly.

    Raises:
        PlantError: the equations have no solution there.
    """

    def moved(given: FloatArray) -> FloatArray:
        return simulate_driven(twin, given, states=states, period=period, disturbances=rows).output

    expected = moved(inputs)
    low, high = twin.model.plant.drive.limits
    places, left = np.arange(float(inputs.size)), dict.fromkeys(Cause, np.inf)
    ramp = slow_error * places / math.sqrt(places @ places)

    def no_ramp(path: FloatArray) -> FloatArray:
        """A path without what a slow error of the equations explains of it."""
        return path - (path @ ramp) * ramp

    missed = readings - expected
    off = no_ramp(missed)
    for onset in range(2, inputs.size - 2):
        after = places >= onset
        shift = no_ramp(np.where(after, 1.0, 0.0))
        _keep(left, Cause.SHIFTED, off - _size(off, shift) * shift)
        _keep(left, Cause.FROZEN, no_ramp(np.where(after, readings - readings[onset - 1], missed)))
        if onset % _EVERY:
            continue
        dead = no_ramp(moved(np.where(after, twin.model.plant.drive.rest, inputs)) - expected)
        _keep(left, Cause.DRIVE, off - np.clip(_size(off, dead), *_LOST) * dead)
        push = no_ramp(moved(np.where(after, inputs + _STEP * (high - low), inputs)) - expected)
        _keep(left, Cause.PUSH, off - _size(off, push) * push)
    usual = max(twin.model.plant.output.noise**2, min(left.values()) / inputs.size)
    best = min(left.values())
    return {cause: (squares - best) / (2.0 * usual * _LASTING) for cause, squares in left.items()}


def _size(off: FloatArray, pattern: FloatArray) -> float:
    """The multiple of a pattern that explains most of what is off."""
    return float(off @ pattern / max(float(pattern @ pattern), 1e-300))


def _keep(left: dict[Cause, float], cause: Cause, rest: FloatArray) -> None:
    """Note the squares that a cause leaves, if these are the least so far."""
    left[cause] = min(left[cause], float(rest @ rest))
