"""The values of one signal in order of arrival, and the value or mean that belongs to a tick."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

__all__ = ["Held"]

_MOST: Final = 100_000
"""Most values kept for a mean; of more values in a period, only the newest are averaged."""


class Held:
    """The newest value, and as many before it as a mean may need."""

    def __init__(self) -> None:
        """Start without values."""
        self.refused = 0
        """Values that were not finite."""
        self._values: deque[tuple[int, float]] = deque(maxlen=_MOST)

    def push(self, value: float, at: int) -> None:
        """Take a value with its time `at` (ns); a value that is not finite is only counted."""
        if not math.isfinite(value):
            self.refused += 1
            return
        if (
            self._values and at < self._values[-1][0]
        ):  # a clock was set back: the earlier times are not comparable
            self._values.clear()
        self._values.append((at, value))

    @property
    def newest(self) -> float | None:
        """The newest value."""
        return self._values[-1][1] if self._values else None

    @property
    def time(self) -> int | None:
        """Time of the newest value, ns."""
        return self._values[-1][0] if self._values else None

    def mean(self, start: int, end: int) -> float | None:
        """Mean from `start` to `end` (ns) under zero-order hold; None if there was no value at the start.

        Forgets earlier values.
        """
        while len(self._values) > 1 and self._values[1][0] <= start:
            self._values.popleft()
        if not self._values or self._values[0][0] > start:
            return None
        steps = [(max(at, start), value) for at, value in self._values if at < end]
        if len({value for _, value in steps}) == 1:  # exactly, without the rounding of a sum
            return steps[0][1]
        ends = [at for at, _ in steps[1:]] + [end]
        total = math.fsum(value * (until - at) for (at, value), until in zip(steps, ends, strict=True))
        values = [value for _, value in steps]
        return min(max(total / (end - start), min(values)), max(values))
