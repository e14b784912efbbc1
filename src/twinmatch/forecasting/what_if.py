"""A what-if question to a twin, and its answer: when a level is reached and held, the largest input.

The band holds its share of the samples one by one. Earliest and latest times here are those of a plant that
stays inside the band all the time.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray

from twinmatch.forecasting.forecast import Forecast, ForecastError
from twinmatch.forecasting.outlook import Outlook
from twinmatch.forecasting.set_points import SetPoints
from twinmatch.requirements import SentAs
from twinmatch.signals import one_of_each


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
        is_within = (band.low >= level - tolerance) & (band.high <= level + tolerance)
        first = float(forecast.time[0])
        return Moment(first, first, _time_of_first(forecast, is_within))
    if start < level:
        goal = level - tolerance
        return Moment(
            expected=_time_of_first(forecast, band.mean >= goal),
            earliest=_time_of_first(forecast, band.high >= goal),
            latest=_time_of_first(forecast, band.low >= goal),
        )
    goal = level + tolerance
    return Moment(
        expected=_time_of_first(forecast, band.mean <= goal),
        earliest=_time_of_first(forecast, band.low <= goal),
        latest=_time_of_first(forecast, band.high <= goal),
    )


def settling_time(forecast: Forecast, level: float, tolerance: float) -> Moment:
    """When the output comes within a tolerance of a level to stay there until the forecast ends.

    Latest: from then on the whole band stays there. Earliest: from then on the band overlaps it.

    Raises:
        ForecastError: as `time_to_reach`.
    """
    _check(forecast, level, tolerance)
    band = forecast.output
    low = level - tolerance
    high = level + tolerance
    return Moment(
        _time_from_which_on(forecast, np.abs(band.mean - level) <= tolerance),
        _time_from_which_on(forecast, (band.high >= low) & (band.low <= high)),
        _time_from_which_on(forecast, (band.low >= low) & (band.high <= high)),
    )


def largest_input(forecast: Forecast) -> Peak:
    """The largest |u|."""
    band = forecast.input
    sizes = np.abs(band.mean)
    place = int(np.argmax(sizes))
    edges = np.stack([np.abs(band.low), np.abs(band.high)])
    # If the band contains zero, u may be zero.
    may_be_zero = (band.low <= 0.0) & (band.high >= 0.0)
    least = np.where(may_be_zero, 0.0, edges.min(axis=0))
    return Peak(
        expected=float(sizes[place]),
        time=float(forecast.time[place]),
        least=float(least.max()),
        most=float(edges.max()),
    )


def _check(forecast: Forecast, level: float, tolerance: float) -> None:
    if not math.isfinite(level):
        raise ForecastError(
            f"forecast of {forecast.candidate}: the level is {level:g}; give a finite one"
        )
    if not (math.isfinite(tolerance) and tolerance > 0):
        msg = f"forecast of {forecast.candidate}: the tolerance is {tolerance:g}; give a positive one"
        raise ForecastError(msg)


def _time_of_first(forecast: Forecast, is_there: NDArray[np.bool_]) -> float | None:
    """Time of the first sample at which something is there; None without one."""
    return float(forecast.time[int(np.argmax(is_there))]) if is_there.any() else None


def _time_from_which_on(
    forecast: Forecast, is_there: NDArray[np.bool_]
) -> float | None:
    """Time of the first sample from which on it is always there; None if it is not at the last one."""
    if not is_there[-1]:
        return None
    not_there = np.flatnonzero(~is_there)
    return float(forecast.time[int(not_there[-1]) + 1 if not_there.size else 0])


MAX_SAMPLES: Final = 3600
"""Longest forecast, samples: it limits the computing time of an answer."""
NEAR: Final = 10.0
"""Default tolerance for reaching a level, in the output's noise: 1 °C on the rig."""


@dataclass(frozen=True)
class Question:
    """A question: what happens under these set-points, or inputs if the loop is not known? Without arguments:
    if nothing is changed?"""

    times: tuple[float, ...] = ()
    """Seconds after the newest sample, increasing; if empty, the newest level stays."""
    levels: tuple[float, ...] = ()
    """Set-points, or inputs, from these times on; the last one stays."""
    ramps: bool = False
    """Whether they move linearly from row to row, beginning now."""
    horizon: float | None = None
    """Length of the forecast, s; None: the longest scored horizon."""
    level: float | None = None
    """Output level to reach; None: the last set-point or, for given inputs, the final output."""
    tolerance: float | None = None
    """Tolerance for reaching it; None: `NEAR`."""


_LISTED: Final = SentAs(is_listed=True)


@dataclass(frozen=True)
class WhatIfResult:
    """A twin's answer to a question."""

    forecast: Forecast
    """The forecast, sample by sample."""
    level: Annotated[float, _LISTED]
    """Output level to reach."""
    tolerance: Annotated[float, _LISTED]
    """Tolerance for reaching it."""
    reached: Annotated[Moment, SentAs("reach", is_first_bare=True)]
    """When the output first reaches it."""
    settled: Annotated[Moment, SentAs("hold", is_first_bare=True)]
    """When the output reaches it to stay."""
    largest: Annotated[Peak, SentAs("largest_input", is_first_bare=True)]
    """The largest |u|."""


def what_if(outlook: Outlook, question: Question) -> WhatIfResult:
    """Answer a question with a twin.

    Raises:
        ForecastError: set-points or inputs out of range or in the past, a horizon that is not positive or too
            long, a level that is not finite, or a tolerance that is not positive.
    """
    plant = outlook.parameters.model.plant
    period = outlook.period
    if not plant.single:
        raise ForecastError(
            f"what if: plant {plant.name} has several loops; try-controller answers what a set-point does to "
            "each, and twin/forecast shows what comes if nothing is changed"
        )
    output = plant.output
    standing = one_of_each("level", outlook.standing)
    size = _size_of(question.horizon, outlook)
    if question.times or question.levels:
        ahead = SetPoints(
            standing,
            question.times,
            question.levels,
            question.ramps,
            signal=outlook.signal,
        )
    else:
        ahead = SetPoints.constant(standing)
    tolerance = (
        NEAR * output.noise if question.tolerance is None else question.tolerance
    )
    forecast = outlook.forecast(ahead.ahead(period, size))
    last_set_point = (ahead.levels or (ahead.before,))[-1]
    usual_level = last_set_point if outlook.closed else float(forecast.output.mean[-1])
    level = usual_level if question.level is None else question.level
    notes = ahead.notes + _note_on_length(size, outlook)
    if notes:
        forecast = dataclasses.replace(forecast, notes=forecast.notes + notes)
    return WhatIfResult(
        forecast,
        level,
        tolerance,
        time_to_reach(forecast, level, tolerance),
        settling_time(forecast, level, tolerance),
        largest_input(forecast),
    )


def _size_of(horizon: float | None, outlook: Outlook) -> int:
    """Samples in a horizon, s; None: in the longest at which bands are learned."""
    period = outlook.period
    if horizon is None:
        return outlook.leads[-1]
    if not (math.isfinite(horizon) and horizon > 0):
        raise ForecastError(
            f"forecast: the horizon is {horizon:g} s; give a positive time"
        )
    size = max(round(horizon / period), 1)
    if size > MAX_SAMPLES:
        msg = f"forecast: the horizon is {horizon:g} s; give at most {MAX_SAMPLES * period:g} s"
        raise ForecastError(msg)
    return size


def _note_on_length(size: int, outlook: Outlook) -> tuple[str, ...]:
    """A note if a forecast of so many samples is longer than any that was scored."""
    judged = outlook.leads[-1]
    if size <= judged:
        return ()
    return (
        f"no forecast further than {judged * outlook.period:g} s ahead was ever compared with readings",
    )
