"""Plant and twins side by side over a whole session."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinmatch.dynamics import Parameters, PidGains, Response, begin, simulate_driven, simulate_window
from twinmatch.dynamics.simulation import SKIPPED
from twinmatch.signals import FloatArray, Sample, Window, unbroken

__all__ = ["Comparison", "compare", "rolling_rms", "root_mean_square"]


@dataclass(frozen=True, eq=False)
class Comparison:
    """One unbroken stretch of samples and what the twins make of it; arrays from its third sample on."""

    window: Window
    closed: Response | None
    """The closed-loop twin: given the set-point, it answers with output and input; None where the loop is not
    known."""
    driven: FloatArray
    """The driven twin's output: it is given the measured input."""

    @property
    def time(self) -> FloatArray:
        """Seconds since the session began."""
        return self.window.time[SKIPPED:]

    @property
    def closed_residual_y(self) -> FloatArray:
        """Measured minus closed-loop-twin output; empty without one."""
        if self.closed is None:
            return np.empty(0)
        return np.asarray(self.window.output[SKIPPED:] - self.closed.output)

    @property
    def closed_residual_u(self) -> FloatArray:
        """Measured minus closed-loop-twin input; empty without one."""
        if self.closed is None:
            return np.empty(0)
        return np.asarray(self.window.input[SKIPPED:] - self.closed.input)

    @property
    def driven_residual_y(self) -> FloatArray:
        """Measured minus driven-twin output."""
        return np.asarray(self.window.output[SKIPPED:] - self.driven)


def compare(
    samples: Sequence[Sample], parameters: Parameters, gains: PidGains | None, period: float = 1.0
) -> tuple[Comparison, ...]:
    """Run the twins over every unbroken stretch of at least four samples, each from its measured start.

    The period, s, is that of a plant whose loop is not known; a loop has its controller's.
    """
    found = []
    for stretch in unbroken(samples):
        if len(stretch) < SKIPPED + 2:
            continue
        window = Window.from_samples(stretch, period if gains is None else gains.period)
        disturbances = window.disturbances[SKIPPED:]
        driven = simulate_driven(
            parameters,
            window.input[SKIPPED:],
            states=begin(parameters, float(window.output[SKIPPED]), disturbances=disturbances[0]),
            period=window.period,
            disturbances=disturbances,
        )
        closed = None if gains is None else simulate_window(parameters, window, gains=gains)
        found.append(Comparison(window, closed, driven.output))
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
