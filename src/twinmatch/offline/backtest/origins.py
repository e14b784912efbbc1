"""Samples at which all forecasters make a forecast, and the scores of what they say there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from twinmatch.comparing import BASELINES
from twinmatch.dynamics import Plant
from twinmatch.forecasting import CONFIDENCE, ArxForecast, Band, Forecast
from twinmatch.offline.backtest.scoring import (
    PEERS,
    Marked,
    marks_of_each,
    samples_within,
)
from twinmatch.signals import FloatArray, Sample, Window

PAST: Final = 4096
"""Samples before an origin that its forecasters may look at: of a rig, more than an hour. Each origin has its own, so
with all that came before them the time and the memory of a backtest would grow with the square of its session."""


@dataclass(frozen=True, eq=False)
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

    @cached_property
    def past(self) -> Window:
        """The samples known at the origin, of these the newest `PAST`."""
        first = max(self.stretch.first, self.sample - PAST + 1)
        return self.stretch.part(first, self.sample)

    @cached_property
    def came(self) -> Window:
        """The samples that followed, as many as forecast."""
        return self.stretch.part(self.sample + 1, self.sample + self.count)

    def alone(self, k: int) -> Origin:
        """With the k-th output and input only, and of the samples only those that followed."""
        return replace(self, stretch=self.came.alone(k))

    @property
    def ahead(self) -> FloatArray:
        """The future values that a forecast may use: the set-points, or the inputs if the loop is not known;
        shape (N,), or of several (N, r)."""
        signals = self.came.inputs if self.driven else self.came.references
        return signals[:, 0] if signals.shape[1] == 1 else signals

    @property
    def disturbances(self) -> FloatArray | None:
        """The actual disturbances from the newest sample on, shape (N + 1, d); None if there are none."""
        rows = self.stretch.part(self.sample, self.sample + self.count).disturbances
        return rows if rows.size else None


class SettledStretch:
    """The newest of the settled samples that follow one another."""

    def __init__(self, period: float, longest: int) -> None:
        """Begin without samples; `period` is the sample time, s, and `longest` the number that is kept."""
        self._period = period
        self._longest = longest
        self._window: Window | None = None
        self._newest: list[Sample] = []
        """Samples that are not in the window yet."""
        self._count = 0
        self._last: Sample | None = None

    @property
    def last(self) -> int | None:
        """Index of the newest sample; None before the first."""
        return None if self._last is None else self._last.index

    def continued_by(self, sample: Sample) -> bool:
        """Whether a sample is the next one, or the first."""
        return self._last is None or sample.follows(self._last)

    def push(self, sample: Sample) -> None:
        """Take the next sample."""
        self._last = sample
        self._count += 1
        self._newest.append(sample)

    def is_regular(self, pace: int) -> bool:
        """Whether a multiple of `pace` samples has come."""
        return self._count > 0 and self._count % pace == 0

    def window(self) -> Window:
        """The samples that are kept.

        Raises:
            SignalError: there is none.
        """
        if self._newest or self._window is None:
            newest = Window.from_samples(self._newest, self._period)
            joined = newest if self._window is None else self._window.joined(newest)
            first = max(joined.first, joined.last - self._longest + 1)
            self._window = joined.part(first, joined.last)
            self._newest = []
        return self._window


def origins(
    stretches_of_session: Sequence[Window],
    samples: Iterable[int],
    horizons: Sequence[float],
    *,
    driven: bool = False,
) -> list[Origin]:
    """The origins at these samples of a session's stretches, if at least the nearest of the horizons, s, from
    near to far, can be scored."""
    wanted = sorted(set(samples))
    places = []
    for stretch in stretches_of_session:
        nearest = samples_within(horizons[0], stretch.period)
        farthest = samples_within(horizons[-1], stretch.period)
        places += [
            Origin(k, stretch, min(farthest, stretch.last - k), driven)
            for k in wanted
            if stretch.first <= k <= stretch.last - nearest
        ]
    return places


def ask(arx: ArxForecast, origin: Origin) -> dict[str, Forecast]:
    """The forecasts of the peers, by name: those that the ledger compares with, of means without bands."""
    forecasts = arx.referees(origin.ahead, origin.disturbances)
    past = origin.past
    size = origin.count
    outputs = origin.past.outputs.shape[1]
    unknown = np.full(size, np.nan)
    bands = [
        tuple(Band(mean, unknown, unknown) for mean in means) for means in forecasts
    ]
    return {
        name: Forecast(
            sample=origin.sample,
            candidate=PEERS[name],
            structure="",
            confidence=CONFIDENCE,
            time=np.arange(1, size + 1, dtype=np.float64) * past.period,
            references=np.full(size, np.nan) if origin.driven else origin.ahead,
            outputs=bands_of_peer[:outputs],
            inputs=bands_of_peer[outputs:],
        )
        for name, bands_of_peer in zip(BASELINES, bands, strict=True)
    }


class NamedForecast(NamedTuple):
    """A forecast, by whom."""

    forecaster: str
    candidate: str
    """Name of the candidate that made it; empty for a peer."""
    forecast: Forecast


def scores(  # noqa: PLR0917
    session: str,
    horizons: Sequence[float],
    origin: Origin,
    plant: type[Plant],
    k: int,
    forecasts: Sequence[NamedForecast],
) -> list[list[Marked]]:
    """The scores of the k-th output in each of the forecasts made at an origin.

    A forecast is scored at every horizon that the session reaches and whose last sample was received.
    """
    actual = origin.came
    reached = [
        horizon
        for horizon in horizons
        if _is_known_at(samples_within(horizon, actual.period), origin)
    ]
    of_output = [named.forecast.alone(k) for named in forecasts]
    marks_of_forecasts = marks_of_each(of_output, actual, reached, plant)
    return [
        [
            Marked(
                session,
                origin.sample,
                horizon,
                named.forecaster,
                result,
                named.candidate,
            )
            for horizon, result in zip(reached, results, strict=True)
        ]
        for named, results in zip(forecasts, marks_of_forecasts, strict=True)
    ]


def _is_known_at(count: int, origin: Origin) -> bool:
    """Whether the sample that is so many after an origin has come, and was received."""
    if count > origin.count:
        return False
    seen = origin.came.seen
    return seen is None or bool(seen[count - 1])
