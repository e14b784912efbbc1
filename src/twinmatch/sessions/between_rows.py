"""What belongs between the rows of a column, by its kind; see `resampling`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, Literal

import numpy as np

from twinmatch.signals import FloatArray

__all__ = ["MOVES", "Kind"]

Kind = Literal["reading", "held", "set"]
"""What a column is, and so what belongs between its rows."""


def _reading(stamps: FloatArray, values: FloatArray, clock: FloatArray, _period: float) -> FloatArray:
    return np.asarray(np.interp(clock, stamps, values), dtype=np.float64)


def _held(stamps: FloatArray, values: FloatArray, clock: FloatArray, period: float) -> FloatArray:
    """What has been given up to a time is a line from row to row; a mean is a difference of two such sums."""
    ends = np.append(stamps, max(stamps[-1], clock[-1]) + period)  # the last row's value stands on
    given = np.concatenate([[0.0], np.cumsum(values * np.diff(ends))])
    means = (np.interp(clock + period, ends, given) - np.interp(clock, ends, given)) / period
    # Differences of sums are off in the last digits, and a limit of the input must not be passed by them.
    return np.asarray(np.clip(means, values.min(), values.max()), dtype=np.float64)


def _set(stamps: FloatArray, values: FloatArray, clock: FloatArray, _period: float) -> FloatArray:
    between = (stamps[1:] + stamps[:-1]) / 2
    return np.asarray(values[np.searchsorted(between, clock, side="left")], dtype=np.float64)


MOVES: Final[Mapping[Kind, Callable[[FloatArray, FloatArray, FloatArray, float], FloatArray]]] = {
    "reading": _reading,
    "held": _held,
    "set": _set,
}
