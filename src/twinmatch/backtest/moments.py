"""When forecasts are made, and what became of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from twinmatch.backtest.peer import Peer
from twinmatch.backtest.scoring import marks, samples_within
from twinmatch.backtest.summary import Marked
from twinmatch.dynamics import Plant
from twinmatch.forecasting import Forecast, ForecastError
from twinmatch.signals import FloatArray, Sample, Window, unbroken
from twinmatch.twin.threads import one_thread

__all__ = ["Moment", "ask", "mark", "moments", "stretches"]


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """A sample at which everybody is asked for a forecast."""

    sample: int
    """Index of the newest sample that is known."""
    stretch: Window
    """The unbroken samples around it."""
    count: int
    """How many samples a forecast is made for: the longest horizon, or what the stretch still holds."""

    @property
    def past(self) -> Window:
        """What is known."""
        return self.stretch.part(self.stretch.first, self.sample)

    @property
    def came(self) -> Window:
        """What came, as long as the forecast."""
        return self.stretch.part(self.sample + 1, self.sample + self.count)

    @property
    def ahead(self) -> FloatArray:
        """The set-points that came, which a forecast may know."""
        return self.came.reference


def stretches(samples: Sequence[Sample], period: float) -> tuple[Window, ...]:
    """The unbroken stretches of a session as windows."""
    return tuple(Window.from_samples(stretch, period) for stretch in unbroken(samples))


def moments(
    held: Sequence[Window], verdicts: Iterable[int], every: float, horizons: Sequence[float]
) -> list[Moment]:
    """At every verdict and every so many seconds, where at least the nearest horizon can still be judged.

    Args:
        held: the session's stretches.
        verdicts: samples that verdicts were made at.
        every: seconds between two forecasts, counted from the beginning of a stretch.
        horizons: how far ahead, s, from near to far.

    Raises:
        BacktestError: a horizon or `every` is shorter than one sample.
    """
    told = np.array(sorted(set(verdicts)), dtype=np.int64)
    found = []
    for stretch in held:
        nearest, farthest = (samples_within(horizons[k], stretch.period) for k in (0, -1))
        pace = samples_within(every, stretch.period)
        regular = np.arange(stretch.first + pace - 1, stretch.last + 1, pace)
        inside = told[(stretch.first <= told) & (told <= stretch.last)]
        found += [
            Moment(int(k), stretch, min(farthest, stretch.last - int(k)))
            for k in np.union1d(regular, inside)
            if k + nearest <= stretch.last
        ]
    return found


def ask(peer: Peer, moment: Moment) -> Forecast | None:
    """A peer's forecast; None where its past does not suffice."""
    try:
        with one_thread():
            return peer.forecast(moment.past, moment.ahead)
    except ForecastError:
        return None


def mark(
    session: str,
    who: str,
    forecast: Forecast,
    moment: Moment,
    *,
    horizons: Sequence[float],
    plant: type[Plant],
) -> list[Marked]:
    """A forecast judged at every horizon of which all samples came."""
    came = moment.came
    return [
        Marked(session, moment.sample, horizon, who, marks(forecast, came, horizon, plant))
        for horizon in horizons
        if samples_within(horizon, came.period) <= moment.count
    ]
