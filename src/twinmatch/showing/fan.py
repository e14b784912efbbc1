"""A forecast with the samples around it: those known when it was made, and those measured afterwards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinmatch.forecasting import Band, Forecast
from twinmatch.signals import FloatArray, Sample, Window, unbroken

__all__ = ["Fan", "fan"]

_BEFORE = 0.4
"""Length of the known samples that are kept, as a share of the forecast's length."""


@dataclass(frozen=True, eq=False)
class Fan:
    """One forecast with the samples around it."""

    forecast: Forecast
    past: Window
    """The newest samples known; the last is the one the forecast was made at."""
    came: Window | None
    """Measurements after it, for as long as set-point (or input) followed the forecast; None if it never
    did."""

    @property
    def judged(self) -> int:
        """How many of the forecast's samples have a measurement."""
        return 0 if self.came is None else len(self.came)

    @property
    def error(self) -> FloatArray:
        """Measured output minus the mean of the forecast, shape (judged,)."""
        mean = self.forecast.output.mean[: self.judged]
        return np.asarray((self.came.output if self.came is not None else mean) - mean)

    @property
    def held(self) -> tuple[FloatArray, FloatArray]:
        """Whether the bands contained output and input, 1 or 0 per measured sample, shape (judged,); for an
        input that was prescribed, shape (0,)."""
        if self.came is None:
            return np.empty(0), np.empty(0)
        of_output = _inside(self.forecast.output, self.came.output)
        if not self.forecast.closed:
            return of_output, np.empty(0)
        return of_output, _inside(self.forecast.input, self.came.input)


def fan(forecast: Forecast, samples: Sequence[Sample], period: float) -> Fan:
    """A forecast with the samples of its session around it.

    Measurements are compared with it up to the first sample that is missing, or whose set-point (or input)
    differs from the one the forecast was made for.

    Args:
        forecast: made at one of the samples.
        samples: the session's, in order.
        period: s.
    """
    size, now = forecast.time.size, forecast.sample
    before = max(round(_BEFORE * size), 1)
    near = [s for s in samples if now - before <= s.index <= now + size]
    stretch = next(part for part in unbroken(near) if part[0].index <= now <= part[-1].index)
    window = Window.from_samples(stretch, period)
    levels, asked = window.reference, forecast.reference
    if not forecast.closed:
        levels, asked = window.input, forecast.input.mean
    ahead = levels[now + 1 - window.first :]
    other = np.flatnonzero(ahead != asked[: ahead.size])
    count = int(other[0]) if other.size else ahead.size
    came = window.part(now + 1, now + count) if count else None
    return Fan(forecast, window.part(window.first, now), came)


def _inside(band: Band, came: FloatArray) -> FloatArray:
    size = came.size
    return np.asarray((band.low[:size] <= came) & (came <= band.high[:size]), dtype=np.float64)
