"""What explains the newest readings of a slow plant as well as a drive that has lost its effect, or better.

A reading that has shifted, one that stands still, and heat from elsewhere leave an effect of the drive
missing, too. Where the effect shows only after many samples, the last reading does not tell them apart; all
readings of the last minute do. So each cause is given the onset and the size that explain them best, from
states estimated before, and the squares that it leaves are compared.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto
from typing import Final

import numpy as np

from twinmatch.dynamics import Parameters, simulate_driven
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray


class _Tried(Rule):
    """How causes are simulated and compared."""

    every: int = 2
    """Spacing of the onsets that are tried of causes that need a simulation, samples."""
    lasting: int = 4
    """Samples whose readings count as one: errors of the equations last."""
    step: float = 0.2
    """Size of the push that is simulated, in the range of the drive: to first order, all others are
    multiples."""


_TRIED: Final = _Tried()


_LOST: Final = (0.6, 1.0)
"""Range of the share of its effect that a lost drive lacks."""


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


@dataclass(frozen=True)
class Effects:
    """What each cause would have done to the last N readings, in the output's unit."""

    missed: FloatArray
    """Readings minus what the equations expect under the recorded inputs, shape (N,)."""
    dead: FloatArray
    """Paths of a drive at rest minus the expected one, a row per onset that is tried, shape (k, N)."""
    pushed: FloatArray
    """Paths under a push minus the expected one, a row per onset; its size is unknown, shape (k, N)."""
    shifted: FloatArray
    """Readings shifted by one unit, a row per onset, shape (n, N)."""
    frozen: FloatArray
    """What readings that stand still from an onset on leave, a row per onset, shape (n, N)."""
    noise: float
    """Of a reading, 1 σ."""


def effects_of_causes(
    twin: Parameters,
    states: FloatArray,
    inputs: FloatArray,
    readings: FloatArray,
    *,
    rows: FloatArray,
    period: float,
) -> Effects:
    """Simulate what each cause would have done, with every onset that is tried.

    Args:
        twin: the plant as it was before.
        states: estimated at the first of these samples.
        inputs: of the drive, shape (N,).
        readings: of the output, shape (N,).
        rows: disturbances, shape (N, m).
        period: sample time, s.

    Raises:
        PlantError: the equations have no solution there.
    """

    def output_under(commands: FloatArray) -> FloatArray:
        return simulate_driven(
            twin, commands, states=states, period=period, disturbances=rows
        ).output

    expected = output_under(inputs)
    missed = readings - expected
    drive = twin.model.plant.drive
    low, high = drive.limits
    push = _TRIED.step * (high - low)
    places = np.arange(inputs.size)
    onsets = np.arange(2, inputs.size - 2)
    after = places >= onsets[:, None]

    def departures_under(changed: FloatArray | float) -> FloatArray:
        """How far the output leaves the expected path if the drive gets another input from an onset on."""
        runs = [
            output_under(np.where(places >= onset, changed, inputs))
            for onset in onsets
            if onset % _TRIED.every == 0
        ]
        return np.array(runs) - expected

    return Effects(
        missed,
        dead=departures_under(drive.rest),
        pushed=departures_under(inputs + push),
        shifted=after.astype(np.float64),
        frozen=np.where(after, readings - readings[onsets - 1][:, None], missed),
        noise=twin.model.plant.output.noise,
    )


def costs_of_causes(effects: Effects, *, slow_error: bool = True) -> dict[Cause, float]:
    """How badly each cause explains the readings, in nats beyond the best one.

    Args:
        effects: of the causes.
        slow_error: whether the equations may err by an amount that grows evenly.
    """
    size = effects.missed.size
    places = np.arange(float(size))
    ramp = slow_error * places / math.sqrt(places @ places)

    def no_ramp(paths: FloatArray) -> FloatArray:
        """Paths, shape (…, N), without what a slow error of the equations explains of them."""
        return paths - (paths @ ramp)[..., None] * ramp

    missed = no_ramp(effects.missed)
    squares_left = {
        Cause.DRIVE: _least_squares_left(missed, no_ramp(effects.dead), _LOST),
        Cause.PUSH: _least_squares_left(missed, no_ramp(effects.pushed)),
        Cause.SHIFTED: _least_squares_left(missed, no_ramp(effects.shifted)),
        Cause.FROZEN: float((no_ramp(effects.frozen) ** 2).sum(axis=1).min()),
    }
    best = min(squares_left.values())
    usual = max(effects.noise**2, best / size)
    return {
        cause: (squares - best) / (2.0 * usual * _TRIED.lasting)
        for cause, squares in squares_left.items()
    }


def _least_squares_left(
    missed: FloatArray,
    patterns: FloatArray,
    sizes: tuple[float, float] = (-math.inf, math.inf),
) -> float:
    """The squares that the best multiple, within a range, of the best of some patterns leaves."""
    best = patterns @ missed / np.maximum((patterns**2).sum(axis=1), 1e-300)
    residuals = missed - np.clip(best, *sizes)[:, None] * patterns
    return float((residuals**2).sum(axis=1).min())
