"""The set-point as a function of time."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field
from itertools import accumulate

from twinmatch.control.errors import ControlError

__all__ = ["Profile"]


@dataclass(frozen=True)
class Profile:
    """A sequence of levels, each held for its time.

    With a ramp the set-point moves to a level at that rate, starting when the level's time starts; the first
    level applies from the start.

    Raises:
        ControlError: there is no level, the numbers of levels and times differ, a level is outside the safe
            range, a time or rate is invalid, or a ramp takes longer than the level's time.
    """

    levels: tuple[float, ...]
    """Set-points."""
    holds: tuple[float, ...]
    """Time of each level, s."""
    repeat: bool = False
    """Start over at the end."""
    ramp: float = 0.0
    """Rate of change, per second; 0: steps."""
    lowest: float = field(kw_only=True)
    """Lower end of the safe range, such as the plant's `output.safe`."""
    highest: float = field(kw_only=True)
    """Upper end."""
    unit: str = field(kw_only=True)
    """Unit of the set-points, for messages."""

    def __post_init__(self) -> None:
        if not self.lowest < self.highest:
            msg = f"profile: the range {self.lowest:g} to {self.highest:g} {self.unit} is empty"
            raise ControlError(msg)
        if not self.levels or len(self.levels) != len(self.holds):
            msg = (
                f"profile: {len(self.levels)} levels and {len(self.holds)} times are given; "
                "give one time per level, and at least one level"
            )
            raise ControlError(msg)
        for number, (level, hold) in enumerate(zip(self.levels, self.holds, strict=True), 1):
            if not self.lowest <= level <= self.highest:
                allowed = f"{self.lowest:g} to {self.highest:g} {self.unit}"
                msg = (
                    f"profile: level {number} is {level:g} {self.unit}; give one in the safe range, {allowed}"
                )
                raise ControlError(msg)
            if not (math.isfinite(hold) and hold > 0):
                msg = f"profile: the time of level {number} is {hold:g} s; give a positive time"
                raise ControlError(msg)
        self._check_ramp()

    def _check_ramp(self) -> None:
        if not (math.isfinite(self.ramp) and self.ramp >= 0):
            msg = f"profile: the ramp is {self.ramp:g} {self.unit}/s; give a positive rate, or 0 for steps"
            raise ControlError(msg)
        if self.ramp == 0:
            return
        for number, (level, hold) in enumerate(zip(self.levels, self.holds, strict=True)):
            if number == 0 and not self.repeat:
                continue
            needed = abs(level - self.levels[number - 1]) / self.ramp
            if needed > hold:
                msg = (
                    f"profile: the ramp to level {number + 1} takes {needed:g} s, longer than its time of "
                    f"{hold:g} s; hold it longer or choose a faster ramp"
                )
                raise ControlError(msg)

    @property
    def duration(self) -> float:
        """Time until the end of the last level, s; infinite for a profile that repeats."""
        return math.inf if self.repeat else sum(self.holds)

    def ended(self, time: float) -> bool:
        """Whether the profile is over at this time (s since its start)."""
        return time >= self.duration

    def reference(self, time: float) -> float:
        """The set-point at a time (s since the start); after the end, the last level.

        Raises:
            ControlError: the time is not finite.
        """
        if not math.isfinite(time):
            msg = f"profile: the time is {time} s; it must be finite"
            raise ControlError(msg)
        round_ = sum(self.holds)
        first_round = not self.repeat or time < round_
        at = max(time, 0.0) if not self.repeat else max(time, 0.0) % round_
        starts = [0.0, *accumulate(self.holds[:-1])]
        number = bisect_right(starts, at) - 1
        level = self.levels[number]
        if self.ramp == 0 or (number == 0 and first_round):
            return level
        before = self.levels[number - 1]
        moved = self.ramp * (at - starts[number])
        if moved >= abs(level - before):
            return level
        return before + math.copysign(moved, level - before)
