"""The forecast of no change."""

from __future__ import annotations

import numpy as np

from twinmatch.dynamics import Plant
from twinmatch.forecasting import CONFIDENCE, Band, Forecast
from twinmatch.offline.backtest.peer import banded, enough
from twinmatch.signals import FloatArray, Window

__all__ = ["Persistence"]

_LEAST = 20
"""Least number of differences for quantiles; longer lags, with fewer differences, are extrapolated."""
_LAGS = 25
"""Number of lags at which quantiles are computed; in between they are interpolated."""


class Persistence:
    """Output and input keep their newest values.

    The band at h samples ahead is given by the quantiles of y[j+h] − y[j] over all past j. A lag for which
    the past is too short gets the widest known one, times the root of the ratio of the lags, as for a random
    walk.
    """

    name = "persistence"

    def __init__(self, plant: type[Plant], confidence: float = CONFIDENCE) -> None:
        self._plant, self._confidence = plant, confidence

    def forecast(
        self,
        past: Window,
        ahead: FloatArray,
        disturbances: FloatArray | None = None,  # noqa: ARG002 (a part of the interface that it cannot use)
    ) -> Forecast:
        """Forecast one sample for each set-point ahead; see `Peer`.

        Raises:
            ForecastError: the past has too few samples.
        """
        enough(self.name, past, _LEAST + 1)
        return banded(
            self.name,
            past,
            ahead,
            output=self._band(past.output, ahead.size),
            entry=self._band(past.input, ahead.size),
            plant=self._plant,
            confidence=self._confidence,
        )

    def _band(self, signal: FloatArray, count: int) -> Band:
        longest = min(count, signal.size - _LEAST)
        lags = np.unique(np.geomspace(1, longest, _LAGS).round().astype(np.int64))
        tails = ((1.0 - self._confidence) / 2.0, (1.0 + self._confidence) / 2.0)
        ends = np.array([np.quantile(signal[lag:] - signal[:-lag], tails) for lag in lags])
        ahead = np.arange(1, count + 1)
        growth = np.sqrt(np.maximum(ahead / longest, 1.0))
        low, high = (growth * np.interp(ahead, lags, end) for end in ends.T)
        newest = float(signal[-1])
        return Band(np.full(count, newest), newest + low, newest + high)
