"""Check that the signal that paces the samples has the stated period."""

from __future__ import annotations

from collections import deque
from statistics import median
from typing import Final

import numpy as np

__all__ = ["Rate"]

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
