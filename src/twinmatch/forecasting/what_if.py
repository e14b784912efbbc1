"""A what-if question to a twin, and its answer."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Final

from twinmatch.forecasting.answers import Moment, Peak, largest_input, time_held, time_to_reach
from twinmatch.forecasting.errors import ForecastError
from twinmatch.forecasting.forecast import Forecast
from twinmatch.forecasting.outlook import Outlook
from twinmatch.forecasting.profile import SetPoints

__all__ = ["MOST_SAMPLES", "NEAR", "Answer", "Question", "what_if"]

MOST_SAMPLES: Final = 3600
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


@dataclass(frozen=True)
class Answer:
    """A twin's answer to a question."""

    forecast: Forecast
    """The forecast, sample by sample."""
    level: float
    """Output level to reach."""
    tolerance: float
    """Tolerance for reaching it."""
    reached: Moment
    """When the output first reaches it."""
    held: Moment
    """When the output reaches it to stay."""
    largest: Peak
    """The largest |u|."""


def what_if(outlook: Outlook, question: Question) -> Answer:
    """Answer a question with a twin.

    Raises:
        ForecastError: set-points or inputs out of range or in the past, a horizon that is not positive or too
            long, a level that is not finite, or a tolerance that is not positive.
    """
    output, period = outlook.parameters.model.plant.output, outlook.period
    size = _samples(question.horizon, outlook)
    if question.times or question.levels:
        ahead = SetPoints(
            outlook.standing, question.times, question.levels, question.ramps, signal=outlook.signal
        )
    else:
        ahead = SetPoints.held(outlook.standing)
    tolerance = NEAR * output.noise if question.tolerance is None else question.tolerance
    forecast = outlook.forecast(ahead.ahead(period, size))
    last = (ahead.levels or (ahead.before,))[-1] if outlook.closed else float(forecast.output.mean[-1])
    level = last if question.level is None else question.level
    notes = ahead.notes + _beyond(size, outlook)
    if notes:
        forecast = dataclasses.replace(forecast, notes=forecast.notes + notes)
    return Answer(
        forecast,
        level,
        tolerance,
        time_to_reach(forecast, level, tolerance),
        time_held(forecast, level, tolerance),
        largest_input(forecast),
    )


def _samples(horizon: float | None, outlook: Outlook) -> int:
    period = outlook.period
    if horizon is None:
        return outlook.leads[-1]
    if not (math.isfinite(horizon) and horizon > 0):
        raise ForecastError(f"forecast: the horizon is {horizon:g} s; give a positive time")
    size = max(round(horizon / period), 1)
    if size > MOST_SAMPLES:
        msg = f"forecast: the horizon is {horizon:g} s; give at most {MOST_SAMPLES * period:g} s"
        raise ForecastError(msg)
    return size


def _beyond(size: int, outlook: Outlook) -> tuple[str, ...]:
    judged = outlook.leads[-1]
    if size <= judged:
        return ()
    return (f"no forecast further than {judged * outlook.period:g} s ahead was ever compared with readings",)
