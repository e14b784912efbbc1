"""A question about what comes, and its answer."""

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
"""Longest forecast that is given: what an answer costs grows with it."""
NEAR: Final = 10.0
"""How near to a level counts as there if nothing else is said, in the output's noise: 1 °C on the rig."""


@dataclass(frozen=True)
class Question:
    """What comes if the set-points, or the inputs where the loop is not known, are these? Without arguments:
    if nothing is changed?"""

    times: tuple[float, ...] = ()
    """Seconds after the newest sample, growing; without any the newest level stays."""
    levels: tuple[float, ...] = ()
    """Set-points, or inputs, from these times on, the last of which stays."""
    ramps: bool = False
    """Whether they move in a straight line from row to row, beginning now."""
    horizon: float | None = None
    """How far to look, s; None: as far as forecasts are judged."""
    level: float | None = None
    """Output to wait for; None: the last set-point, or where inputs were given the output they lead to."""
    tolerance: float | None = None
    """How near to it counts as there; None: `NEAR`."""


@dataclass(frozen=True)
class Answer:
    """What a twin says to a question."""

    forecast: Forecast
    """At every sample as far as was asked."""
    level: float
    """Output that was waited for."""
    tolerance: float
    """How near counted as there."""
    reached: Moment
    """When the output is there first."""
    held: Moment
    """From when on it stays there."""
    largest: Peak
    """The largest |u|."""


def what_if(outlook: Outlook, question: Question) -> Answer:
    """Ask a twin.

    Raises:
        ForecastError: set-points or inputs the plant does not take or that lie in the past, a horizon that is
            not positive or too long, a level that is not finite, a tolerance that is not positive.
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
    return (f"no forecast was held against what came further than {judged * outlook.period:g} s ahead",)
