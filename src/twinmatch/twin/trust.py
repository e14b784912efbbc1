"""How far to trust the leader: whether samples lie in its bands, and how often it was nearly the best."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from twinmatch.comparing import TrustLevel
from twinmatch.forecasting import Band, Forecast
from twinmatch.signals import BoolArray, FloatArray

_NEIGHBOURS: Final = 10.0
"""Spans of output closer than this, in units of its noise, are merged: samples of a fast step are that far
apart."""
_NEAR: Final = 1.03
"""A leader whose error is no larger than this times the least of all candidates counts as right."""
_DOUBT: Final = 0.5
"""Prior count of either outcome (Jeffreys)."""


class BandCheck(NamedTuple):
    """How readings lie in the band forecast for them; the fields are those of a verdict.

    Of several outputs, or inputs, the worst counts.
    """

    miss_y: float = float("nan")
    """RMS of measured minus forecast output, in half widths of its band: 0.6 is usual."""
    inside_y: float = float("nan")
    """Share of the readings within the band; 0.9 is expected."""
    miss_u: float = float("nan")
    """The same for the input; NaN where the input is given."""
    inside_u: float = float("nan")

    @property
    def miss(self) -> float:
        """The greater of the two; NaN without any."""
        return self.miss_y if np.isnan(self.miss_u) else max(self.miss_y, self.miss_u)


def check_band(
    forecast: Forecast, outputs: FloatArray, inputs: FloatArray | None, seen: BoolArray | None = None
) -> BandCheck:
    """Compare the last N samples, shape (o, N) and (m, N), with a forecast; `inputs` is None where they were
    given.

    Only those that were `seen` count; None: all.
    """
    figures: list[float] = []
    for values, bands in ((outputs, forecast.outputs), (inputs, forecast.inputs)):
        if values is not None:
            each = [_misses(came, band, seen) for came, band in zip(values, bands, strict=True)]
            figures += [max(miss for miss, _ in each), min(inside for _, inside in each)]
    return BandCheck(*figures)


def _misses(values: FloatArray, band: Band, seen: BoolArray | None) -> tuple[float, float]:
    """RMS of one signal's last samples in half widths of its band, and their share within it."""
    parts = (values, *(part[-values.size :] for part in (band.mean, band.low, band.high)))
    came, mean, low, high = parts if seen is None else (part[seen] for part in parts)
    half = np.where(came > mean, high - mean, mean - low)
    # At a limit of the controller a band has one side only.
    half = np.maximum(half, 0.5 * (high - low))
    miss = float(np.sqrt(np.mean(np.square((came - mean) / half))))
    return miss, float(np.mean((low <= came) & (came <= high)))


class BandHistory:
    """Tracks at which levels the bands held and since when they are missed; depends only on its input."""

    def __init__(self, limit: float, noise: float) -> None:
        """Begin without readings.

        Args:
            limit: RMS miss, in half widths, from which a band counts as missed.
            noise: noise of the output.
        """
        self._limit, self._near = limit, _NEIGHBOURS * noise
        self._spans: list[tuple[float, float]] = []
        self.since: int | None = None
        """First sample of the current stretch outside the bands; None while inside."""

    def push(self, check: BandCheck, first: int, output: FloatArray) -> None:
        """Add the result for samples from index `first` on, with this output."""
        if check.miss >= self._limit:
            self.since = first if self.since is None else self.since
            return
        self.since = None
        self._spans = _merged([*self._spans, (float(output.min()), float(output.max()))], self._near)
        self._newest = float(output[-1])

    @property
    def levels(self) -> tuple[float, float] | None:
        """Range of outputs, contiguous with the newest, in which the bands held.

        None if they never did. It shows where there is evidence, not where the physics ends.
        """
        return next((s for s in self._spans if s[0] <= self._newest <= s[1]), None)


def _merged(spans: list[tuple[float, float]], near: float) -> list[tuple[float, float]]:
    merged: list[tuple[float, float]] = []
    for low, high in sorted(spans):
        if merged and low <= merged[-1][1] + near:
            merged[-1] = merged[-1][0], max(merged[-1][1], high)
        else:
            merged.append((low, high))
    return merged


def trust_level(check: BandCheck, doubtful: float) -> TrustLevel:
    """Trust level of a leader with this result; from a miss of `doubtful` on, it is not trusted."""
    if np.isnan(check.miss):
        return TrustLevel.UNKNOWN
    return TrustLevel.DOUBTFUL if check.miss >= doubtful else TrustLevel.TRUSTED


class LeaderConfidence:
    """Share of the leader's forecasts that no other candidate beat by more than 3 %; old ones weigh less."""

    def __init__(self, kept: float) -> None:
        """Begin undecided; `kept` is the factor on past weights per forecast."""
        self._kept = kept
        self._right = self._wrong = _DOUBT

    def add(self, leading: float, best: float) -> None:
        """Add the error of the leader and the least error of all candidates."""
        right = leading <= _NEAR * best
        self._right = self._kept * self._right + right
        self._wrong = self._kept * self._wrong + (not right)

    @property
    def share(self) -> float:
        """The share, between 0 and 1."""
        return self._right / (self._right + self._wrong)
