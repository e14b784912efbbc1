"""The time sent to viewers: that of /clock if it is published, otherwise wall time."""

from __future__ import annotations

import time

__all__ = ["StreamTime"]

GRACE = 5.0
"""Seconds without /clock after which a sample counts as one of a graph without it."""


class StreamTime:
    """Follows /clock while it is published, then stops until a graph without /clock has samples.

    A replay can therefore still be viewed after its end. Every change between the two kinds of time is
    reported, because viewers must then be reset.
    """

    def __init__(self) -> None:
        """Start with wall time."""
        self._plant: int | None = None
        self._received = 0.0

    @property
    def now(self) -> int:
        """Time, ns since the epoch of its clock."""
        return time.time_ns() if self._plant is None else self._plant

    def on_clock(self, stamp: int, at: float) -> bool:
        """Take the time of /clock (ns), received at a monotonic time (s); returns whether the kind of time
        has changed."""
        changed = self._plant is None
        self._plant, self._received = stamp, at
        return changed

    def on_sample(self, at: float, *, clock: bool) -> bool:
        """Note a sample, and whether /clock has a publisher; returns whether the kind of time has changed."""
        if self._plant is None or clock or at - self._received < GRACE:
            return False
        self._plant = None
        return True
