"""Peers of a twin whose loop is not known: like it, they forecast the output under the actual inputs."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from twinmatch.dynamics import Plant
from twinmatch.forecasting import CONFIDENCE, Band, Forecast
from twinmatch.offline.backtest.arx import HIGHEST, LEAST, PER_ORDER
from twinmatch.offline.backtest.arx_fit import Equation, input_equations
from twinmatch.offline.backtest.peer import enough, with_disturbances
from twinmatch.offline.backtest.persistence import Persistence
from twinmatch.signals import FloatArray, Window

__all__ = ["InputArx", "OutputPersistence"]


class OutputPersistence:
    """The output keeps its newest value; the band is that of `Persistence`."""

    name = Persistence.name

    def __init__(self, plant: type[Plant], confidence: float = CONFIDENCE) -> None:
        self._whole = Persistence(plant, confidence)

    def forecast(self, past: Window, ahead: FloatArray, disturbances: FloatArray | None = None) -> Forecast:
        """Forecast one sample for each input ahead; see `Peer`.

        Raises:
            ForecastError: the past has too few samples.
        """
        found = self._whole.forecast(past, ahead, disturbances)
        return _under_inputs(self.name, past, ahead, found.output, found.confidence)


class InputArx:
    """The output regressed on its past, the input's and the measured disturbances', refitted to all samples
    so far.

    The order is the one of least BIC among those that are stable. The band is Gaussian: the propagated
    variance of the residuals.
    """

    name = "ARX"

    def __init__(self, plant: type[Plant], confidence: float = CONFIDENCE) -> None:
        self._plant, self._confidence = plant, confidence

    def forecast(self, past: Window, ahead: FloatArray, disturbances: FloatArray | None = None) -> Forecast:
        """Forecast one sample for each input ahead; see `Peer`.

        Raises:
            ForecastError: the past has too few samples.
        """
        enough(self.name, past, LEAST)
        noise = self._plant.output.noise
        levels = float(past.output.mean()), float(past.input.mean())
        y, u = (past.output - levels[0]) / noise, (past.input - levels[1]) / self._plant.drive.noise
        later = (ahead - levels[1]) / self._plant.drive.noise
        others, n = with_disturbances(past, ahead.size, disturbances), len(past)
        highest = min(HIGHEST, n // PER_ORDER)
        chosen = _chosen(input_equations(y, u, highest, *(d[:n] for d in others.T)))
        given = np.column_stack([np.concatenate([u, later]), others])
        mean = levels[0] + noise * _mean(chosen, y, given, ahead.size)
        reach = ndtri((1.0 + self._confidence) / 2.0) * noise * _spread(chosen, ahead.size)
        low, high = self._plant.output.span
        band = Band(np.clip(mean, low, high), mean - reach, mean + reach)
        return _under_inputs(self.name, past, ahead, band, self._confidence)


def _chosen(found: list[Equation]) -> Equation:
    """The stable equation of least BIC; if none is stable, the one that diverges most slowly."""
    radii = [float(np.abs(np.roots(np.append(1.0, -e.past[:, 0]))).max(initial=0.0)) for e in found]
    stable = [e for e, radius in zip(found, radii, strict=True) if radius < 1.0]
    return min(stable, key=lambda e: e.bic) if stable else found[int(np.argmin(radii))]


def _mean(equation: Equation, output: FloatArray, given: FloatArray, count: int) -> FloatArray:
    """The future output, shape (count,); `given` holds past and future inputs and disturbances, shape
    (N + count, 1 + d)."""
    order = len(equation.past)
    held = output[-order:].tolist()
    known = output.size
    for k in range(count):
        others = given[known + k - order : known + k][::-1]
        own = np.array(held[-order:][::-1])
        held.append(
            float(equation.constant + own @ equation.past[:, 0] + np.sum(others * equation.past[:, 1:]))
        )
    return np.array(held[order:], dtype=np.float64)


def _spread(equation: Equation, count: int) -> FloatArray:
    """Standard deviation of the future output, shape (count,)."""
    weights = np.zeros(count)
    for k in range(count):
        newest = weights[max(k - len(equation.past), 0) : k][::-1]
        weights[k] = 1.0 if k == 0 else newest @ equation.past[: newest.size, 0]
    return np.asarray(np.sqrt(equation.variance * np.cumsum(np.square(weights))), dtype=np.float64)


def _under_inputs(name: str, past: Window, ahead: FloatArray, output: Band, confidence: float) -> Forecast:
    given = np.array(ahead, dtype=np.float64)
    return Forecast(
        sample=past.last,
        candidate=name,
        structure="",
        confidence=confidence,
        time=np.asarray(past.period * np.arange(1, given.size + 1), dtype=np.float64),
        reference=np.full(given.size, np.nan),
        output=output,
        input=Band(given, given, given),
    )
