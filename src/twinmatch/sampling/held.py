"""The values of one signal as they came, and what of them belongs to a tick."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

__all__ = ["Held"]

_MOST: Final = 100_000
"""Values kept for a mean; of a topic with more in a period, the newest count."""


class Held:
    """The newest value, and those before it as far back as a mean may need them."""

    def __init__(self) -> None:
        """Begin with none."""
        self.refused = 0
        """Values that were not finite."""
        self._values: deque[tuple[int, float]] = deque(maxlen=_MOST)

    def push(self, value: float, at: int) -> None:
        """Take a value of the time `at` (ns); one that is not finite is only counted."""
        if not math.isfinite(value):
            self.refused += 1
            return
        if self._values and at < self._values[-1][0]:  # a clock was set back: what was before is of another
            self._values.clear()
        self._values.append((at, value))

    @property
    def newest(self) -> float | None:
        """The newest value."""
        return self._values[-1][1] if self._values else None

    @property
    def time(self) -> int | None:
        """When it was, ns."""
        return self._values[-1][0] if self._values else None

    def mean(self, start: int, end: int) -> float | None:
        """Mean from `start` to `end` (ns) of what stands from each value until the next; None if there was
        none yet at the start. Forgets what was before."""
        while len(self._values) > 1 and self._values[1][0] <= start:
            self._values.popleft()
        if not self._values or self._values[0][0] > start:
            return None
        steps = [(max(at, start), value) for at, value in self._values if at < end]
        if len({value for _, value in steps}) == 1:  # exactly, whatever the digits of a sum
            return steps[0][1]
        ends = [at for at, _ in steps[1:]] + [end]
        total = math.fsum(value * (until - at) for (at, value), until in zip(steps, ends, strict=True))
        values = [value for _, value in steps]
        return min(max(total / (end - start), min(values)), max(values))
