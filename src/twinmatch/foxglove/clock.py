"""Which time the viewers are told: that of the plant where there is one, else that of the wall."""

from __future__ import annotations

import time

__all__ = ["StreamTime"]

GRACE = 5.0
"""Seconds for which /clock has to be gone before a sample is taken for one of a graph without it."""


class StreamTime:
    """Follows /clock while it is published, and stands still after it until a graph without it has samples.

    So what was played can still be looked at after its end. Every change from one kind of time to the other
    is told, because viewers have to begin anew then.
    """

    def __init__(self) -> None:
        """Begin with wall time."""
        self._plant: int | None = None
        self._heard = 0.0

    @property
    def now(self) -> int:
        """Time, ns since the epoch of its clock."""
        return time.time_ns() if self._plant is None else self._plant

    def on_clock(self, stamp: int, at: float) -> bool:
        """Take over what /clock says (ns) at a monotonic time (s); whether the kind of time has changed."""
        changed = self._plant is None
        self._plant, self._heard = stamp, at
        return changed

    def on_sample(self, at: float, *, clock: bool) -> bool:
        """Note a sample, and whether anybody publishes /clock; whether the kind of time has changed."""
        if self._plant is None or clock or at - self._heard < GRACE:
            return False
        self._plant = None
        return True
