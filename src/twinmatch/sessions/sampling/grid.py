"""Numbers for the ticks of a foreign loop, so that a gap in time is a gap in the numbers."""

from __future__ import annotations

from typing import Final

__all__ = ["Grid"]

_LEAK: Final = 0.1
"""Fraction of a tick's lateness by which the grid is moved after it."""


class Grid:
    """A grid of ticks one period apart, whose origin follows the ticks.

    A tick that is late by a period or more means that others were missed. One that is early by half a period
    or more does not count: two messages arrived at once. One that is slightly early moves the grid, because
    the ticks before it were late. Since the foreign clock runs at a slightly different rate than ours, each
    late tick moves the grid a little too: a loop that is 1 % slower than stated stays late by a tenth of a
    period, and no tick is counted as missed.
    """

    def __init__(self, period: int) -> None:
        """Start without a tick; the period is in ns."""
        self.missed = 0
        """Ticks missed since the first."""
        self.jitter = 0
        """Lateness of the newest tick, ns."""
        self._period = period
        self._number: int | None = None
        self._newest = 0
        self._due = 0
        """When the newest tick was due, ns."""

    def place(self, now: int) -> int | None:
        """The number of the tick at `now` (ns), from 0; None if it does not count."""
        if self._number is None:
            self._number, self._newest, self._due = 0, now, now
            return 0
        if now < self._newest - self._period:  # the clock was set back
            return self._restart(self._number + 2, now)
        late = now - self._due - self._period
        if late <= -self._period // 2 or now <= self._newest:
            return None
        skipped, late = divmod(late, self._period) if late > 0 else (0, late)
        self.missed += skipped
        self.jitter = max(late, 0)
        self._number += 1 + skipped
        self._newest = now
        # During a gap the loop may have been restarted, at any time.
        self._due = now if late < 0 or skipped else now - late + round(_LEAK * late)
        return self._number

    def _restart(self, number: int, now: int) -> int:
        """Restart the grid and leave out one number, so that windows of samples start over."""
        self.missed += 1
        self.jitter = 0
        self._number, self._newest, self._due = number, now, now
        return number
