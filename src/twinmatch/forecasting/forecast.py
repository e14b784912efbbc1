"""A forecast: mean and band of output and input, sample by sample."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from twinmatch.signals import FloatArray

__all__ = ["CONFIDENCE", "HORIZONS", "Band", "Forecast"]

CONFIDENCE: Final = 0.9
"""Share of the samples to come that a band is to hold."""
HORIZONS: Final = (10.0, 60.0, 300.0)
"""How far ahead forecasts are made and judged, s."""


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """One signal ahead, in its unit, shape (N,) each."""

    mean: FloatArray
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """What one candidate says of the N samples after `sample`, as the sensor will read them."""

    sample: int
    """Index of the newest sample it was made from."""
    candidate: str
    """Name of the twin that was asked."""
    structure: str
    """Of that twin."""
    confidence: float
    """Share of the samples that the band is to hold."""
    time: FloatArray
    """Seconds after `sample`, shape (N,); the first is one period."""
    reference: FloatArray
    """Set-points it is made for, shape (N,); NaN where the loop is not known: it is made for `input` then."""
    output: Band
    input: Band
    notes: tuple[str, ...] = ()
    """Plain sentences on what the band cannot promise: a fault, a level never visited."""

    @property
    def closed(self) -> bool:
        """Whether it was made for set-points; otherwise for inputs."""
        return bool(np.isfinite(self.reference).any())
