"""A time that only runs forward, derived from a clock that may not."""

from __future__ import annotations

import math
from dataclasses import dataclass

from twinmatch.safety.limits import within_a_minute
from twinmatch.signals import NANOSECONDS


@dataclass(frozen=True)
class ClockLimits:
    """A clock stands still if it does not advance by `progress` within `patience`, or has never advanced."""

    patience: float = 1.0
    """Wall time, s."""
    progress: float = 0.05
    """Plant time, s; a rig slowed down more than twentyfold is therefore not driven either."""

    def __post_init__(self) -> None:
        within_a_minute("clock", patience=self.patience, progress=self.progress)


class SafetyClock:
    """Time for safety decisions, which sums the forward steps of a clock that cannot be trusted.

    Deadlines are in plant time, which a simulation may stop, set back or run faster than the wall clock. A
    step back counts as zero, and later steps count as usual: a running deadline continues from where it
    was, however far and however often the clock jumps back. A jump forward counts in full, so that deadlines
    err towards zero output.
    """

    def __init__(self, limits: ClockLimits | None = None) -> None:
        """Start at zero with the first reading."""
        self.limits = limits or ClockLimits()
        self.standing = math.inf
        """Wall time since the plant's clock last made progress, s; infinite before the first."""
        self._now = 0
        self._plant: int | None = None
        self._mark = 0  # derived time of the last progress, ns
        self._seen: int | None = None  # wall time of the last progress, ns

    @property
    def stopped(self) -> bool:
        """Whether the clock stands still."""
        return self.standing > self.limits.patience

    def read(self, plant: int, wall: int) -> float:
        """The derived time, s, given the plant's clock and a monotonic wall clock (both ns)."""
        if self._plant is not None:
            self._now += max(0, plant - self._plant)
        self._plant = plant
        if self._now - self._mark >= self.limits.progress * NANOSECONDS:
            self._mark = self._now
            self._seen = wall
        if self._seen is not None:
            self.standing = (wall - self._seen) / NANOSECONDS
        return self._now / NANOSECONDS
