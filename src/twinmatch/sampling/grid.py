"""Numbers for the ticks of a loop that somebody else runs, so that a gap in time is a gap in the numbers."""

from __future__ import annotations

from typing import Final

__all__ = ["Grid"]

_LEAK: Final = 0.1
"""Part of a tick's lateness by which the grid moves after it."""


class Grid:
    """Ticks one period apart, whose beginning follows the ticks.

    A tick is late or on time. One that is late by a period or more means that others were missed; one that is
    early by half a period or more is none: two messages came at once. A tick a little before its time moves
    the grid: those before it were late. And as the foreign clock keeps another second than ours, each late
    tick moves the grid a little too: a loop that takes 1 % longer than it says is late by a tenth of a
    period for good, and no tick is taken for missed.
    """

    def __init__(self, period: int) -> None:
        """Begin without a tick; the period is in ns."""
        self.missed = 0
        """Ticks that were missed since the first."""
        self.jitter = 0
        """How late the newest tick was, ns."""
        self._period = period
        self._number: int | None = None
        self._newest = 0
        self._due = 0
        """When the newest tick was due, ns."""

    def place(self, now: int) -> int | None:
        """The number of the tick at `now` (ns), from 0; None if it is none."""
        if self._number is None:
            self._number, self._newest, self._due = 0, now, now
            return 0
        if now < self._newest - self._period:  # the clock was set back
            return self._begin_anew(self._number + 2, now)
        late = now - self._due - self._period
        if late <= -self._period // 2 or now <= self._newest:
            return None
        skipped, late = divmod(late, self._period) if late > 0 else (0, late)
        self.missed += skipped
        self.jitter = max(late, 0)
        self._number += 1 + skipped
        self._newest = now
        # Behind a gap the loop may have been started anew, at any moment.
        self._due = now if late < 0 or skipped else now - late + round(_LEAK * late)
        return self._number

    def _begin_anew(self, number: int, now: int) -> int:
        """One number is left out, so that whoever works on windows begins anew."""
        self.missed += 1
        self.jitter = 0
        self._number, self._newest, self._due = number, now, now
        return number
