"""The peers by name: no change, ARX, and a vector autoregression of `statsmodels`."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np

from twinmatch.dynamics import Plant
from twinmatch.forecasting import Band, Forecast, ForecastError
from twinmatch.offline.backtest.arx import Arx
from twinmatch.offline.backtest.peer import BacktestError, Peer
from twinmatch.signals import FloatArray, Window

_MIN_SAMPLES = 20
"""Least number of differences for quantiles; longer lags, with fewer differences, are extrapolated."""
_LAGS = 25
"""Number of lags at which quantiles are computed; in between they are interpolated."""


class Persistence(Peer):
    """Output and, in a loop, input keep their newest values.

    The band at h samples ahead is given by the quantiles of y[j+h] − y[j] over all past j. A lag for which
    the past is too short gets the widest known one, times the root of the ratio of the lags, as for a random
    walk.
    """

    name = "persistence"

    def forecast(
        self,
        past: Window,
        ahead: FloatArray,
        disturbances: FloatArray | None = None,  # noqa: ARG002 (a part of the interface that it cannot use)
    ) -> Forecast:
        """Forecast one sample for each set-point, or input, ahead; see `Peer`."""
        self._require(past, _MIN_SAMPLES + 1)
        signals = [past.output] if self._driven else [past.output, past.input]
        return self._told(past, ahead, *self._bands(np.array(signals), ahead.size))

    def _bands(self, signals: FloatArray, count: int) -> list[Band]:
        """The bands of these signals, shape (signals, N), at the next `count` samples."""
        longest = min(count, signals.shape[1] - _MIN_SAMPLES)
        lags = np.unique(np.geomspace(1, longest, _LAGS).round().astype(np.int64))
        tails = ((1.0 - self._confidence) / 2.0, (1.0 + self._confidence) / 2.0)
        moved = (signals[:, lag:] - signals[:, :-lag] for lag in lags)
        ends = np.array([np.quantile(m, tails, axis=1, overwrite_input=True) for m in moved])
        ahead = np.arange(1, count + 1)
        growth = np.sqrt(np.maximum(ahead / longest, 1.0))
        found = []
        for k, newest in enumerate(signals[:, -1]):
            low, high = (newest + growth * np.interp(ahead, lags, end) for end in ends[:, :, k].T)
            found.append(Band(np.full(count, newest), low, high))
        return found


_VAR_LEAST = 120
_HIGHEST = 8
_ROUNDING = 1e-9
_SET_POINTS = 8
"""Number of delayed set-points besides the newest."""


class VectorAutoregression(Peer):
    """Output and input regressed on their past and on the set-point and its past, by `statsmodels`.

    Of the models in `statsmodels`, `VAR` with the set-point as exogenous series fits best. The two signals of
    a loop act on each other, which `VAR` models and `AutoReg` and `SARIMAX`, with one signal each, do not.
    `SARIMAX` also needs the response to the set-point as delayed set-points, and a loop rings for longer than
    a practical number of these. `VARMAX` has both signals, but estimates its coefficients by maximum
    likelihood with a Kalman filter, which takes minutes for an hour of samples. `VAR` uses least squares and
    is refitted for every forecast.

    The order is the one of least BIC, found here: `statsmodels` would fit every order again. The band is
    Gaussian, from the covariance propagated by `statsmodels`; the input is clipped to the drive's limits,
    which `VAR` does not model.
    """

    name = "statsmodels VAR"
    takes_inputs = False

    @staticmethod
    def missing() -> str:
        """Whether `statsmodels` is installed."""
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
        self._require(past, _VAR_LEAST)
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
                order = order_of_least_bic(endogenous, exogenous[: len(past)])
                model = VAR(endogenous, exog=exogenous[: len(past)])
                fitted: Any = model.fit(_HIGHEST, ic="bic") if order is None else model.fit(order)
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
        return self._told(past, ahead, *bands)


def _delayed(reference: FloatArray) -> FloatArray:
    """The set-point now and at the samples before; before the first it is constant."""
    shifted = [
        np.concatenate([np.full(lag, reference[0]), reference])[: reference.size]
        for lag in range(_SET_POINTS + 1)
    ]
    return np.column_stack(shifted)


def order_of_least_bic(signals: FloatArray, exogenous: FloatArray) -> int | None:
    """The order of least BIC, as `VAR.select_order` finds it, from one factorisation; None where rounding
    decides, because a signal has hardly moved.

    Columns are ordered by lag, so that every lower order is a leading block of the triangular factor.
    """
    lags = [signals[_HIGHEST - lag :][: len(signals) - _HIGHEST] for lag in range(_HIGHEST + 1)]
    count, size = len(lags[0]), 1 + exogenous.shape[1]
    columns = np.column_stack([np.ones(count), exogenous[_HIGHEST:], *lags[1:], lags[0]])
    factor = np.asarray(np.linalg.qr(columns, mode="r"), dtype=np.float64)
    pivots = np.abs(np.diag(factor))
    if pivots.min() < _ROUNDING * pivots.max():
        return None
    left = [factor[size + 2 * order :, -2:] for order in range(_HIGHEST + 1)]
    costs = [np.linalg.slogdet(rest.T @ rest / count)[1] for rest in left]
    return int(np.argmin(costs + np.log(count) / count * 4 * np.arange(_HIGHEST + 1)))


PEERS: Final[Mapping[str, type[Peer]]] = MappingProxyType(
    {"persistence": Persistence, "arx": Arx, "statsmodels": VectorAutoregression}
)
"""The peers by name."""


class Absent(NamedTuple):
    """A peer that is not available here."""

    name: str
    reason: str
    """Why, and what to do."""


def peers(
    plant: type[Plant], names: Sequence[str] = tuple(PEERS), *, driven: bool = False
) -> tuple[list[Peer], list[Absent]]:
    """The peers with these names, and the unavailable ones: not installed, or, if the loop is not known and
    the actual inputs are given (`driven`), able to forecast only both signals of a loop.

    Raises:
        BacktestError: there is no such peer.
    """
    found: list[Peer] = []
    absent: list[Absent] = []
    for name in names:
        if name not in PEERS:
            raise BacktestError(f"backtest: no peer {name!r}; choose from {', '.join(PEERS)}")
        missing = PEERS[name].missing()
        if driven and not PEERS[name].takes_inputs:
            missing = "it forecasts output and input of a loop; here the inputs are given"
        if missing:
            absent.append(Absent(PEERS[name].name, missing))
        else:
            found.append(PEERS[name](plant, driven=driven))
    return found, absent
