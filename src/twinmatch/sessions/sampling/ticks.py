"""Ticks of a foreign loop: their numbers, so that a gap in time is a gap in the numbers, and their rate."""

from __future__ import annotations

from collections import deque
from statistics import median
from typing import Final

import numpy as np

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


_FEWEST: Final = 5
"""Fewest intervals for an estimate."""
_MOST: Final = 100
_REGULAR: Final = 0.5
"""Relative deviation from the median up to which an interval is regular: neither gap nor burst."""
_TOLERATED: Final = 0.01
"""Tolerated relative error of the period: a twin's time constants are off by as much."""


class Rate:
    """The newest intervals between ticks."""

    def __init__(self) -> None:
        """Start without intervals."""
        self._intervals: deque[float] = deque(maxlen=_MOST)
        self._last: int | None = None

    def push(self, now: int) -> None:
        """Take the time of a tick, ns."""
        if self._last is not None:
            self._intervals.append((now - self._last) / 1e9)
        self._last = now

    @property
    def period(self) -> float | None:
        """Mean of the intervals without gaps and bursts, s; None while there are too few."""
        regular = self._regular()
        return float(regular.mean()) if regular.size >= _FEWEST else None

    def differs_from(self, period: float) -> bool:
        """Whether the intervals significantly differ from a period (s)."""
        regular = self._regular()
        if regular.size < _FEWEST:
            return False
        # The lateness of single ticks cancels in the mean, except for the first and the last.
        unsure = 2.0 * float(regular.std()) / regular.size
        return bool(abs(regular.mean() - period) > _TOLERATED * period + unsure)

    def _regular(self) -> np.ndarray:
        if not self._intervals:
            return np.empty(0)
        usual = median(self._intervals)
        found = np.array(self._intervals)
        return found[np.abs(found - usual) <= _REGULAR * usual]
