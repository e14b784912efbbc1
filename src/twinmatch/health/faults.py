"""Faults of a plant: a row for each kind, which replaces which, and the sentences about their evidence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Final, NamedTuple

from twinmatch.requirements import FINITE, LARGEST, Within


class HealthState(Enum):
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
    DISTURBANCE = "disturbance"
    """Something pushes the output for a while; plant, drive and sensor are as before."""
    DRIFT = "drift"
    """The plant no longer behaves as before, and the samples do not show why."""


class Subject(Enum):
    """What of a plant a fault concerns."""

    DRIVE = "drive"
    OUTPUT = "output"
    PARAMETER = "parameter"
    """The first one that the plant file gives the role of `FaultTraits.role`."""
    ANYTHING = "anything"


EVERY: Final = -1
"""Place of all drives together, where a place says which drive a fault concerns."""


@dataclass(frozen=True, slots=True)
class FaultTraits:
    """All that is said and known of a kind of fault before it happens."""

    subject: Subject
    cause: str
    """What has changed, on a plant with one loop."""
    suspect: str = ""
    """What may have changed, on a plant with several signals; `{name}` is the signal's or the parameter's."""
    sentence: str = ""
    """What has changed and where to look, as a hypothesis says that explains the readings; `{size}` is by how
    much. Empty for a kind that only a trace shows."""
    role: str = ""
    """Role of the parameter that it changes."""
    slow: bool = False
    """Whether the plant still obeys its drive: matching adapts the twin to it."""
    another_plant: bool = False
    """Whether parameters of the plant are others: forecasts made meanwhile say nothing of its twin."""
    unnamed: bool = False
    """Whether it names no cause."""
    blinds: bool = False
    """Whether nothing else can be learned about the plant while it is on."""


TRAITS: Final[Mapping[Fault, FaultTraits]] = {
    Fault.DRIVE_LOST: FaultTraits(
        Subject.DRIVE,
        cause="its drive",
        suspect="the drive {name}",
        sentence="{name} has no effect: look at {name}, its wires and its supply",
        blinds=True,
    ),
    Fault.DRIVE_WEAK: FaultTraits(
        Subject.DRIVE,
        cause="its drive",
        suspect="the drive {name}",
        sentence="{name} has {size} of its effect: look at {name}, its wires and its supply",
        another_plant=True,
    ),
    Fault.SENSOR_FROZEN: FaultTraits(
        Subject.OUTPUT,
        cause="the reading",
        suspect="a frozen {name}",
        sentence="{name} repeats one reading, and should have moved: look at {sensor}",
        blinds=True,
    ),
    Fault.SENSOR_LATE: FaultTraits(Subject.OUTPUT, cause="the reading", blinds=True),
    Fault.SENSOR_IMPLAUSIBLE: FaultTraits(
        Subject.OUTPUT,
        cause="the reading",
        suspect="an impossible {name}",
        sentence="{name} is read as what it cannot be: look at {sensor}",
        blinds=True,
    ),
    Fault.SENSOR_DRIFT: FaultTraits(
        Subject.OUTPUT,
        cause="the reading",
        suspect="the reading of {name}",
        sentence="the readings of {name} are off by about {size}: look at {sensor}, and compare with another",
        slow=True,
    ),
    Fault.LOSSES_CHANGED: FaultTraits(
        Subject.PARAMETER,
        cause="its losses",
        suspect="losses ({name})",
        sentence="losses ({name}) are {size} what they were: look at {surroundings}",
        role="losses",
        slow=True,
        another_plant=True,
    ),
    Fault.ROOM_CHANGED: FaultTraits(
        Subject.PARAMETER,
        cause="the room",
        suspect="{name}",
        sentence="the {name} has changed by {size}: look at {surroundings}",
        role="room",
        slow=True,
        another_plant=True,
    ),
    Fault.DISTURBANCE: FaultTraits(
        Subject.ANYTHING,
        cause="something that passes",
        suspect="a passing push on {name}",
        sentence="something other than the drives moved {name} and has ceased: look at {surroundings}",
        unnamed=True,
    ),
    Fault.DRIFT: FaultTraits(
        Subject.ANYTHING,
        cause="something unknown",
        suspect="something that acts as {name} does",
        sentence="the plant behaves differently, and the samples do not tell apart: {rivals}",
        slow=True,
        unnamed=True,
    ),
}

SLOW: Final = frozenset(fault for fault, traits in TRAITS.items() if traits.slow)
"""Changes of a plant that still obeys its drive."""


class Lie(NamedTuple):
    """Samples in which the sensor of an output is known to have lied."""

    signal: str
    """Name of the output in the plant file."""
    first: int
    last: int | None
    """None while it lies."""

    def overlaps(self, first: int, last: int) -> bool:
        """Whether it touches the samples `first` to `last`, both included."""
        return _overlap(self.first, self.last, first, last)


def _overlap(begin: int, end: int | None, first: int, last: int) -> bool:
    """Whether the samples `begin` to `end` (None: all that follow) touch the samples `first` to `last`."""
    return begin <= last and (end is None or end >= first)


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
    spoils: bool = True
    """Whether nothing should be learned from its samples. Matching adapts to slow changes, and a few refused
    readings count nowhere."""
    signal: str = ""
    """Name in the plant file of the drive, output or parameter that it concerns; empty if it names none."""
    withdrawn: str = ""
    """Why it was taken back, in a sentence; empty if it ended by itself, or is on."""

    @property
    def alters(self) -> bool:
        """Whether the plant or its sensor is another while it lasts."""
        return self.spoils or self.fault in SLOW

    @property
    def lies(self) -> bool:
        """Whether readings are not the plant's while it lasts."""
        is_of_sensor = TRAITS[self.fault].subject is Subject.OUTPUT
        return is_of_sensor and self.alters and not self.withdrawn

    @property
    def excuses(self) -> bool:
        """Whether forecasts of its samples say nothing of the twins of a plant that is whole."""
        is_change = self.spoils or TRAITS[self.fault].another_plant
        return self.lies or (is_change and not self.withdrawn)

    def overlaps(self, first: int, last: int) -> bool:
        """Whether it touches the samples `first` to `last`."""
        return _overlap(self.first, self.last, first, last)

    def excuses_between(self, first: int, last: int) -> bool:
        """Whether a forecast of the samples after `first` up to `last` says nothing of such a twin.

        As long as it is on, those made after its beginning count: twins adapt to how the plant is now.
        """
        if self.last is None:
            return self.excuses and first < self.first <= last
        return self.excuses and self.overlaps(first, last)


def touching(
    alarms: Iterable[Alarm], first: int, last: int, *, slow: bool
) -> Alarm | None:
    """The first alarm whose trace touches the samples `first` to `last`, both included.

    Nothing should be learned from such a window. Slow changes are left out unless asked for: matching
    handles those. So are refused readings, which are in no window.
    """
    faults = (alarm for alarm in alarms if alarm.spoils or (slow and alarm.alters))
    return next((alarm for alarm in faults if alarm.overlaps(first, last)), None)


@dataclass(frozen=True, slots=True)
class Health:
    """The judgement at one sample."""

    index: int
    state: HealthState
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
    signal: str = ""
    """What the fault concerns, as in `Alarm`."""

    @property
    def confirmed_fault(self) -> Fault | None:
        """The fault of the plant; None when it is healthy, or a fault is only suspected."""
        return self.fault if self.state is HealthState.FAULT else None


HOUR: Final = 3600.0
"""How far an estimate is looked ahead, and in which time one change is expected to begin, s."""


@dataclass(frozen=True)
class EstimatedReading:
    """What a sensor should read at a sample at which it is not believed."""

    sample: int
    """Index of the sample."""
    signal: str
    """Name of the output in the plant file."""
    value: Annotated[float, FINITE]
    """What it should read, in its unit."""
    band: Annotated[float, Within(0.0, LARGEST, may_be_absent=False)]
    """Half of the width that holds 90 % of what it would read."""
    reading: float
    """What it read."""
    since: int
    """First sample at which it is read through."""
    wide: Annotated[float, FINITE]
    """Half width up to which the estimate counts as good."""
    good: Annotated[float, FINITE]
    """For how long from the first sample on it was to be good, s; at most an hour is looked ahead."""


_SUDDEN: Final = frozenset(
    fault for fault, traits in TRAITS.items() if not traits.slow and not traits.unnamed
)
_NAMED_SLOW: Final = frozenset(
    fault for fault, traits in TRAITS.items() if traits.slow and not traits.unnamed
)
PRECEDENCE: Final = {
    Fault.DISTURBANCE: _SUDDEN | SLOW,
    Fault.DRIFT: _SUDDEN | _NAMED_SLOW | {Fault.DISTURBANCE},
    Fault.DRIVE_WEAK: frozenset(
        {Fault.DRIVE_LOST, Fault.SENSOR_FROZEN, Fault.SENSOR_IMPLAUSIBLE}
    ),
    **{fault: _SUDDEN | (_NAMED_SLOW - {fault}) for fault in _NAMED_SLOW},
}
"""For each fault, the graver ones that replace it while it is on."""


class Evidence(NamedTuple):
    """One trace of one fault."""

    fault: Fault
    sure: bool
    """Whether it has lasted long enough, or is large enough, to be reported."""
    first: int
    """Sample at which the trace begins."""
    reason: str
    tracked: bool = False
    """Whether it was found by tracking the plant over minutes (`SlowChanges`), and not by a trace."""


def signed(value: float) -> str:
    """Format a change with its sign and two significant digits."""
    return f"{value:+.0f}" if abs(value) >= 100 else f"{value:+.2g}"
