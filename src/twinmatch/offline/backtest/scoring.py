"""Scores of one forecast, once its samples are known.

Everything is in units of the plant's noise, so that output and input can be counted together: an error of 1
is as large as the noise of the readings (on the Peltier rig 0.1 °C and 7 counts).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twinmatch.dynamics import Plant
from twinmatch.forecasting import Band, Forecast
from twinmatch.offline.backtest.errors import BacktestError
from twinmatch.signals import FloatArray, Window

__all__ = ["Marks", "SignalMarks", "interval_score", "marks", "samples_within"]

_ROUNDING = 1e-9
"""Relative tolerance within which a horizon counts as a whole number of samples."""


@dataclass(frozen=True, slots=True)
class SignalMarks:
    """Scores of one signal over the path up to a horizon, in units of its noise."""

    rms: float
    """Root of the mean squared error of the mean."""
    end: float
    """Error at the horizon itself: measured minus forecast mean."""
    coverage: float
    """Share of the samples within the band, edges included."""
    width: float
    """Mean width of the band."""
    score: float
    """Mean interval score of the band; smaller is better."""


@dataclass(frozen=True, slots=True)
class Marks:
    """Scores of a forecast up to a horizon."""

    output: SignalMarks
    input: SignalMarks | None
    """None if the input was given."""

    @property
    def error(self) -> float:
        """Both signals together: root of the mean of their mean squared errors; or only the output's."""
        if self.input is None:
            return self.output.rms
        return math.sqrt((self.output.rms**2 + self.input.rms**2) / 2.0)

    @property
    def score(self) -> float:
        """Both signals together: mean of their interval scores; or only the output's."""
        if self.input is None:
            return self.output.score
        return (self.output.score + self.input.score) / 2.0


def interval_score(low: FloatArray, high: FloatArray, came: FloatArray, confidence: float) -> FloatArray:
    """Interval score of known values; its expectation is least for the true quantiles.

    S = (high − low) + 2/α (low − x)⁺ + 2/α (x − high)⁺ with α = 1 − confidence: Gneiting and Raftery,
    *Strictly Proper Scoring Rules, Prediction, and Estimation*, JASA 102 (2007), eq. 43.

    Args:
        low: lower ends, any shape.
        high: upper ends, the same shape.
        came: actual values, the same shape.
        confidence: share of the values that the intervals are to hold, between 0 and 1.

    Returns:
        Scores in the unit of the values, the same shape.

    Raises:
        BacktestError: the confidence is not between 0 and 1.
    """
    if not 0.0 < confidence < 1.0:
        raise BacktestError(f"interval score: the confidence is {confidence}; it must lie between 0 and 1")
    outside = np.maximum(low - came, 0.0) + np.maximum(came - high, 0.0)
    return np.asarray(high - low + 2.0 / (1.0 - confidence) * outside, dtype=np.float64)


def samples_within(horizon: float, period: float) -> int:
    """Number of samples in a horizon, for horizon and period in seconds.

    Raises:
        BacktestError: the horizon is shorter than one sample.
    """
    count = math.floor(horizon / period * (1.0 + _ROUNDING))
    if count < 1:
        msg = f"backtest: a horizon of {horizon:g} s is shorter than one sample of {period:g} s; give more"
        raise BacktestError(msg)
    return count


def marks(forecast: Forecast, came: Window, horizon: float, plant: type[Plant]) -> Marks:
    """Score the first `horizon` seconds of a forecast by the actual samples.

    Args:
        forecast: the forecast.
        came: samples beginning with the one after `forecast.sample`; at least as many as the horizon has.
        horizon: length of the path that is scored, s.
        plant: declares the noise of output and input.

    Raises:
        BacktestError: the samples are not those of the forecast, or one of both is too short.
    """
    count = samples_within(horizon, came.period)
    if came.first != forecast.sample + 1:
        msg = f"backtest: a forecast made at sample {forecast.sample} cannot be scored from {came.first} on"
        raise BacktestError(msg)
    held = min(len(came), forecast.output.mean.size, forecast.input.mean.size)
    if held < count:
        msg = f"backtest: a horizon of {horizon:g} s needs {count} samples; only {held} can be compared"
        raise BacktestError(msg)
    confidence = forecast.confidence
    return Marks(
        _signal(forecast.output, came.output, count, plant.output.noise, confidence),
        _signal(forecast.input, came.input, count, plant.drive.noise, confidence)
        if forecast.closed
        else None,
    )


def _signal(band: Band, came: FloatArray, count: int, noise: float, confidence: float) -> SignalMarks:
    x, mean, low, high = (a[:count] / noise for a in (came, band.mean, band.low, band.high))
    error = x - mean
    return SignalMarks(
        rms=float(np.sqrt(np.mean(error**2))),
        end=float(error[-1]),
        coverage=float(np.mean((low <= x) & (x <= high))),
        width=float(np.mean(high - low)),
        score=float(np.mean(interval_score(low, high, x, confidence))),
    )
