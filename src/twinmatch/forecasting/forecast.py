"""A forecast: mean and band of output and input, sample by sample."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from twinmatch.errors import TwinmatchError
from twinmatch.signals import FloatArray


class ForecastError(TwinmatchError):
    """A forecast that cannot be made: no candidate yet, or an invalid set-point profile."""


CONFIDENCE: Final = 0.9
"""Share of future samples that a band is to hold."""
HORIZONS: Final = (10.0, 60.0, 300.0)
"""Horizons at which forecasts are made and scored, s, for samples `_SHORTEST_PERIOD` to
`_LONGEST_PERIOD` apart."""
_LONGEST_PERIOD: Final = 5.0
"""Sample time from which the horizons grow with it, s: at 5 s the longest one is 60 samples, as many as a
verdict compares with the forecasts made for them."""
_SHORTEST_PERIOD: Final = 0.5
"""Sample time below which they shrink with it, s: at 0.5 s the longest one is 600 samples, nearly the longest
window that is matched."""


def time_scale(period: float) -> float:
    """Factor on the horizons and intervals of forecasts for a sample time, s.

    In a plant that is sampled every minute, nothing can be seen ten seconds ahead, and five minutes are only
    five samples. In a motor that is sampled a hundred times a second, all has settled long before.
    Windows are counted in samples; for slow and fast samples horizons are, too.
    """
    return max(period / _LONGEST_PERIOD, min(period / _SHORTEST_PERIOD, 1.0))


def horizons_for(period: float) -> tuple[float, ...]:
    """The horizons for a sample time, s."""
    return tuple(horizon * time_scale(period) for horizon in HORIZONS)


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """Forecast of one signal, in its unit, shape (N,) each."""

    mean: FloatArray
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """Forecast by one candidate of the N samples after `sample`, as the sensor will read them."""

    sample: int
    """Index of the newest sample it was made from."""
    candidate: str
    """Name of the candidate."""
    structure: str
    """Name of its structure."""
    confidence: float
    """Share of the samples that the band is to hold."""
    time: FloatArray
    """Seconds after `sample`, shape (N,); the first is one period."""
    reference: FloatArray
    """Set-points for which it is made, shape (N,); NaN if the loop is not known: it is made for `input`."""
    output: Band
    input: Band
    notes: tuple[str, ...] = ()
    """Sentences on what the band does not cover: a fault, a level never visited."""

    @property
    def closed(self) -> bool:
        """Whether it is made for set-points; otherwise for inputs."""
        return bool(np.isfinite(self.reference).any())
