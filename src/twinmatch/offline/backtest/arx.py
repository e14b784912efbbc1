"""Forecasts of an ARX model, a simple least-squares alternative to a twin."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from twinmatch.dynamics import Plant
from twinmatch.forecasting import CONFIDENCE, Band, Forecast
from twinmatch.offline.backtest.arx_fit import Equation, equations
from twinmatch.offline.backtest.peer import banded, enough, with_disturbances
from twinmatch.signals import FloatArray, Window

__all__ = ["HIGHEST", "LEAST", "PER_ORDER", "Arx"]

LEAST = 60
HIGHEST = 10
PER_ORDER = 15
"""Samples needed per order, so that a short past is not fitted with a high order."""


class _Loop(NamedTuple):
    """Both equations at one order."""

    plant: Equation
    controller: Equation

    @property
    def rows(self) -> FloatArray:
        """Coefficients of y and u on the past of y and u, shape (2, 2p)."""
        y, u = (np.concatenate([e.past[:, 0], e.past[:, 1]]) for e in self)
        return np.array([y, u + self.controller.direct[1] * y])

    @property
    def transition(self) -> FloatArray:
        """Transition matrix of the past of y and u, newest first, shape (2p, 2p)."""
        order = len(self.plant.past)
        matrix = np.eye(2 * order, k=-1)
        matrix[[0, order]] = self.rows
        return matrix

    @property
    def radius(self) -> float:
        """Largest absolute eigenvalue; above 1 the forecast diverges."""
        return float(np.max(np.abs(np.linalg.eigvals(self.transition))))


class Arx:
    """Output and input regressed on the past of both, of the set-point and of the measured disturbances,
    refitted to all samples so far.

    The order is the one of least BIC among those with a stable loop. The loop is simulated ahead with the
    future set-points and the drive's limits. The band is Gaussian: the variance of the residuals, propagated
    along the simulated path; the limiter passes the share of a deviation that lies within the limits
    (statistical linearisation).
    """

    name = "ARX"

    def __init__(self, plant: type[Plant], confidence: float = CONFIDENCE) -> None:
        self._plant, self._confidence = plant, confidence

    def forecast(self, past: Window, ahead: FloatArray, disturbances: FloatArray | None = None) -> Forecast:
        """Forecast one sample for each set-point ahead; see `Peer`.

        Raises:
            ForecastError: the past has too few samples.
        """
        enough(self.name, past, LEAST)
        noise = np.array([self._plant.output.noise, self._plant.drive.noise])
        level = np.array([past.output.mean(), past.input.mean()])
        reference, output = ((x - level[0]) / noise[0] for x in (past.reference, past.output))
        entry = (past.input - level[1]) / noise[1]
        limits = (np.array(self._plant.drive.limits) - level[1]) / noise[1]
        span = (np.array(self._plant.output.span) - level[0]) / noise[0]
        others, n = with_disturbances(past, ahead.size, disturbances), len(past)
        found = equations(reference, output, entry, min(HIGHEST, n // PER_ORDER), *(d[:n] for d in others.T))
        mean, spread = _simulated(
            _chosen([_Loop(*pair) for pair in found]),
            (reference, output, entry),
            (ahead - level[0]) / noise[0],
            others,
            (span, limits),
        )
        reach = ndtri((1.0 + self._confidence) / 2.0) * spread
        bands = [
            Band(*(level[j] + noise[j] * x[:, j] for x in (mean, mean - reach, mean + reach)))
            for j in range(2)
        ]
        return banded(
            self.name,
            past,
            ahead,
            output=bands[0],
            entry=bands[1],
            plant=self._plant,
            confidence=self._confidence,
        )


def _chosen(loops: list[_Loop]) -> _Loop:
    """The stable loop of least BIC; if none is stable, the one that diverges most slowly."""
    radii = [loop.radius for loop in loops]
    stable = [loop for loop, radius in zip(loops, radii, strict=True) if radius < 1.0]
    if not stable:
        return loops[int(np.argmin(radii))]
    return min(stable, key=lambda loop: loop.plant.bic + loop.controller.bic)


def _simulated(
    loop: _Loop,
    past: tuple[FloatArray, FloatArray, FloatArray],
    ahead: FloatArray,
    others: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Means and standard deviations of y and u ahead, shape (N, 2) each; u before the limiter.

    `others` are the disturbances of the past and the future samples, one row per sample; `bounds` are the
    output's span and the drive's limits.
    """
    span, limits = bounds
    order, known = len(loop.plant.past), len(others) - ahead.size
    reference, output, entry = (signal[: -order - 1 : -1] for signal in past)
    rows, transition = loop.rows, loop.transition
    direct, variances = loop.controller.direct, (loop.plant.variance, loop.controller.variance)
    load = np.zeros((2 * order, 2))
    load[0, 0], load[order] = 1.0, (direct[1], 1.0)
    covariance = np.zeros((2 * order, 2 * order))
    means, spreads = np.empty((ahead.size, 2)), np.empty((ahead.size, 2))
    for k, wanted in enumerate(ahead):
        lags = np.column_stack([output, entry, reference, others[known + k - order : known + k][::-1]])
        y = np.clip(loop.plant.constant + np.sum(loop.plant.past * lags), *span)
        u = loop.controller.constant + direct @ (wanted, y) + np.sum(loop.controller.past * lags)
        spread = np.sqrt(np.einsum("ij,jk,ik->i", rows, covariance, rows) + load[[0, order]] ** 2 @ variances)
        means[k], spreads[k] = (y, u), spread
        passed = ndtr((limits[1] - u) / spread[1]) - ndtr((limits[0] - u) / spread[1])
        transition[order], load[order] = passed * rows[1], (passed * direct[1], passed)
        covariance = transition @ covariance @ transition.T + (load * variances) @ load.T
        u = np.clip(u, *limits)
        output, entry, reference = (
            np.concatenate([[new], old[:-1]]) for new, old in ((y, output), (u, entry), (wanted, reference))
        )
    return means, spreads
