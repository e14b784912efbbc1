"""The noise of a sensor, estimated from a recording of a plant that moved.

What the inputs explain is taken off first: the plant's answers to them, as sums of first-order lags of every
length. Second differences of what is left, y[k+2h] − 2 y[k+h] + y[k], are hardly affected by slow movements;
noise of standard deviation σ gives them the variance 6 σ², from the distance h on at which it no longer
resembles itself. For white noise that is every h; averages and low-pass filters need larger ones.

A plant that oscillates within a few samples moves in second differences, too. But no forecast of the next reading
errs by less than its white noise: where a linear model of the readings and inputs before errs by far less, its
error is the noise.

A coarse sensor at rest shows no noise at all, yet is wrong by up to half a step. Its steps q, which may
differ from level to level, are those between readings that are held; the noise is at least q/√12.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from twinmatch.compiled import compiled
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray


class _Answers(Rule):
    """The plant's answers to its inputs, which are taken off first."""

    most: int = 20_000
    """Samples that are used; more say little about a noise."""
    lags: int = 14
    """Lags of the answers to each input, from one sample to a quarter of the recording."""
    per_lag: int = 20
    """Samples for each of the lags, so that they do not explain the noise."""
    spike: float = 6.0
    """A reading that much further off than the median one explains nothing."""


_ANSWERS: Final = _Answers()


class _NextReading(Rule):
    """A linear model that forecasts the next reading."""

    order: int = 12
    """Readings before it, and values of each input, from which it is forecast: an oscillation needs two."""
    per_coefficient: int = 20
    """Least readings for each coefficient, so that they do not explain the noise."""
    less: float = 0.5
    """Its error is the noise if it is less than this share of what second differences show."""


_NEXT: Final = _NextReading()


class _DifferenceBlocks(Rule):
    """Blocks of second differences, whose mean squares show where the signal is quiet."""

    size: int = 20
    """Second differences in a block."""
    per_distance: int = 4
    """Second differences in a block, at least, for every sample of their distance h; four such blocks are
    needed."""
    quiet: float = 0.6
    """Lower quartile of such mean squares of white noise, in their median."""
    far: float = 9.0
    """A quarter of the recording is far quieter if its variance is less by this factor: white noise never
    is."""
    loud: float = 4.0
    """Blocks count up to so many medians: noise may depend on the level, a movement is larger."""


_BLOCKS: Final = _DifferenceBlocks()


class _Growth(Rule):
    """Growth of the variance when the distance h doubles.

    Averages and low-pass filters let it grow up to 4 times, movements of the plant up to 16 times."""

    level: float = 1.25
    """Below it, the variance has arrived."""
    bent: float = 1.7
    """Below it, it has nearly arrived, when the plant's movement takes over."""
    steep: float = 5.0
    """From it on, the plant's movement takes over."""
    all_of_it: float = 1.0
    """Squared median deviation of all that is left, in that variance, up to which it is nothing but noise (of
    white noise: 0.45)."""


_GROWTH: Final = _Growth()


class _Digits(Rule):
    """Readings of coarse sensors, and of values that were written with few digits."""

    steps: int = 20
    """Steps between held readings from which a sensor is a coarse one."""
    floor: float = 1e-4
    """Least noise of computed values, as a share of their range; that of written ones is their last
    digit's."""
    smallest: float = 1e-6
    """Smaller changes, as a share of the range, are below a digit."""
    on_grid: float = 1e-3
    """A change is a multiple of the last digit if it is so close to one, in digits."""
    nearly_all: float = 0.95
    """Share of the changes that are multiples; resampling leaves a few fractions."""


_DIGITS: Final = _Digits()


def noise_of(values: FloatArray, inputs: Sequence[FloatArray] = ()) -> float:
    """Standard deviation of a reading at rest, two digits.

    Args:
        values: readings of a plant that moved, shape (N,), equally far apart.
        inputs: what moved it, each of shape (N,): inputs and measured disturbances.
    """
    y = values[: _ANSWERS.most]
    moving = [u[: _ANSWERS.most] for u in inputs]
    shown = _noise(_unexplained(y, moving))
    noise = shown.size
    if shown.is_white:
        least_error = _error_of_next(y, moving)
        noise = least_error if least_error < _NEXT.less * noise else noise
    reach = float(np.ptp(y)) or 1.0
    changes = np.abs(np.diff(y))
    digit = float(np.min(changes[changes > _DIGITS.smallest * reach], initial=math.inf))
    off_grid = np.abs(changes / digit - np.rint(changes / digit))
    in_digits = np.mean(off_grid < _DIGITS.on_grid) > _DIGITS.nearly_all
    least = (
        digit / math.sqrt(12.0)
        if in_digits and digit < math.inf
        else _DIGITS.floor * reach
    )
    return float(f"{max(noise, resolution(y) / math.sqrt(12.0), least):.2g}")


def resolution(values: FloatArray) -> float:
    """Typical step of a coarse sensor (RMS over the recording), zero if it shows none.

    Counted are the steps between two readings that were both held: the plant moved slowly there.
    """
    first = np.flatnonzero(np.insert(np.diff(values) != 0.0, 0, values=True))
    lengths = np.diff(np.append(first, values.size))
    both_held = (lengths[1:] > 1) & (lengths[:-1] > 1)
    steps = np.abs(np.diff(values[first]))[both_held]
    if steps.size < _DIGITS.steps:
        return 0.0
    steps = np.minimum(steps, _BLOCKS.loud * np.median(steps))
    step = math.sqrt(
        np.average(steps**2, weights=(lengths[1:] + lengths[:-1])[both_held])
    )
    return step if step < float(np.ptp(values)) / _DIGITS.steps else 0.0


def _unexplained(values: FloatArray, inputs: Sequence[FloatArray]) -> FloatArray:
    """Readings without what first-order lags of the inputs explain, and of where the plant was at first."""
    size = values.size
    count = min(_ANSWERS.lags, size // (_ANSWERS.per_lag * (1 + len(inputs))))
    if not inputs or count < 2:
        return values
    columns = [np.ones(size), *inputs]
    for pole in np.exp(-1.0 / np.geomspace(1.0, size / 4, count)):
        columns.append(pole ** np.arange(size))
        columns += [first_order_answer(u - u[0], float(pole)) for u in inputs]
    table = np.column_stack(columns)
    table = table / (np.linalg.norm(table, axis=0) + 1e-300)
    residuals = values
    has_no_spike = np.ones(size, dtype=np.bool_)
    for _ in range(2):  # the second time without spikes
        residuals = (
            values
            - table
            @ np.linalg.lstsq(table[has_no_spike], values[has_no_spike], rcond=None)[0]
        )
        has_no_spike = np.abs(residuals) <= _ANSWERS.spike * np.median(
            np.abs(residuals)
        )
    return residuals


def _error_of_next(values: FloatArray, inputs: Sequence[FloatArray]) -> float:
    """Root mean square error of a linear model of the next reading, without spikes; infinite of few readings."""
    size = values.size
    signals = (values, *inputs)
    order = min(_NEXT.order, size // (_NEXT.per_coefficient * len(signals)))
    if order < 2:
        return math.inf
    columns = [np.ones(size - order)]
    for before in range(1, order + 1):
        columns += [signal[order - before : size - before] for signal in signals]
    columns += [signal[order:] for signal in inputs]
    table = np.column_stack(columns)
    table = table / (np.linalg.norm(table, axis=0) + 1e-300)
    following = values[order:]
    errors = following - table @ np.linalg.lstsq(table, following, rcond=None)[0]
    is_spike = np.abs(errors) > _ANSWERS.spike * np.median(np.abs(errors))
    return float(np.sqrt(np.mean(np.square(errors[~is_spike]))))


@compiled
def first_order_answer(u: FloatArray, pole: float) -> FloatArray:
    """Answer of a first-order lag of gain 1, at rest before: y[k+1] = pole y[k] + (1 − pole) u[k], shape of u."""
    y = np.empty(u.size)
    newest = 0.0
    for k in range(u.size):
        y[k] = newest
        newest = (1.0 - pole) * u[k] + pole * newest
    return y


class _Shown(NamedTuple):
    """The noise that second differences show."""

    size: float
    """Its standard deviation."""
    is_white: bool
    """Whether it does not resemble itself from one reading to the next."""


def _noise(values: FloatArray) -> _Shown:
    """The noise, white or coloured, on a signal that hardly moves."""
    variances: list[_Variance] = []
    for distance in 2 ** np.arange(12):
        typical = _typical(values, int(distance))
        if typical is None:
            break
        variances.append(typical)
    if not variances:
        return _Shown(0.0, is_white=True)
    chosen = _distance_of_noise(variances)
    spread = float(np.median(np.abs(values - np.median(values))))
    if chosen and variances[chosen].median * _GROWTH.all_of_it < spread**2:
        chosen = 0  # much is left that is slower still: a movement
    return _Shown(math.sqrt(variances[chosen].mean), is_white=chosen == 0)


def _distance_of_noise(variances: Sequence[_Variance]) -> int:
    """Place of the distance at which noise does not resemble itself any longer; 0 where none shows it."""
    growth = [
        after.median / max(before.median, 1e-300)
        for before, after in pairwise(variances)
    ]
    has_ended = [factor < _GROWTH.level or factor > _GROWTH.steep for factor in growth]
    end = has_ended.index(True) if any(has_ended) else len(growth)
    has_arrived = end < len(growth) and growth[end] < _GROWTH.level
    has_nearly = end > 0 and growth[end - 1] < _GROWTH.bent
    return end if has_arrived or has_nearly else 0


class _Variance(NamedTuple):
    """Variance of the noise from second differences at one distance."""

    median: float
    """Median of blocks."""
    mean: float
    """Mean of blocks without movements."""


def _typical(values: FloatArray, distance: int) -> _Variance | None:
    """From second differences at this distance; None if the recording is too short."""
    before = values[: -2 * distance]
    between = values[distance:-distance]
    after = values[2 * distance :]
    bends = np.abs(after - 2.0 * between + before)
    block = max(_BLOCKS.size, _BLOCKS.per_distance * distance)
    if bends.size < _BLOCKS.size or (distance > 1 and bends.size < 4 * block):
        return None
    by_median = np.median(bends) / 0.6745
    by_mean = 2.0 * np.mean(np.minimum(bends, np.quantile(bends, 0.9)))
    usual = max(by_median, by_mean)
    squares = np.square(bends[bends <= 4.0 * usual]) / 6.0  # without spikes
    block = min(block, squares.size)
    means = (
        squares[: squares.size - squares.size % block].reshape(-1, block).mean(axis=1)
    )
    middle = float(np.median(means))
    quiet = float(np.quantile(means, 0.25)) / _BLOCKS.quiet
    if quiet < middle / _BLOCKS.far:
        return _Variance(quiet, quiet)
    return _Variance(middle, float(np.mean(np.minimum(means, _BLOCKS.loud * middle))))
