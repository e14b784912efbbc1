"""One reading of the sensor, compiled."""

from __future__ import annotations

import math

from twinmatch.compiled import compiled

__all__ = ["reading"]


@compiled
def reading(seen: float, noise: float, frozen: bool, resolution: float, last: float) -> float:
    """The reading of a value: noisy and quantised; the last reading while the sensor is frozen."""
    if frozen:
        return last
    value = seen + noise
    return math.floor(value / resolution + 0.5) * resolution if resolution > 0.0 else value
