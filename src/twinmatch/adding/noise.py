"""The noise of a sensor, from a recording of a plant that moved.

Second differences are hardly affected by a slow plant: for white noise of standard deviation σ they have the
variance 6 σ²; the median is robust to a few jumps. A sensor that rounds to steps q has at least q/√12.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from twinmatch.signals import FloatArray

__all__ = ["noise_of"]

_BLOCK: Final = 20
"""Second differences whose median shows how quiet the signal is there."""
_QUIET: Final = 0.82
"""Lower quartile of such medians of white noise, in the median of all."""
_FAR: Final = 3.0
"""A quarter of the recording is far quieter if its noise is less by this factor: white noise never is."""
_OFTEN: Final = 0.005
"""Share of the second differences that a sensor's step must have; resampling leaves a few fractions of it."""
_NEARLY_ALL: Final = 0.95
"""Share of them that are multiples of the step if the sensor has one."""
_FLOOR: Final = 1e-4
"""Least noise of values without steps, which are computed ones, as a share of their range."""


def noise_of(values: FloatArray) -> float:
    """Standard deviation of white noise on a signal, two digits.

    If a quarter of the recording is far quieter than the rest, the rest is the plant's own movement, and the
    noise is that of the quiet part.
    """
    bends = np.abs(np.diff(values, 2))
    white = _white(np.median(bends)) if bends.size else 0.0
    if bends.size >= 10 * _BLOCK:
        blocks = bends[: bends.size - bends.size % _BLOCK].reshape(-1, _BLOCK)
        quiet = _white(np.quantile(np.median(blocks, axis=1), 0.25)) / _QUIET
        white = quiet if quiet < white / _FAR else white
    step = _step(bends)
    if step:
        return float(f"{max(white, step / math.sqrt(12.0)):.2g}")
    changes = np.round(np.abs(np.diff(values)), 9)
    rounding = float(np.min(changes[changes > 0.0], initial=math.inf)) / math.sqrt(12.0)
    floor = _FLOOR * (float(np.ptp(values)) or 1.0)
    return float(f"{max(white, rounding if rounding < 10 * max(white, floor) else 0.0, floor):.2g}")


def _white(median: float | np.float64) -> float:
    """Standard deviation of white noise whose second differences have this median size."""
    return float(median) / 0.6745 / math.sqrt(6.0)


def _step(bends: FloatArray) -> float:
    """The step of a sensor that shows it; zero if the signal has none."""
    sizes, times = np.unique(np.round(bends, 9), return_counts=True)
    often = sizes[(times > _OFTEN * bends.size) & (sizes > 0.0)]
    if not often.size:
        return 0.0
    counts = bends / often[0]
    return float(often[0]) if np.mean(np.abs(counts - np.round(counts)) < 1e-3) > _NEARLY_ALL else 0.0
