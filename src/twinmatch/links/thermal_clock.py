"""Convert a frame's stamp from the clock of the camera's computer to ours.

Stamps in the stream are of the server's monotonic clock. The difference between our time of receipt and a
stamp is the offset of the clocks plus the transit time of the frame. Transit times are never negative, so the
smallest recent difference is the offset plus the shortest transit time. Stamps converted with it are late by
that shortest transit time, about a millisecond on a quiet network, and never early; on a single computer,
where the offset is zero, this can be checked. The memory is short, so that a relative clock drift of 50 ppm
costs milliseconds at most.
"""

from __future__ import annotations

__all__ = ["CLOCK_MEMORY", "StampMapper"]

CLOCK_MEMORY = 30_000_000_000
"""Length of the intervals for which the smallest difference is kept, ns; the last two intervals count."""


class StampMapper:
    """Maps stamps of a server's clock to ours; one object per run of a server."""

    def __init__(self, memory: int = CLOCK_MEMORY) -> None:
        self._memory = memory
        self._stretch_start: int | None = None
        self._current: int | None = None
        self._previous: int | None = None

    def map(self, stamp: int, received: int) -> int:
        """Time on our clock, ns, at which a frame stamped `stamp` and received at `received` was taken."""
        difference = received - stamp
        if self._stretch_start is None or self._current is None:
            self._stretch_start, self._current = received, difference
        elif received - self._stretch_start >= self._memory:
            self._previous = self._current
            self._stretch_start, self._current = received, difference
        else:
            self._current = min(self._current, difference)
        offset = self._current if self._previous is None else min(self._current, self._previous)
        return stamp + offset
