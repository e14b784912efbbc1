"""The forecast of a vector autoregression of `statsmodels`: what somebody at home with time series would use.

Of what `statsmodels` offers, an able user ends up with `VAR` and the set-point as an exogenous series. The
two signals of a loop drive one another, which `VAR` has; `AutoReg` and `SARIMAX`, with one signal each, have
not. In `SARIMAX` the way from set-point to output must be written as delayed set-points besides, and a loop
rings for longer than these can be counted. `VARMAX` has both signals, but finds its coefficients by maximum
likelihood through a Kalman filter, which takes minutes for an hour. `VAR` is least squares: it is
fitted anew for every forecast, so that there is nothing to extend or to append.
"""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np

from twinmatch.backtest.peer import banded, enough
from twinmatch.dynamics import Plant
from twinmatch.forecasting import CONFIDENCE, Band, Forecast, ForecastError
from twinmatch.signals import FloatArray, Window

__all__ = ["VectorAutoregression"]

_LEAST = 120
_HIGHEST = 8
_SET_POINTS = 8
"""Delayed set-points, beside the newest."""


class VectorAutoregression:
    """Output and input on their past, with the set-point and its past given, by `statsmodels`.

    The order is the one of least BIC. The band is Gaussian, from the covariance that `statsmodels` carries
    along; the input is cut off at the drive's limits, of which `VAR` knows nothing.
    """

    name = "statsmodels VAR"

    def __init__(self, plant: type[Plant], confidence: float = CONFIDENCE) -> None:
        self._plant, self._confidence = plant, confidence

    @staticmethod
    def missing() -> str:
        """Why it cannot be asked, and what helps; empty: it can."""
        if importlib.util.find_spec("statsmodels") is not None:
            return ""
        return "statsmodels is not installed; pip install 'twinmatch[backtest]' brings it"

    def forecast(self, past: Window, ahead: FloatArray) -> Forecast:
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
            with np.errstate(all="ignore"):  # what overflows is found below
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
            raise ForecastError(f"{self.name}: the fit to {len(past)} samples runs away")
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
    """The set-point now and at each of the samples before; before the first it stood as it did then."""
    shifted = [
        np.concatenate([np.full(lag, reference[0]), reference])[: reference.size]
        for lag in range(_SET_POINTS + 1)
    ]
    return np.column_stack(shifted)
