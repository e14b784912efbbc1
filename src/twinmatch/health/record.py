"""Records of the monitor: states, faults, alarms and the judgement at one sample."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

__all__ = ["SLOW", "Alarm", "Fault", "Health", "State"]


class State(Enum):
    """How the plant is at one sample."""

    HEALTHY = "healthy"
    SUSPECT = "suspect"
    """Something looks wrong but has not lasted, or the session has only begun."""
    FAULT = "fault"


class Fault(Enum):
    """What is wrong."""

    DRIVE_LOST = "drive-lost"
    """The input has no effect on the plant, or the opposite one."""
    DRIVE_WEAK = "drive-weak"
    """The input has an effect on the plant, but too small a one."""
    SENSOR_FROZEN = "sensor-frozen"
    """The output repeats one reading."""
    SENSOR_LATE = "sensor-late"
    """The output follows the drive, but seconds too late."""
    SENSOR_IMPLAUSIBLE = "sensor-implausible"
    """A reading that the plant cannot have, or cannot have reached since the sample before."""
    SENSOR_DRIFT = "sensor-drift"
    """The readings have shifted."""
    LOSSES_CHANGED = "losses-changed"
    """The plant loses more or less heat than before: a fan, a lid, a draught."""
    ROOM_CHANGED = "room-changed"
    """The surroundings of the plant have changed."""
    DRIFT = "drift"
    """The plant no longer behaves as before, and the samples do not show why."""


SLOW = frozenset({Fault.SENSOR_DRIFT, Fault.LOSSES_CHANGED, Fault.ROOM_CHANGED, Fault.DRIFT})
"""Changes of a plant that still obeys its drive: matching adapts the twin to them."""


@dataclass(frozen=True, slots=True)
class Alarm:
    """One fault from its beginning to its end."""

    fault: Fault
    first: int
    """Sample at which its trace begins."""
    flagged: int
    """Sample at which it was reported."""
    last: int | None
    """Last sample of its trace; None while it lasts."""
    reason: str
    """One plain sentence with numbers."""

    def overlaps(self, first: int, last: int) -> bool:
        """Whether it touches the samples `first` to `last`."""
        return self.first <= last and (self.last is None or self.last >= first)


@dataclass(frozen=True, slots=True)
class Health:
    """The judgement at one sample."""

    index: int
    state: State
    fault: Fault | None
    """The fault, or the suspected one if it can be named; None when healthy."""
    since: int | None
    """Sample at which the trace of the fault or of the suspicion begins."""
    reason: str
    """One plain sentence; empty when healthy."""
    share: float
    """Share of the drive's expected effect that the plant shows; NaN while too little is expected."""
    unexplained: float
    """Slow unexplained movement, in the output's unit per second."""
    news: Alarm | None = None
    """The alarm that began at this sample, or ended at it (then it has a `last`)."""
