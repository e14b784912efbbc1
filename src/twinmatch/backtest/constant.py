"""The band somebody would draw who has a twin and its residuals, and no model of what is uncertain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twinmatch.dynamics import SKIPPED, Parameters, PidGains, simulate_window
from twinmatch.forecasting import Band, Forecast
from twinmatch.signals import FloatArray, Window

__all__ = ["with_constant_band"]


def with_constant_band(
    forecast: Forecast, parameters: Parameters, past: Window, gains: PidGains | None
) -> Forecast:
    """The same means with a band of one width, however far ahead.

    The band is what held its share of the residuals of the closed-loop twin over the whole past: measured
    minus twin, of output and of input; or of the driven twin, of the output alone. On part of that past the
    twin was matched, so that the band tends to be narrow; that is how such bands are made.

    Args:
        forecast: what the twin says.
        parameters: of that twin.
        past: all samples up to the forecast, at least four.
        gains: of its controller; None for a loop that is not known.
    """
    twin = simulate_window(parameters, past, gains=gains)
    output = _around(forecast.output.mean, past.output[SKIPPED:] - twin.output, forecast.confidence)
    if gains is None:
        return replace(forecast, output=output)
    low, high = parameters.model.plant.drive.limits
    entry = _around(forecast.input.mean, past.input[SKIPPED:] - twin.input, forecast.confidence)
    return replace(
        forecast,
        output=output,
        input=Band(entry.mean, np.clip(entry.low, low, high), np.clip(entry.high, low, high)),
    )


def _around(mean: FloatArray, residuals: FloatArray, confidence: float) -> Band:
    low, high = np.quantile(residuals, ((1.0 - confidence) / 2.0, (1.0 + confidence) / 2.0))
    return Band(mean, mean + low, mean + high)
