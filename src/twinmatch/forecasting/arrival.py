"""When will the output be there, and when must one begin to be there in time?

The first is asked under what stands (the set-point, or the input of an unknown loop) and under a move that is
made now. The second is a search: the latest moment at which that move still brings the output there in time,
for the mean and for the edge of the band that arrives last.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from twinmatch.forecasting.forecast import Band, Forecast, ForecastError
from twinmatch.forecasting.outlook import Outlook
from twinmatch.forecasting.set_points import SetPoints
from twinmatch.forecasting.what_if import MAX_SAMPLES, NEAR, Moment, time_to_reach
from twinmatch.signals import one_of_each


@dataclass(frozen=True)
class ArrivalQuestion:
    """A level of the output, and when it is to be reached."""

    level: float
    """In the output's unit."""
    by: float | None = None
    """Seconds after the newest sample at which it is to be there; None: whenever it is."""
    move: float | None = None
    """Set-point, or input where the loop is not known, that is to lead there; None: the level itself, or the
    end of the drive's range that leads there sooner."""
    tolerance: float | None = None
    """Distance that counts as there; None: `NEAR` times the output's noise."""
    longest: int = MAX_SAMPLES
    """Samples that are looked ahead, at most."""


@dataclass(frozen=True)
class Beginning:
    """When a move has to be made, s after the newest sample; None if it is too late already."""

    expected: float | None
    """The latest moment by the mean."""
    safe: float | None
    """The latest moment after which even the edge of the band that arrives last is there in time."""


@dataclass(frozen=True)
class Arrival:
    """The answer."""

    level: float
    tolerance: float
    standing: float
    """Set-point or input that stands."""
    held: Moment
    """When the output is there if nothing is changed."""
    move: float
    """Set-point or input that leads there."""
    moved: Moment
    """When the output is there if that is given now."""
    by: float | None
    beginning: Beginning | None
    """When the move has to be made; None if nothing was asked."""
    looked: float
    """How far ahead was looked, s."""
    notes: tuple[str, ...]


def arrival(outlook: Outlook, question: ArrivalQuestion) -> Arrival:
    """Answer with a twin.

    Raises:
        ForecastError: the plant has several loops, the level, move or time cannot be used, or it is too far
            ahead.
    """
    plant = outlook.parameters.model.plant
    if not plant.single:
        raise ForecastError(
            f"arrival: plant {plant.name} has several loops; ask for one with a single loop"
        )
    tolerance = (
        NEAR * plant.output.noise if question.tolerance is None else question.tolerance
    )
    search = _Arrivals(outlook, question.level, tolerance)
    size = _samples_to_look(outlook, question)
    standing = one_of_each("level", outlook.standing)
    move = _move(search, question, size) if question.move is None else question.move
    held = search.when(SetPoints.constant(standing), size)
    moved_forecast = search.forecast(SetPoints.constant(move, outlook.signal), size)
    moved = search.moment(moved_forecast)
    beginning = None
    if question.by is not None:
        beginning = _beginning(
            search, move, math.floor(question.by / outlook.period * (1 + 1e-9))
        )
    return Arrival(
        question.level,
        tolerance,
        standing,
        held,
        move,
        moved,
        question.by,
        beginning,
        size * outlook.period,
        (*moved_forecast.notes, *_note_on_reach(size, outlook)),
    )


@dataclass(frozen=True)
class _Arrivals:
    """Forecasts of one twin, and when they reach a level."""

    outlook: Outlook
    level: float
    tolerance: float

    def forecast(self, ahead: SetPoints, size: int) -> Forecast:
        return self.outlook.forecast(ahead.ahead(self.outlook.period, size))

    def moment(self, forecast: Forecast) -> Moment:
        return time_to_reach(forecast, self.level, self.tolerance)

    def when(self, ahead: SetPoints, size: int) -> Moment:
        """When a course of set-points or inputs reaches the level."""
        return self.moment(self.forecast(ahead, size))

    def moved_after(self, samples: int, move: float, size: int) -> Moment:
        """When the level is reached if the move is made after so many samples; an output that passes the
        level before that is not there."""
        standing = one_of_each("level", self.outlook.standing)
        # the first sample ahead is one period away
        time = (samples + 1) * self.outlook.period
        forecast = self.forecast(SetPoints(standing, (time,), (move,)), size)
        return self.moment(_from_sample(forecast, samples))


def _from_sample(forecast: Forecast, first: int) -> Forecast:
    """The rest of a forecast."""
    return replace(
        forecast,
        time=forecast.time[first:],
        references=forecast.references[first:],
        outputs=tuple(_rest_of(band, first) for band in forecast.outputs),
        inputs=tuple(_rest_of(band, first) for band in forecast.inputs),
    )


def _rest_of(band: Band, first: int) -> Band:
    return Band(band.mean[first:], band.low[first:], band.high[first:])


def _samples_to_look(outlook: Outlook, question: ArrivalQuestion) -> int:
    """Samples ahead: those until the time asked for or, without one, as many as may be looked."""
    if question.by is None:
        return question.longest
    size = (
        math.floor(question.by / outlook.period * (1 + 1e-9))
        if math.isfinite(question.by)
        else 0
    )
    if not 1 <= size <= question.longest:
        raise ForecastError(
            f"arrival: the time is {question.by:g} s ahead; give one of {outlook.period:g} to "
            f"{question.longest * outlook.period:g} s"
        )
    return size


def _move(search: _Arrivals, question: ArrivalQuestion, size: int) -> float:
    """The level as set-point or, where the loop is not known, the end of the drive's range that arrives
    first; the farther one if none does."""
    outlook = search.outlook
    if outlook.closed:
        return question.level
    plant = outlook.parameters.model.plant
    ends: list[tuple[float, float]] = []
    for end in plant.drive.limits:
        forecast = search.forecast(SetPoints.constant(end, outlook.signal), size)
        reached = search.moment(forecast).expected
        distance = abs(float(forecast.output.mean[-1]) - question.level)
        ends.append((distance if reached is None else -1.0 / (1.0 + reached), end))
    return min(ends)[1]


def _beginning(search: _Arrivals, move: float, size: int) -> Beginning:
    """The latest moments at which the move may be made; `size` is the number of samples until then."""

    def by_mean(samples: int) -> bool:
        return search.moved_after(samples, move, size).expected is not None

    def by_band(samples: int) -> bool:
        return search.moved_after(samples, move, size).latest is not None

    period = search.outlook.period
    return Beginning(_latest(by_mean, size, period), _latest(by_band, size, period))


def _latest(arrives: Callable[[int], bool], size: int, period: float) -> float | None:
    """The latest number of samples after which a move still arrives, s; None if even now it does not."""
    if not arrives(0):
        return None
    early = 0
    late = size
    while late - early > 1:
        middle = (early + late) // 2
        if arrives(middle):
            early = middle
        else:
            late = middle
    return early * period


def _note_on_reach(size: int, outlook: Outlook) -> tuple[str, ...]:
    judged = outlook.leads[-1]
    if size <= judged:
        return ()
    return (
        f"the width of the band is learned up to {judged * outlook.period:g} s ahead, and not beyond",
    )
