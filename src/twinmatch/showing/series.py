"""Series for pictures and sentences: plant and twins side by side, and forecasts beside what was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinmatch.dynamics import Parameters, Response, begin_window, simulate_driven
from twinmatch.dynamics.simulation import SKIPPED
from twinmatch.forecasting import Band, Forecast
from twinmatch.signals import FloatArray, Window, column_of, only, rms
from twinmatch.twin import TwinSettings, response_on


@dataclass(frozen=True, eq=False)
class Comparison:
    """One unbroken stretch of samples and the twins' responses on it; arrays start at its third sample."""

    window: Window
    closed: Response | None
    """Output and input of the closed-loop twin, driven by the set-point; None where the loop is not known."""
    driven: FloatArray
    """Outputs of the driven twin, driven by the measured input, shape (N, o)."""

    def alone(self, k: int) -> Comparison:
        """The comparison of the k-th output and input alone; where there are fewer, of the last."""
        closed = self.closed and self.closed.alone(k)
        return Comparison(self.window.alone(k), closed, column_of(self.driven, k))

    @property
    def driven_output(self) -> FloatArray:
        """Output of the driven twin of a single loop, shape (N,)."""
        return only("output", self.driven)

    @property
    def time(self) -> FloatArray:
        """Seconds since the session began."""
        return self.window.time[SKIPPED:]

    @property
    def received(self) -> FloatArray:
        """Times of the samples that were received, s: only these have residuals."""
        return self.window.received(self.time)

    @property
    def closed_residual_y(self) -> FloatArray:
        """Measured minus closed-loop-twin output; empty without one."""
        return (
            np.empty(0)
            if self.closed is None
            else self._off(self.window.output, self.closed.output)
        )

    @property
    def closed_residual_u(self) -> FloatArray:
        """Measured minus closed-loop-twin input; empty without one."""
        return (
            np.empty(0)
            if self.closed is None
            else self._off(self.window.input, self.closed.input)
        )

    @property
    def driven_residual_y(self) -> FloatArray:
        """Measured minus driven-twin output."""
        return self._off(self.window.output, self.driven_output)

    def _off(self, measured: FloatArray, twin: FloatArray) -> FloatArray:
        return self.window.received(measured[SKIPPED:] - twin)


def compare(
    stretches: Sequence[Window], parameters: Parameters, settings: TwinSettings
) -> tuple[Comparison, ...]:
    """Run the twins over every stretch of at least four samples, from its measured initial values, or, where
    the loop is not known, from estimated ones."""
    comparisons = []
    law = settings.law
    for window in stretches:
        if len(window) < SKIPPED + 2:
            continue
        if law is None:
            comparisons.append(
                Comparison(window, None, response_on(parameters, window, None).outputs)
            )
            continue
        states = begin_window(parameters, window)
        measured = window.disturbances[SKIPPED:]
        inputs = window.inputs[SKIPPED:]
        step = window.period
        driven = simulate_driven(
            parameters, inputs, states=states, period=step, disturbances=measured
        )
        comparisons.append(
            Comparison(window, response_on(parameters, window, law), driven.outputs)
        )
    return tuple(comparisons)


def root_mean_square(parts: Sequence[FloatArray]) -> float:
    """RMS over all values of all parts; NaN without values."""
    values = np.concatenate(parts) if parts else np.empty(0)
    return float(rms(values)) if values.size else float("nan")


def rolling_rms(values: FloatArray, count: int) -> FloatArray:
    """RMS over the last `count` values at each place (over fewer at the start), same shape."""
    sums = np.concatenate(([0.0], np.cumsum(values**2)))
    ends = np.arange(1, values.size + 1)
    begins = np.maximum(ends - count, 0)
    return np.asarray(
        np.sqrt(np.maximum(sums[ends] - sums[begins], 0.0) / (ends - begins))
    )


_BEFORE = 0.4
"""Length of the known samples that are kept, as a share of the forecast's length."""


@dataclass(frozen=True, eq=False)
class Fan:
    """One forecast with the samples around it."""

    forecast: Forecast
    past: Window
    """The newest samples known; the last is the one the forecast was made at."""
    measured: Window | None
    """Measurements after it, for as long as set-point (or input) followed the forecast; None if it never
    did."""

    def alone(self, k: int) -> Fan:
        """Its k-th output and input; of fewer the last."""
        measured = None if self.measured is None else self.measured.alone(k)
        return Fan(self.forecast.alone(k), self.past.alone(k), measured)

    @property
    def judged(self) -> int:
        """How many of the forecast's samples are compared, including a few that may have been lost."""
        return 0 if self.measured is None else len(self.measured)

    @property
    def times(self) -> FloatArray:
        """When the samples came that are compared and were received, s after the forecast, shape (k,)."""
        return (
            np.empty(0)
            if self.measured is None
            else self.measured.received(self._ahead(self.forecast.time))
        )

    @property
    def error(self) -> FloatArray:
        """Measured output minus the mean of the forecast at these times, shape (k,)."""
        if self.measured is None:
            return np.empty(0)
        return self.measured.received(
            self.measured.output - self._ahead(self.forecast.output.mean)
        )

    @property
    def in_band(self) -> tuple[FloatArray, FloatArray]:
        """Whether the bands contained output and input at these times, 1 or 0, shape (k,); for an input that
        was prescribed, shape (0,)."""
        if self.measured is None:
            return np.empty(0), np.empty(0)
        of_output = self._inside(self.forecast.output, self.measured.output)
        if not self.forecast.closed:
            return of_output, np.empty(0)
        return of_output, self._inside(self.forecast.input, self.measured.input)

    def _ahead(self, values: FloatArray) -> FloatArray:
        return values[: self.judged]

    def _inside(self, band: Band, measured: FloatArray) -> FloatArray:
        inside = (self._ahead(band.low) <= measured) & (
            measured <= self._ahead(band.high)
        )
        is_inside = np.asarray(inside, dtype=np.float64)
        return is_inside if self.measured is None else self.measured.received(is_inside)


def fan(forecast: Forecast, stretches: Sequence[Window]) -> Fan:
    """A forecast with the samples of its session around it.

    Measurements are compared with it up to the first sample that is missing, or whose set-point (or input)
    differs from the one the forecast was made for.
    """
    size = forecast.time.size
    origin = forecast.sample
    before = max(round(_BEFORE * size), 1)
    whole = next(part for part in stretches if part.first <= origin <= part.last)
    window = whole.part(
        max(whole.first, origin - before), min(whole.last, origin + size)
    )
    levels = window.references
    assumed_levels = forecast.references
    if not forecast.closed:
        levels = window.inputs
        assumed_levels = np.column_stack([band.mean for band in forecast.inputs])
    ahead = levels[origin + 1 - window.first :]
    differing = np.flatnonzero((ahead != assumed_levels[: len(ahead)]).any(axis=1))
    count = int(differing[0]) if differing.size else len(ahead)
    measured = window.part(origin + 1, origin + count) if count else None
    return Fan(forecast, window.part(window.first, origin), measured)
