"""How fast a plant is, by the time between its samples."""

from __future__ import annotations

from typing import Final

_LONGEST_PERIOD: Final = 5.0
"""Sample time from which times grow with it, s: at 5 s the longest horizon is 60 samples, as many as a
verdict compares with the forecasts made for them."""
_SHORTEST_PERIOD: Final = 0.5
"""Sample time below which they shrink with it, s: at 0.5 s the longest horizon is 600 samples, nearly the
longest window that is matched."""


def time_scale(period: float) -> float:
    """Factor on all times that are meant for a plant sampled about once a second, such as the rig.

    In a plant that is sampled every minute, nothing can be seen ten seconds ahead, and five minutes are only
    five samples. In a motor that is sampled a hundred times a second, all has settled long before.
    Windows are counted in samples; for slow and fast samples, other times are, too.
    """
    return max(period / _LONGEST_PERIOD, min(period / _SHORTEST_PERIOD, 1.0))
