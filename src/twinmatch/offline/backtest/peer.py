"""What peers have in common: other forecasters, with the same samples and set-points as the twin."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from twinmatch.dynamics import Plant
from twinmatch.errors import TwinmatchError
from twinmatch.forecasting import CONFIDENCE, Band, Forecast, ForecastError
from twinmatch.signals import FloatArray, Window


class BacktestError(TwinmatchError):
    """A backtest that cannot be made: samples that do not fit a forecast, or an unknown peer."""


_EQUAL = 1e-9
"""Relative spread up to which values count as equal."""


class Peer(ABC):
    """A forecaster without a twin, for one plant; its bands are to hold this share of the samples."""

    name: ClassVar[str]
    """Name in tables and figures."""
    takes_inputs: ClassVar = True
    """Whether it can forecast an output alone, under given inputs."""

    def __init__(self, plant: type[Plant], confidence: float = CONFIDENCE, *, driven: bool = False) -> None:
        """`driven`: whether the loop is not known, so that the future inputs are given."""
        self._plant, self._confidence, self._driven = plant, confidence, driven

    @staticmethod
    def missing() -> str:
        """Why it is not available, and what to do; empty if it is."""
        return ""

    @abstractmethod
    def forecast(self, past: Window, ahead: FloatArray, disturbances: FloatArray | None = None) -> Forecast:
        """Forecast the samples after a window.

        Args:
            past: all samples up to and including the newest; nothing else is known.
            ahead: future set-points, or inputs if the loop is not known, shape (N,).
            disturbances: those measured at these samples, shape (N, d), as the twin is given them; default:
                they keep their last value.

        Raises:
            ForecastError: the past is too short.
        """

    def _require(self, past: Window, least: int) -> None:
        if len(past) < least:
            few = f"{len(past)} samples are too few for a forecast; give at least {least}"
            raise ForecastError(f"{self.name}: {few}")

    def _told(self, past: Window, ahead: FloatArray, output: Band, entry: Band | None = None) -> Forecast:
        """The forecast with these bands; the input and its band are clipped to the drive's limits.

        Without a band of the input (`entry`), it is one of the output under the inputs `ahead`.
        """
        values = np.array(ahead, dtype=np.float64)
        given = Band(values, values, values)
        if entry is not None:
            ends = (entry.mean, entry.low, entry.high)
            given = Band(*(np.clip(end, *self._plant.drive.limits) for end in ends))
        return Forecast(
            sample=past.last,
            candidate=self.name,
            structure="",
            confidence=self._confidence,
            time=np.asarray(past.period * np.arange(1, values.size + 1), dtype=np.float64),
            references=np.full(values.size, np.nan) if entry is None else values,
            outputs=(output,),
            inputs=(given,),
        )


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
