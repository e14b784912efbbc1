"""Plant and twins side by side over a whole session."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinmatch.dynamics import Parameters, PidGains, Response, begin_window, simulate_driven
from twinmatch.dynamics.simulation import SKIPPED
from twinmatch.signals import FloatArray, Sample, Window, unbroken
from twinmatch.twin import response_on

__all__ = ["Comparison", "compare", "rolling_rms", "root_mean_square"]


@dataclass(frozen=True, eq=False)
class Comparison:
    """One unbroken stretch of samples and the twins' responses on it; arrays start at its third sample."""

    window: Window
    closed: Response | None
    """Output and input of the closed-loop twin, driven by the set-point; None where the loop is not known."""
    driven: FloatArray
    """Output of the driven twin, driven by the measured input."""

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
    """Run the twins over every unbroken stretch of at least four samples, from its measured initial values,
    or, where the loop is not known, from estimated ones.

    `period`, s, is used where the loop is not known; a known loop has the period of its controller.
    """
    found = []
    for stretch in unbroken(samples):
        if len(stretch) < SKIPPED + 2:
            continue
        window = Window.from_samples(stretch, period if gains is None else gains.period)
        if gains is None:
            found.append(Comparison(window, None, response_on(parameters, window, None).output))
            continue
        disturbances = window.disturbances[SKIPPED:]
        driven = simulate_driven(
            parameters,
            window.input[SKIPPED:],
            states=begin_window(parameters, window),
            period=window.period,
            disturbances=disturbances,
        )
        closed = response_on(parameters, window, gains)
        found.append(Comparison(window, closed, driven.output))
    return tuple(found)


def root_mean_square(parts: Sequence[FloatArray]) -> float:
    """RMS over all values of all parts; NaN without values."""
    values = np.concatenate(parts) if parts else np.empty(0)
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def rolling_rms(values: FloatArray, count: int) -> FloatArray:
    """RMS over the last `count` values at each place (over fewer at the start), same shape."""
    sums = np.concatenate(([0.0], np.cumsum(values**2)))
    ends = np.arange(1, values.size + 1)
    begins = np.maximum(ends - count, 0)
    return np.asarray(np.sqrt(np.maximum(sums[ends] - sums[begins], 0.0) / (ends - begins)))
