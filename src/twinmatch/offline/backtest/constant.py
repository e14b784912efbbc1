"""A band of constant width from a twin's residuals, without a model of the uncertainty."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twinmatch.dynamics import SKIPPED, Parameters, PidGains
from twinmatch.forecasting import Band, Forecast
from twinmatch.signals import FloatArray, Window
from twinmatch.twin import response_on

__all__ = ["with_constant_band"]


def with_constant_band(
    forecast: Forecast, parameters: Parameters, past: Window, gains: PidGains | None
) -> Forecast:
    """The same means with a band of one width at all horizons.

    The band contains its share of the residuals of the closed-loop twin over the whole past (measured minus
    twin, for output and input), or of the driven twin (output only). The twin was matched on part of that
    past, so the band tends to be narrow; such bands are usually made so.

    Args:
        forecast: the twin's forecast.
        parameters: parameters of that twin.
        past: all samples up to the forecast, at least four.
        gains: gains of its controller; None if the loop is not known.
    """
    twin = response_on(parameters, past, gains)
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
