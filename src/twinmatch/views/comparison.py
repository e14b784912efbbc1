"""Plant and twins side by side over a whole session."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinmatch.plant import PidGains, Response, RigParameters, simulate_driven, simulate_window
from twinmatch.signals import KELVIN, FloatArray, Sample, Window, unbroken

__all__ = ["Comparison", "compare", "rolling_rms", "root_mean_square"]

_SKIPPED = 2
"""A twin starts at the third sample, where the controller's memory is known."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """One unbroken stretch of samples and what the twins make of it; arrays from its third sample on."""

    window: Window
    closed: Response
    """The closed-loop twin: given the set-point, it answers with temperature (°C) and control (counts)."""
    driven: FloatArray
    """The driven twin's temperature, °C: it is given the measured control."""

    @property
    def time(self) -> FloatArray:
        """Seconds since the session began."""
        return self.window.time[_SKIPPED:]

    @property
    def closed_residual_y(self) -> FloatArray:
        """Measured minus closed-loop-twin temperature, °C."""
        return np.asarray(self.window.output[_SKIPPED:] - self.closed.output)

    @property
    def closed_residual_u(self) -> FloatArray:
        """Measured minus closed-loop-twin control, counts."""
        return np.asarray(self.window.input[_SKIPPED:] - self.closed.input)

    @property
    def driven_residual_y(self) -> FloatArray:
        """Measured minus driven-twin temperature, °C."""
        return np.asarray(self.window.output[_SKIPPED:] - self.driven)


def compare(samples: Sequence[Sample], parameters: RigParameters, gains: PidGains) -> tuple[Comparison, ...]:
    """Run both twins over every unbroken stretch of at least four samples, each from its measured start."""
    found = []
    for stretch in unbroken(samples):
        if len(stretch) < _SKIPPED + 2:
            continue
        window = Window.from_samples(stretch, gains.period)
        plate = float(window.output[_SKIPPED]) + KELVIN
        driven = simulate_driven(parameters, window.input[_SKIPPED:], plate=plate, period=window.period)
        found.append(Comparison(window, simulate_window(parameters, window, gains=gains), driven.output))
    return tuple(found)


def root_mean_square(parts: Sequence[FloatArray]) -> float:
    """RMS over all values of all parts; NaN without any."""
    values = np.concatenate(parts) if parts else np.empty(0)
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def rolling_rms(values: FloatArray, count: int) -> FloatArray:
    """RMS over the newest `count` values at each place (over fewer at the start), same shape."""
    sums = np.concatenate(([0.0], np.cumsum(values**2)))
    ends = np.arange(1, values.size + 1)
    begins = np.maximum(ends - count, 0)
    return np.asarray(np.sqrt(np.maximum(sums[ends] - sums[begins], 0.0) / (ends - begins)))
