"""Origins: the samples at which forecasts are made, and the samples that follow."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from twinmatch.dynamics import Plant
from twinmatch.forecasting import Forecast, ForecastError
from twinmatch.offline.backtest.peer import Peer
from twinmatch.offline.backtest.scoring import Marked, marks, samples_within
from twinmatch.signals import FloatArray, Sample, Window, unbroken
from twinmatch.twin.matcher import one_thread


@dataclass(frozen=True, slots=True, eq=False)
class Origin:
    """A sample at which all forecasters make a forecast."""

    sample: int
    """Index of the newest sample that is known."""
    stretch: Window
    """The stretch without gaps that contains it."""
    count: int
    """Length of the forecast, samples: the longest horizon, or the rest of the stretch."""
    driven: bool = False
    """Whether the loop is not known, so that the actual inputs are given."""

    @property
    def past(self) -> Window:
        """The samples known at the origin."""
        return self.stretch.part(self.stretch.first, self.sample)

    @property
    def came(self) -> Window:
        """The samples that followed, as many as forecast."""
        return self.stretch.part(self.sample + 1, self.sample + self.count)

    @property
    def ahead(self) -> FloatArray:
        """The future values that a forecast may use: the set-points, or the inputs if the loop is not
        known."""
        return self.came.input if self.driven else self.came.reference

    @property
    def disturbances(self) -> FloatArray | None:
        """The actual disturbances from the newest sample on, shape (N + 1, d); None if there are none."""
        held = self.stretch.part(self.sample, self.sample + self.count).disturbances
        return held if held.size else None


def stretches(samples: Sequence[Sample], period: float) -> tuple[Window, ...]:
    """The stretches of a session without gaps, as windows."""
    return tuple(Window.from_samples(stretch, period) for stretch in unbroken(samples))


def regular(held: Sequence[Window], every: float) -> list[int]:
    """The samples at regular intervals, in seconds, within each stretch."""
    found: list[int] = []
    for stretch in held:
        pace = samples_within(every, stretch.period)
        found += range(stretch.first + pace - 1, stretch.last + 1, pace)
    return found


def origins(
    held: Sequence[Window], samples: Iterable[int], horizons: Sequence[float], *, driven: bool = False
) -> list[Origin]:
    """The origins at these samples, if at least the nearest horizon can be scored.

    Args:
        held: the session's stretches.
        samples: indices of the samples.
        horizons: horizons, s, from near to far.
        driven: whether the loop is not known.
    """
    wanted = sorted(set(samples))
    found = []
    for stretch in held:
        nearest, farthest = (samples_within(horizons[k], stretch.period) for k in (0, -1))
        found += [
            Origin(k, stretch, min(farthest, stretch.last - k), driven)
            for k in wanted
            if stretch.first <= k <= stretch.last - nearest
        ]
    return found


def ask(peer: Peer, origin: Origin) -> Forecast | None:
    """A peer's forecast; None if its past is too short."""
    rows = origin.disturbances
    try:
        with one_thread():
            return peer.forecast(origin.past, origin.ahead, None if rows is None else rows[1:])
    except ForecastError:
        return None


def mark(
    session: str,
    who: str,
    forecast: Forecast,
    origin: Origin,
    *,
    horizons: Sequence[float],
    plant: type[Plant],
    candidate: str = "",
) -> list[Marked]:
    """Score a forecast at every horizon for which all samples exist."""
    came = origin.came
    return [
        Marked(session, origin.sample, horizon, who, marks(forecast, came, horizon, plant), candidate)
        for horizon in horizons
        if samples_within(horizon, came.period) <= origin.count
    ]
