"""The noise of a sensor, estimated from a recording of a plant that moved.

What the inputs explain is taken off first: the plant's answers to them, as sums of first-order lags of every
length. Second differences of what is left, y[k+2h] − 2 y[k+h] + y[k], are hardly affected by slow movements;
noise of standard deviation σ gives them the variance 6 σ², from the distance h on at which it no longer
resembles itself. For white noise that is every h; averages and low-pass filters need larger ones.

A coarse sensor at rest shows no noise at all, yet is wrong by up to half a step. Its steps q, which may
differ from level to level, are those between readings that are held; the noise is at least q/√12.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from twinmatch.signals import FloatArray

_MOST: Final = 20_000
"""Samples that are used; more say little about a noise."""
_LAGS: Final = 14
"""Lags of the answers to each input, from one sample to a quarter of the recording …"""
_PER_LAG: Final = 20
"""… and samples for each of them, so that they do not explain the noise."""
_SPIKE: Final = 6.0
"""A reading that much further off than the median one explains nothing."""
_BLOCK: Final = 20
"""Second differences whose mean square shows how quiet the signal is there, and …"""
_PER_DISTANCE: Final = 4
"""… at least so many distances h; four such blocks are needed."""
_QUIET: Final = 0.6
"""Lower quartile of such mean squares of white noise, in their median."""
_FAR: Final = 9.0
"""A quarter of the recording is far quieter if its variance is less by this factor: white noise never is."""
_LOUD: Final = 4.0
"""Blocks count up to so many medians: noise may depend on the level, a movement is larger."""
_LEVEL = 1.25
_BENT = 1.7
_STEEP = 5.0
"""Growth of the variance when h doubles: below the first it has arrived; below the second nearly so, when
from the third on the plant's movement takes over. Averages and filters give up to 4, movements up to 16."""
_ALL: Final = 1.0
"""Squared median deviation of all that is left, in that variance, up to which it is nothing but noise (of
white noise: 0.45)."""
_STEPS: Final = 20
"""Steps between held readings from which a sensor is a coarse one."""
_FLOOR: Final = 1e-4
"""Least noise of computed values, as a share of their range; that of written ones is their last digit's."""
_DIGIT: Final = 1e-6
"""Smaller changes, as a share of the range, are below a digit."""
_ON_GRID = 1e-3
_NEARLY_ALL = 0.95
"""So close to a multiple of the last digit are nearly all changes; resampling leaves a few fractions."""


def noise_of(values: FloatArray, inputs: Sequence[FloatArray] = ()) -> float:
    """Standard deviation of a reading at rest, two digits.

    Args:
        values: readings of a plant that moved, shape (N,), equally far apart.
        inputs: what moved it, each of shape (N,): inputs and measured disturbances.
    """
    y = values[:_MOST]
    white = _noise(_unexplained(y, [u[:_MOST] for u in inputs]))
    reach = float(np.ptp(y)) or 1.0
    changes = np.abs(np.diff(y))
    digit = float(np.min(changes[changes > _DIGIT * reach], initial=math.inf))
    in_digits = np.mean(np.abs(changes / digit - np.rint(changes / digit)) < _ON_GRID) > _NEARLY_ALL
    least = digit / math.sqrt(12.0) if in_digits and digit < math.inf else _FLOOR * reach
    return float(f"{max(white, resolution(y) / math.sqrt(12.0), least):.2g}")


def resolution(values: FloatArray) -> float:
    """Typical step of a coarse sensor (RMS over the recording), zero if it shows none.

    Counted are the steps between two readings that were both held: the plant moved slowly there.
    """
    first = np.flatnonzero(np.insert(np.diff(values) != 0.0, 0, values=True))
    lengths = np.diff(np.append(first, values.size))
    held = (lengths[1:] > 1) & (lengths[:-1] > 1)
    steps = np.abs(np.diff(values[first]))[held]
    if steps.size < _STEPS:
        return 0.0
    steps = np.minimum(steps, _LOUD * np.median(steps))
    step = math.sqrt(np.average(steps**2, weights=(lengths[1:] + lengths[:-1])[held]))
    return step if step < float(np.ptp(values)) / _STEPS else 0.0


def _unexplained(values: FloatArray, inputs: Sequence[FloatArray]) -> FloatArray:
    """Readings without what first-order lags of the inputs explain, and of where the plant was at first."""
    from scipy.signal import lfilter  # noqa: PLC0415 (takes a second, used only here)

    size = values.size
    count = min(_LAGS, size // (_PER_LAG * (1 + len(inputs))))
    if not inputs or count < 2:
        return values
    columns = [np.ones(size), *inputs]
    for pole in np.exp(-1.0 / np.geomspace(1.0, size / 4, count)):
        columns.append(pole ** np.arange(size))
        columns += [lfilter([0.0, 1.0 - pole], [1.0, -pole], u - u[0]) for u in inputs]
    table = np.column_stack(columns)
    table = table / (np.linalg.norm(table, axis=0) + 1e-300)
    left = values
    kept = np.ones(size, dtype=np.bool_)
    for _ in range(2):  # the second time without spikes
        left = values - table @ np.linalg.lstsq(table[kept], values[kept], rcond=None)[0]
        kept = np.abs(left) <= _SPIKE * np.median(np.abs(left))
    return left


def _noise(values: FloatArray) -> float:
    """Standard deviation of noise, white or coloured, on a signal that hardly moves."""
    found: list[tuple[float, float]] = []
    for distance in 2 ** np.arange(12):
        if (typical := _typical(values, int(distance))) is None:
            break
        found.append(typical)
    growth = [after / max(before, 1e-300) for (before, _), (after, _) in pairwise(found)]
    end = next((k for k, by in enumerate(growth) if by < _LEVEL or by > _STEEP), len(growth))
    arrived = end < len(growth) and growth[end] < _LEVEL
    chosen = end if arrived or (end and growth[end - 1] < _BENT) else 0
    if chosen and found[chosen][0] * _ALL < float(np.median(np.abs(values - np.median(values)))) ** 2:
        chosen = 0  # much is left that is slower still: a movement
    return math.sqrt(found[chosen][1]) if found else 0.0


def _typical(values: FloatArray, distance: int) -> tuple[float, float] | None:
    """Variance of the noise from second differences at a distance, the median of blocks and their mean
    without movements; None if the recording is too short."""
    bends = np.abs(values[2 * distance :] - 2.0 * values[distance:-distance] + values[: -2 * distance])
    block = max(_BLOCK, _PER_DISTANCE * distance)
    if bends.size < _BLOCK or (distance > 1 and bends.size < 4 * block):
        return None
    usual = max(np.median(bends) / 0.6745, 2.0 * np.mean(np.minimum(bends, np.quantile(bends, 0.9))))
    squares = np.square(bends[bends <= 4.0 * usual]) / 6.0  # without spikes
    block = min(block, squares.size)
    means = squares[: squares.size - squares.size % block].reshape(-1, block).mean(axis=1)
    middle = float(np.median(means))
    quiet = float(np.quantile(means, 0.25)) / _QUIET
    if quiet < middle / _FAR:
        return quiet, quiet
    return middle, float(np.mean(np.minimum(means, _LOUD * middle)))
