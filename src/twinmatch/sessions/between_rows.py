"""Values between the rows of a column, by its kind; see `resampling`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, Literal

import numpy as np

from twinmatch.signals import FloatArray

__all__ = ["MOVES", "Kind"]

Kind = Literal["reading", "held", "set"]
"""Kind of a column, which determines its values between rows."""


def _reading(stamps: FloatArray, values: FloatArray, clock: FloatArray, _period: float) -> FloatArray:
    return np.asarray(np.interp(clock, stamps, values), dtype=np.float64)


def _held(stamps: FloatArray, values: FloatArray, clock: FloatArray, period: float) -> FloatArray:
    """Means as differences of the integral, which is linear between rows."""
    ends = np.append(stamps, max(stamps[-1], clock[-1]) + period)  # the last value is held
    integral = np.concatenate([[0.0], np.cumsum(values * np.diff(ends))])
    means = (np.interp(clock + period, ends, integral) - np.interp(clock, ends, integral)) / period
    # Rounding errors of the differences must not exceed a limit of the input.
    return np.asarray(np.clip(means, values.min(), values.max()), dtype=np.float64)


def _set(stamps: FloatArray, values: FloatArray, clock: FloatArray, _period: float) -> FloatArray:
    between = (stamps[1:] + stamps[:-1]) / 2
    return np.asarray(values[np.searchsorted(between, clock, side="left")], dtype=np.float64)


MOVES: Final[Mapping[Kind, Callable[[FloatArray, FloatArray, FloatArray, float], FloatArray]]] = {
    "reading": _reading,
    "held": _held,
    "set": _set,
}
