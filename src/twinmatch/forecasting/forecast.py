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
"""Horizons at which forecasts of the rig are made and scored, s."""


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
