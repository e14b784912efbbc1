"""The final decision on the output: what may be sent to the driver, and if not, why.

    waiting ──fresh command and temperature──▶ armed ──anything doubtful──▶ latched
       ▲                                                                       │
       └────────────────────────────── clear() ◀───────────────────────────────┘

Only an armed guard passes commands. A latched fault holds the output at zero until it is cleared; clearing
does not arm, but a new command and a new temperature do. While waiting, silence is not a fault, so the nodes
of a rig may start in any order; invalid values are a fault at any time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum

from twinmatch.safety.errors import SafetyError
from twinmatch.safety.runaway import Runaway, RunawayLimits

__all__ = ["Fault", "FaultKind", "GuardLimits", "OutputGuard"]


class FaultKind(Enum):
    """Cause of a latched fault."""

    COMMAND_SILENT = "command_silent"
    COMMAND_INVALID = "command_invalid"
    TEMPERATURE_STALE = "temperature_stale"
    TEMPERATURE_INVALID = "temperature_invalid"
    OVER_TEMPERATURE = "over_temperature"
    UNDER_TEMPERATURE = "under_temperature"
    RUNAWAY = "runaway"
    DRIVER = "driver"
    """The motor driver reports a short circuit, over-temperature or under-voltage."""
    BOARD = "board"
    """The driver board restarted, tripped, or applies something other than the command."""
    LINK = "link"
    """The board does not answer, or its port is gone."""
    CLOCK = "clock"
    """The plant's clock stands still."""
    STOPPED = "stopped"
    """The operator stopped the output."""


@dataclass(frozen=True)
class Fault:
    """A latched fault: kind, message and time (s)."""

    kind: FaultKind
    message: str
    since: float


@dataclass(frozen=True)
class GuardLimits:
    """Limits beyond which the output goes to zero."""

    command_timeout: float = 1.0
    """Longest time between two commands, s."""
    temperature_timeout: float = 3.0
    """Highest age of the newest temperature, without repeated ones, s; flat-field corrections take 1 s."""
    commands: tuple[float, float] = (-255.0, 255.0)
    """Lowest and highest valid command."""
    highest: float = 110.0
    """Over-temperature limit, °C."""
    lowest: float = -10.0
    """Under-temperature limit, °C: below it the plate ices or the sensor is wrong."""
    thing: str = "plate"
    """Name of the heated object, for messages."""
    sensor: str = "camera"
    """Name of its sensor, for messages."""
    runaway: RunawayLimits = field(default_factory=RunawayLimits)

    def __post_init__(self) -> None:
        for name in ("command_timeout", "temperature_timeout"):
            if not 0 < getattr(self, name) <= 60:
                msg = f"guard limits: {name} is {getattr(self, name)} s; it must be within 0 to 60 s"
                raise SafetyError(msg)
        if not self.lowest < self.highest:
            msg = f"guard limits: lowest {self.lowest} °C must be below highest {self.highest} °C"
            raise SafetyError(msg)


class OutputGuard:
    """Decides, tick by tick, whether a command may reach the driver.

    All times are seconds of one clock that does not step back, such as a `SafetyClock`.
    """

    fault: Fault | None
    """The latched fault, if any."""

    def __init__(self, limits: GuardLimits | None = None) -> None:
        """Start waiting, with the output at zero."""
        self.limits = limits or GuardLimits()
        self._runaway = Runaway(self.limits.runaway, self.limits.thing)
        self.clear()

    @property
    def armed(self) -> bool:
        """True while commands pass."""
        return self._armed

    def command(self, value: float, now: float, age: float = 0.0) -> None:
        """Take a command that was sent `age` seconds ago."""
        if self.fault is not None:
            return
        low, high = self.limits.commands
        if not low <= value <= high:  # true for NaN too
            message = f"the command is {value}, outside {low:g} to {high:g}; check its publisher"
            self.trip(FaultKind.COMMAND_INVALID, message, now)
            return
        self._command.take(value, now - max(0.0, age))

    def temperature(self, celsius: float, now: float, age: float = 0.0) -> None:
        """Take a temperature measured `age` seconds ago; not one that a frozen sensor repeats."""
        limits = self.limits
        if self.fault is not None:
            return
        if not math.isfinite(celsius):
            self.trip(
                FaultKind.TEMPERATURE_INVALID, f"the temperature is {celsius}; check the {limits.sensor}", now
            )
        elif celsius > limits.highest:
            found = f"the {limits.thing} is at {celsius:.1f} °C, above {limits.highest:g} °C"
            self.trip(FaultKind.OVER_TEMPERATURE, f"{found}; let it cool and find the cause", now)
        elif celsius < limits.lowest:
            found = f"the {limits.thing} is at {celsius:.1f} °C, below {limits.lowest:g} °C"
            self.trip(FaultKind.UNDER_TEMPERATURE, f"{found}; check sensor and polarity", now)
        else:
            self._temperature.take(celsius, now - max(0.0, age))

    def loop(self, reference: float, temperature: float, drive: float, now: float) -> None:
        """Take one tick of the control loop, for the runaway watch."""
        if self.fault is not None or not all(map(math.isfinite, (reference, temperature, drive))):
            return
        found = self._runaway.check(now, reference, temperature, drive)
        if found is not None:
            self.trip(FaultKind.RUNAWAY, found, now)

    def trip(self, kind: FaultKind, message: str, now: float) -> None:
        """Latch a fault, unless one is latched already: the first one shows the cause."""
        if self.fault is None:
            self.fault = Fault(kind, message, now)
        self._armed = False

    def output(self, now: float) -> float:
        """The value that may be sent now: the newest command, or zero."""
        if self.fault is not None:
            return 0.0
        silence, age = self._command.age(now), self._temperature.age(now)
        silent, stale = silence > self.limits.command_timeout, age > self.limits.temperature_timeout
        if self._armed and silent:
            message = f"no command for {silence:.1f} s; is the controller running?"
            self.trip(FaultKind.COMMAND_SILENT, message, now)
        elif self._armed and stale:
            message = f"the newest temperature is {age:.1f} s old; is the {self.limits.sensor} working?"
            self.trip(FaultKind.TEMPERATURE_STALE, message, now)
        else:  # before arming, stale inputs are not a fault
            self._armed = not (silent or stale)
        return self._command.value if self._armed else 0.0

    def clear(self) -> None:
        """Clear the fault; the output stays at zero until a new command and temperature arrive."""
        self.fault = None
        self._runaway.reset()
        self._command = _Input()
        self._temperature = _Input()
        self._armed = False


class _Input:
    """The newest value of an input, and its time."""

    def __init__(self) -> None:
        self.value = 0.0
        self._since = -math.inf

    def take(self, value: float, since: float) -> None:
        self.value, self._since = value, max(self._since, since)

    def age(self, now: float) -> float:
        return max(0.0, now - self._since)
