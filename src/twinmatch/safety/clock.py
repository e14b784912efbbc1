"""Time for safety decisions, made of a clock that cannot be trusted.

Deadlines of the rig are in the plant's time, which a simulation may stop, set back or run many times as
fast as the wall's. The time made here only runs forward, and it tells when the clock under it stands still.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from twinmatch.safety.errors import SafetyError

__all__ = ["ClockLimits", "SafetyClock"]

NANOSECONDS = 1_000_000_000


@dataclass(frozen=True)
class ClockLimits:
    """A clock stands still when it does not advance by `progress` within `patience`, or never has yet."""

    patience: float = 1.0
    """Seconds of the wall clock."""
    progress: float = 0.05
    """Seconds of the plant's clock; so a rig slowed down more than twentyfold is not driven either."""

    def __post_init__(self) -> None:
        for name in ("patience", "progress"):
            if not 0 < getattr(self, name) <= 60:
                msg = f"clock limits: {name} is {getattr(self, name)} s; it must be within 0 to 60 s"
                raise SafetyError(msg)


class SafetyClock:
    """Adds up the steps a clock makes forward.

    A step back counts as no time, and what follows it counts as usual: a deadline that was under way
    goes on from where it stood, however far the clock went back and however often. A leap forward counts
    in full, so that deadlines err towards zero output.
    """

    def __init__(self, limits: ClockLimits | None = None) -> None:
        """Begin at zero with the first reading."""
        self.limits = limits or ClockLimits()
        self.standing = math.inf
        """Seconds of the wall clock since the plant's last made progress; infinite before the first."""
        self._now = 0
        self._plant: int | None = None
        self._mark = 0  # our time when progress was last seen, ns …
        self._seen: int | None = None  # … and the wall's

    @property
    def stopped(self) -> bool:
        """Whether the clock stands still."""
        return self.standing > self.limits.patience

    def read(self, plant: int, wall: int) -> float:
        """The time now, s, from the plant's clock and a monotonic wall clock (both ns)."""
        if self._plant is not None:
            self._now += max(0, plant - self._plant)
        self._plant = plant
        if self._now - self._mark >= self.limits.progress * NANOSECONDS:
            self._mark, self._seen = self._now, wall
        if self._seen is not None:
            self.standing = (wall - self._seen) / NANOSECONDS
        return self._now / NANOSECONDS
