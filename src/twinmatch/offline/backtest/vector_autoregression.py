"""Forecasts of a vector autoregression of `statsmodels`, the standard tool for time series.

Of the models in `statsmodels`, `VAR` with the set-point as exogenous series fits best. The two signals of a
loop act on each other, which `VAR` models and `AutoReg` and `SARIMAX`, with one signal each, do not.
`SARIMAX` also needs the response to the set-point as delayed set-points, and a loop rings for longer than a
practical number of these. `VARMAX` has both signals, but estimates its coefficients by maximum likelihood
with a Kalman filter, which takes minutes for an hour of samples. `VAR` uses least squares and is refitted for
every forecast.
"""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np

from twinmatch.dynamics import Plant
from twinmatch.forecasting import CONFIDENCE, Band, Forecast, ForecastError
from twinmatch.offline.backtest.peer import banded, enough
from twinmatch.signals import FloatArray, Window

__all__ = ["VectorAutoregression"]

_LEAST = 120
_HIGHEST = 8
_SET_POINTS = 8
"""Number of delayed set-points besides the newest."""


class VectorAutoregression:
    """Output and input regressed on their past and on the set-point and its past, by `statsmodels`.

    The order is the one of least BIC. The band is Gaussian, from the covariance propagated by `statsmodels`;
    the input is clipped to the drive's limits, which `VAR` does not model.
    """

    name = "statsmodels VAR"

    def __init__(self, plant: type[Plant], confidence: float = CONFIDENCE) -> None:
        self._plant, self._confidence = plant, confidence

    @staticmethod
    def missing() -> str:
        """Why it is not available, and what to do; empty if it is."""
        if importlib.util.find_spec("statsmodels") is not None:
            return ""
        return "statsmodels is not installed; run pip install 'twinmatch[backtest]'"

    def forecast(
        self,
        past: Window,
        ahead: FloatArray,
        disturbances: FloatArray | None = None,  # noqa: ARG002 (a part of the interface that it cannot use)
    ) -> Forecast:
        """Forecast one sample for each set-point ahead; see `Peer`.

        Raises:
            ForecastError: the past has too few samples, or `statsmodels` cannot be used on it.
        """
        enough(self.name, past, _LEAST)
        if self.missing():
            raise ForecastError(self.missing())
        from statsmodels.tsa.api import VAR  # noqa: PLC0415 — optional, and slow to import

        level = np.array([past.output.mean(), past.input.mean()])
        noise = np.array([self._plant.output.noise, self._plant.drive.noise])
        endogenous = (np.column_stack([past.output, past.input]) - level) / noise
        reference = (np.concatenate([past.reference, ahead]) - level[0]) / noise[0]
        exogenous = _delayed(reference)
        try:
            with np.errstate(all="ignore"):  # overflows are detected below
                fitted: Any = VAR(endogenous, exog=exogenous[: len(past)]).fit(_HIGHEST, ic="bic")
                found = fitted.forecast_interval(
                    endogenous[-max(fitted.k_ar, 1) :],
                    steps=ahead.size,
                    alpha=1.0 - self._confidence,
                    exog_future=exogenous[len(past) :],
                )
        except (ValueError, np.linalg.LinAlgError) as error:
            raise ForecastError(
                f"{self.name}: statsmodels cannot fit {len(past)} samples: {error}"
            ) from error
        if not np.all(np.isfinite(found)):
            raise ForecastError(f"{self.name}: the fit to {len(past)} samples diverges; give more samples")
        bands = [Band(*(level[j] + noise[j] * x[:, j] for x in found)) for j in range(2)]
        return banded(
            self.name,
            past,
            ahead,
            output=bands[0],
            entry=bands[1],
            plant=self._plant,
            confidence=self._confidence,
        )


def _delayed(reference: FloatArray) -> FloatArray:
    """The set-point now and at the samples before; before the first it is constant."""
    shifted = [
        np.concatenate([np.full(lag, reference[0]), reference])[: reference.size]
        for lag in range(_SET_POINTS + 1)
    ]
    return np.column_stack(shifted)
