"""One reading of the sensor, compiled."""

from __future__ import annotations

import math

from twinmatch.compiled import compiled

__all__ = ["reading"]


@compiled
def reading(seen: float, noise: float, frozen: bool, resolution: float, last: float) -> float:
    """What the sensor says of what it sees: noisy, quantised; the last reading while it is frozen."""
    if frozen:
        return last
    value = seen + noise
    return math.floor(value / resolution + 0.5) * resolution if resolution > 0.0 else value
