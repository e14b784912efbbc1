"""Whether what came lay in the bands, since when it does not, and between which levels it did."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from twinmatch.discrimination import TrustLevel
from twinmatch.forecasting import Forecast
from twinmatch.signals import FloatArray

__all__ = ["Promise", "Promises", "promise_of", "trust_level"]

_NEIGHBOURS: Final = 10.0
"""Spans of output closer than this, in units of its noise, hang together: a sample of a fast step is that far
apart."""


class Promise(NamedTuple):
    """How readings lie in the band that was given before them."""

    miss_y: float
    """RMS of what came minus what was foretold, output, in half widths of its band: 0.6 is usual."""
    inside_y: float
    """Share of the readings within the band; 0.9 is promised."""
    miss_u: float
    """The same of the input; NaN where it was given."""
    inside_u: float

    @property
    def miss(self) -> float:
        """The greater of both, or what there is; NaN without any."""
        return self.miss_y if np.isnan(self.miss_u) else max(self.miss_y, self.miss_u)


def promise_of(forecast: Forecast, output: FloatArray, input: FloatArray | None) -> Promise:
    """How the last N samples of a forecast came true, shape (N,) each; no input where it was given."""
    figures: list[float] = []
    foretold = [(output, forecast.output)]
    if input is not None:
        foretold.append((input, forecast.input))
    for values, band in foretold:
        mean, low, high = (part[-values.size :] for part in (band.mean, band.low, band.high))
        half = np.where(values > mean, high - mean, mean - low)
        # On a limit of the controller a band has one side only.
        half = np.maximum(half, 0.5 * (high - low))
        figures.append(float(np.sqrt(np.mean(np.square((values - mean) / half)))))
        figures.append(float(np.mean((low <= values) & (values <= high))))
    return Promise(*figures, *[float("nan")] * (4 - len(figures)))


class Promises:
    """Keeps what was held and what was broken; all depends on what it is given alone."""

    def __init__(self, limit: float, noise: float) -> None:
        """Begin with nothing.

        Args:
            limit: RMS miss, in half widths, from which a promise counts as broken.
            noise: of the output.
        """
        self._limit, self._near = limit, _NEIGHBOURS * noise
        self._spans: list[tuple[float, float]] = []
        self.since: int | None = None
        """First sample of the stretch in which promises are broken; None while they are kept."""

    def push(self, promise: Promise, first: int, output: FloatArray) -> None:
        """Take how samples from index `first` on, with this output, lay in their band."""
        if promise.miss >= self._limit:
            self.since = first if self.since is None else self.since
            return
        self.since = None
        self._spans = _merged([*self._spans, (float(output.min()), float(output.max()))], self._near)
        self._newest = float(output[-1])

    @property
    def held(self) -> tuple[float, float] | None:
        """Between which outputs promises were kept: what hangs together with where they were last.

        None if they never were. It says where there is evidence, not where the physics ends.
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


def trust_level(promise: Promise, doubtful: float) -> TrustLevel:
    """How far the leader is to be trusted whose promise was kept so; `doubtful` is the miss from which it is
    not."""
    if np.isnan(promise.miss):
        return TrustLevel.UNKNOWN
    return TrustLevel.DOUBTFUL if promise.miss >= doubtful else TrustLevel.TRUSTED
