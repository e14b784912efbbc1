"""Whether readings lie in the leader's bands, at which levels they did, and how often the leader was nearly
the best."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Final, NamedTuple

import numpy as np

from twinmatch.forecasting import Band, Forecast
from twinmatch.signals import BoolArray, FloatArray, rms

_NEIGHBOURS: Final = 10.0
"""Spans of output closer than this, in units of its noise, are merged: samples of a fast step are that far
apart."""
_NEAR: Final = 1.03
"""A leader whose error is no larger than this times the least of all candidates counts as right."""
_MOST: Final = 0.5
"""Share of the readings within the bands below which most are outside."""
_DOUBT: Final = 0.5
"""Prior count of forecasts with a leader that was nearly best, and of those with another (Jeffreys)."""


class BandCheck(NamedTuple):
    """How readings lie in the band forecast for them; of several outputs, or inputs, the worst counts."""

    miss_y: float = float("nan")
    """RMS of measured minus forecast output, in half widths of its band: 0.6 is usual."""
    inside_y: float = float("nan")
    """Share of the readings within the band; 0.9 is expected."""
    miss_u: float = float("nan")
    """The same for the input; NaN where the input is given."""
    inside_u: float = float("nan")
    low: float = float("nan")
    """Lowest of these readings of the output (of several, the first)."""
    high: float = float("nan")
    last: float = float("nan")
    """The newest of them."""
    each: tuple[tuple[float, float], ...] = ()
    """The miss and the share of each output and then of each input that was forecast."""

    @property
    def miss(self) -> float:
        """The greater of the two; NaN without any."""
        return self.miss_y if np.isnan(self.miss_u) else max(self.miss_y, self.miss_u)

    @property
    def inside(self) -> float:
        """The smaller share of the two; NaN without any."""
        return (
            self.inside_y
            if np.isnan(self.inside_u)
            else min(self.inside_y, self.inside_u)
        )


def check_band(
    forecast: Forecast,
    outputs: FloatArray,
    inputs: FloatArray | None,
    counted: BoolArray | None = None,
) -> BandCheck:
    """Compare the last N samples, shape (o, N) and (m, N), with a forecast; `inputs` is None where they were
    given.

    Only those that are `counted` are compared; None: all.
    """
    of_outputs = _misses_of_each(outputs, forecast.outputs, counted)
    of_inputs = (
        [] if inputs is None else _misses_of_each(inputs, forecast.inputs, counted)
    )
    miss_y, inside_y = _worst(of_outputs)
    miss_u, inside_u = _worst(of_inputs)
    y = outputs[0]
    band = forecast.outputs[0]
    is_counted = np.ones(y.size, dtype=np.bool_) if counted is None else counted
    is_inside = is_counted & (band.low[-y.size :] <= y) & (y <= band.high[-y.size :])
    levels = y[is_inside if is_inside.any() else is_counted]  # without spikes
    return BandCheck(
        miss_y=miss_y,
        inside_y=inside_y,
        miss_u=miss_u,
        inside_u=inside_u,
        low=float(levels.min()),
        high=float(levels.max()),
        last=float(levels[-1]),
        each=(*of_outputs, *of_inputs),
    )


def _misses_of_each(
    values: FloatArray, bands: Sequence[Band], counted: BoolArray | None
) -> list[tuple[float, float]]:
    """Miss and share inside of each signal; `values` have shape (signals, N)."""
    return [
        _misses(signal, band, counted)
        for signal, band in zip(values, bands, strict=True)
    ]


def _worst(each: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """The greatest miss and the least share; NaN without any."""
    if not each:
        return float("nan"), float("nan")
    return max(miss for miss, _ in each), min(inside for _, inside in each)


def _misses(
    values: FloatArray, band: Band, counted: BoolArray | None
) -> tuple[float, float]:
    """RMS of one signal's last samples in half widths of its band, and their share within it."""
    size = values.size
    rows = np.array([values, band.mean[-size:], band.low[-size:], band.high[-size:]])
    received, mean, low, high = rows if counted is None else rows[:, counted]
    half_width = np.where(received > mean, high - mean, mean - low)
    # At a limit of the controller a band has one side only.
    half_width = np.maximum(half_width, 0.5 * (high - low))
    miss = float(rms(received - mean, half_width))
    share_inside = float(np.mean((low <= received) & (received <= high)))
    return miss, share_inside


class BandHistory:
    """Tracks at which levels the bands held and since when they are missed; depends only on its input."""

    def __init__(self, limit: float, noise: float) -> None:
        """Begin without readings.

        Args:
            limit: RMS miss, in half widths, from which a band counts as missed.
            noise: noise of the output.
        """
        self._limit = limit
        self._near = _NEIGHBOURS * noise
        self._spans: list[tuple[float, float]] = []
        self.since: int | None = None
        """First sample of the current stretch outside the bands; None while inside."""
        self.lasts = False
        """Whether the bands were missed in two windows that share no sample, or by twice the limit, with most
        readings outside: a peak at a step of the input is not that."""

    def push(self, check: BandCheck, first: int, samples: int) -> None:
        """Add the result for so many samples from index `first` on."""
        if check.miss >= self._limit:
            self.since = first if self.since is None else self.since
            is_second_window = first >= self.since + samples
            is_gross = check.miss >= 2.0 * self._limit and check.inside < _MOST
            self.lasts |= is_second_window or is_gross
            return
        self.since = None
        self.lasts = False
        self._spans = merged([*self._spans, (check.low, check.high)], self._near)
        self._newest = check.last

    @property
    def levels(self) -> tuple[float, float] | None:
        """Range of outputs, contiguous with the newest, in which the bands held.

        None if they never did. It shows where there is evidence, not where the physics ends.
        """
        return next(
            (span for span in self._spans if span[0] <= self._newest <= span[1]), None
        )


def merged(
    spans: Sequence[tuple[float, float]], near: float = 0.0
) -> list[tuple[float, float]]:
    """Join ranges that overlap or lie within `near` of each other; lowest first."""
    joined: list[tuple[float, float]] = []
    for low, high in sorted(spans):
        if joined and low <= joined[-1][1] + near:
            joined[-1] = joined[-1][0], max(joined[-1][1], high)
        else:
            joined.append((low, high))
    return joined


class LeaderConfidence:
    """Share of the leader's forecasts that no other candidate beat by more than 3 %; old ones weigh less."""

    def __init__(self, kept: float) -> None:
        """Begin undecided; `kept` is the factor on past weights per forecast."""
        self._kept = kept
        self._right = self._wrong = _DOUBT

    def copy(self) -> LeaderConfidence:
        """An independent copy."""
        return copy(self)

    def add(self, leading: float, best: float) -> None:
        """Add the error of the leader and the least error of all candidates."""
        right = leading <= _NEAR * best
        self._right = self._kept * self._right + right
        self._wrong = self._kept * self._wrong + (not right)

    @property
    def share(self) -> float:
        """The share, between 0 and 1."""
        return self._right / (self._right + self._wrong)
