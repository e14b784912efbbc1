"""The interface of peers: other forecasters, with the same samples and set-points as the twin."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from twinmatch.dynamics import Plant
from twinmatch.errors import TwinmatchError
from twinmatch.forecasting import Band, Forecast, ForecastError
from twinmatch.signals import FloatArray, Window


class BacktestError(TwinmatchError):
    """A backtest that cannot be made: samples that do not fit a forecast, or an unknown peer."""


_EQUAL = 1e-9
"""Relative spread up to which values count as equal."""


class Peer(Protocol):
    """A forecaster without a twin."""

    @property
    def name(self) -> str:
        """Name in tables and figures."""
        ...

    def forecast(self, past: Window, ahead: FloatArray, disturbances: FloatArray | None = None) -> Forecast:
        """Forecast the samples after a window.

        Args:
            past: all samples up to and including the newest; nothing else is known.
            ahead: future set-points, or inputs if the loop is not known, shape (N,).
            disturbances: those measured at these samples, shape (N, d), as the twin is given them; default:
                they keep their last value.
        """
        ...


def enough(name: str, past: Window, least: int) -> None:
    """Raises:
    ForecastError: the past has fewer samples than this.
    """
    if len(past) < least:
        raise ForecastError(f"{name}: {len(past)} samples are too few for a forecast; give at least {least}")


def with_disturbances(past: Window, count: int, ahead: FloatArray | None) -> FloatArray:
    """The measured disturbances of the N past and the next `count` samples, shape (N + count, d).

    They are relative to the mean of the past and in units of its spread; those that never changed are left
    out.
    """
    if ahead is None:
        ahead = np.tile(past.disturbances[-1:], (count, 1))
    level, spread = past.disturbances.mean(axis=0), past.disturbances.std(axis=0)
    # The mean of equal values may be off by their rounding.
    moved = spread > _EQUAL * np.maximum(np.abs(level), 1.0)
    both = np.concatenate([past.disturbances, ahead])[:, moved]
    return np.asarray((both - level[moved]) / spread[moved], dtype=np.float64)


def banded(
    name: str,
    past: Window,
    ahead: FloatArray,
    *,
    output: Band,
    entry: Band,
    plant: type[Plant],
    confidence: float,
) -> Forecast:
    """A peer's forecast; the input and its band are clipped to the drive's limits."""
    return Forecast(
        sample=past.last,
        candidate=name,
        structure="",
        confidence=confidence,
        time=np.asarray(past.period * np.arange(1, ahead.size + 1), dtype=np.float64),
        reference=np.asarray(ahead, dtype=np.float64),
        output=output,
        input=Band(*(np.clip(a, *plant.drive.limits) for a in (entry.mean, entry.low, entry.high))),
    )


def under_inputs(name: str, past: Window, ahead: FloatArray, output: Band, confidence: float) -> Forecast:
    """A peer's forecast of the output under given inputs."""
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
