"""Figures from a forecast: when a level is reached, from when on it is held, the largest input.

The band holds its share of the samples one by one. Earliest and latest times here are those of a plant that
stays inside the band all the time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinmatch.forecasting.errors import ForecastError
from twinmatch.forecasting.forecast import Forecast

__all__ = ["Moment", "Peak", "largest_input", "time_held", "time_to_reach"]


@dataclass(frozen=True, slots=True)
class Moment:
    """When something happens, s after the newest sample; None if the forecast ends before."""

    expected: float | None
    """According to the mean."""
    earliest: float | None
    """According to the edge of the band that gets there first."""
    latest: float | None
    """According to the edge that gets there last."""


@dataclass(frozen=True, slots=True)
class Peak:
    """A largest size, in the signal's unit."""

    expected: float
    """Largest size of the mean."""
    time: float
    """Time of that, s after the newest sample."""
    least: float
    """Smallest possible value for a plant inside the band."""
    most: float
    """Largest possible value for it."""


def time_to_reach(forecast: Forecast, level: float, tolerance: float) -> Moment:
    """When the output first comes within a tolerance of a level, or passes it between two samples.

    Raises:
        ForecastError: the level is not finite, or the tolerance not finite and positive.
    """
    _check(forecast, level, tolerance)
    band = forecast.output
    start = float(band.mean[0])
    if abs(start - level) <= tolerance:
        within = (band.low >= level - tolerance) & (band.high <= level + tolerance)
        first = float(forecast.time[0])
        return Moment(first, first, _first(forecast, within))
    rising = start < level
    goal = level - tolerance if rising else level + tolerance
    ahead, behind = (band.high, band.low) if rising else (band.low, band.high)
    mean, early, late = (
        _first(forecast, edge >= goal if rising else edge <= goal) for edge in (band.mean, ahead, behind)
    )
    return Moment(mean, early, late)


def time_held(forecast: Forecast, level: float, tolerance: float) -> Moment:
    """When the output comes within a tolerance of a level to stay there until the forecast ends.

    Latest: from then on the whole band stays there. Earliest: from then on the band overlaps it.

    Raises:
        ForecastError: as `time_to_reach`.
    """
    _check(forecast, level, tolerance)
    band, low, high = forecast.output, level - tolerance, level + tolerance
    return Moment(
        _last(forecast, np.abs(band.mean - level) <= tolerance),
        _last(forecast, (band.high >= low) & (band.low <= high)),
        _last(forecast, (band.low >= low) & (band.high <= high)),
    )


def largest_input(forecast: Forecast) -> Peak:
    """The largest |u|."""
    band = forecast.input
    sizes = np.abs(band.mean)
    at = int(np.argmax(sizes))
    edges = np.stack([np.abs(band.low), np.abs(band.high)])
    # If the band contains zero, u may be zero.
    least = np.where((band.low <= 0.0) & (band.high >= 0.0), 0.0, edges.min(axis=0))
    return Peak(float(sizes[at]), float(forecast.time[at]), float(least.max()), float(edges.max()))


def _check(forecast: Forecast, level: float, tolerance: float) -> None:
    if not math.isfinite(level):
        raise ForecastError(f"forecast of {forecast.candidate}: the level is {level:g}; give a finite one")
    if not (math.isfinite(tolerance) and tolerance > 0):
        msg = f"forecast of {forecast.candidate}: the tolerance is {tolerance:g}; give a positive one"
        raise ForecastError(msg)


def _first(forecast: Forecast, there: NDArray[np.bool_]) -> float | None:
    """Time of the first sample with a true entry."""
    return float(forecast.time[int(np.argmax(there))]) if there.any() else None


def _last(forecast: Forecast, there: NDArray[np.bool_]) -> float | None:
    """Time of the first sample from which on all entries are true."""
    if not there[-1]:
        return None
    away = np.flatnonzero(~there)
    return float(forecast.time[int(away[-1]) + 1 if away.size else 0])
