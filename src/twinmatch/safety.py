"""Decide when the output must go to zero.

State machines without clocks, wires or threads: the caller passes the time. `OutputGuard` decides what may
reach the driver, `Runaway` checks that the plate follows the drive, and `SafetyClock` derives a time that
only runs forward from a clock that may not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum

from twinmatch.errors import TwinmatchError
from twinmatch.settings import setting

__all__ = [
    "ClockLimits",
    "FaultKind",
    "GuardFault",
    "GuardLimits",
    "OutputGuard",
    "Runaway",
    "RunawayLimits",
    "SafetyClock",
    "SafetyError",
]


class SafetyError(TwinmatchError):
    """Limits under which nothing is protected."""


NANOSECONDS = 1_000_000_000


def _within_a_minute(place: str, **times: float) -> None:
    for name, time in times.items():
        if not 0 < time <= 60:
            raise SafetyError(f"{place} limits: {name} is {time} s; it must be within 0 to 60 s")


@dataclass(frozen=True)
class ClockLimits:
    """A clock stands still if it does not advance by `progress` within `patience`, or has never advanced."""

    patience: float = 1.0
    """Wall time, s."""
    progress: float = 0.05
    """Plant time, s; a rig slowed down more than twentyfold is therefore not driven either."""

    def __post_init__(self) -> None:
        _within_a_minute("clock", patience=self.patience, progress=self.progress)


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
            self._mark, self._seen = self._now, wall
        if self._seen is not None:
            self.standing = (wall - self._seen) / NANOSECONDS
        return self._now / NANOSECONDS


@dataclass(frozen=True)
class RunawayLimits:
    """Limits from which a drive without effect is a fault."""

    hysteresis: float = setting(5.0, "Control error that is always tolerated.", "{y}", 0.1, 100.0)
    patience: float = setting(
        120.0, "Integral of the error beyond it, without progress, that is a fault.", "{y}·s", 1.0, 1e5
    )
    gain: float = setting(2.0, "Movement towards the set-point that counts as progress.", "{y}", 0.01, 100.0)
    gain_time: float = setting(20.0, "Time for that movement.", "s", 1.0, 3600.0)
    wrong_way: float = setting(3.0, "Movement away at full drive that is a fault.", "{y}", 0.1, 100.0)
    full_drive: float = setting(250.0, "Magnitude from which the drive counts as full.", "{u}", 1.0, 255.0)

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (math.isfinite(value) and value > 0):
                msg = f"runaway limits: {name} is {value}; it must be positive"
                raise SafetyError(msg)


class Runaway:
    """Monitors set-point, temperature and drive for runaway: the plant does not follow the drive.

    Modelled on the heater checks of 3D-printer firmware (Klipper's `verify_heater`, Marlin's thermal
    protection), but for both directions, since a Peltier plate is cooled as well as heated. It uses no model
    of the plant; it detects a lost drive, a detached sensor, or reversed polarity.
    """

    def __init__(self, limits: RunawayLimits | None = None, thing: str = "plate", unit: str = "°C") -> None:
        """Start without history; `thing` names what is driven, `unit` is that of its output, for messages."""
        self._thing, self._unit = thing, unit
        self.limits = limits or RunawayLimits()
        self.reset()

    def reset(self) -> None:
        """Forget the history."""
        self._time: float | None = None
        self._reference = 0.0
        self._heating = True
        self._unexplained = 0.0  # in the output's unit times s
        self._goal = 0.0  # distance from the set-point that will count as progress
        self._deadline = 0.0
        self._nearest_at_full = math.inf  # smallest distance since the drive became full

    def check(self, now: float, reference: float, temperature: float, drive: float) -> str | None:
        """Take one tick (s, twice the output's unit, the drive's unit); returns an error message, or None.

        If the clock jumps back, the check starts over.
        """
        heating = reference >= temperature
        distance = abs(reference - temperature)
        elapsed = 0.0 if self._time is None else now - self._time
        new_task = heating != self._heating or abs(reference - self._reference) >= self.limits.gain
        if self._time is None or elapsed < 0 or new_task:
            self._heating, self._reference = heating, reference
            self._start(now, distance)
            elapsed = 0.0
        self._time = now
        limits = self.limits
        pushing = drive >= limits.full_drive if heating else drive <= -limits.full_drive
        self._nearest_at_full = min(self._nearest_at_full, distance) if pushing else math.inf
        if pushing and distance - self._nearest_at_full >= limits.wrong_way:
            word, away = "heating" if heating else "cooling", distance - self._nearest_at_full
            return (
                f"at full {word} the {self._thing} moved {away:.1f} {self._unit} away from the set-point; "
                "check drive, polarity and sensor"
            )
        return self._progress(now, elapsed, distance, drive)

    def _start(self, now: float, distance: float) -> None:
        self._unexplained = 0.0
        self._nearest_at_full = math.inf
        self._goal = distance - self.limits.gain
        self._deadline = now + self.limits.gain_time

    def _progress(self, now: float, elapsed: float, distance: float, drive: float) -> str | None:
        limits = self.limits
        if distance <= limits.hysteresis or distance <= self._goal:
            self._start(now, distance)
            return None
        if now < self._deadline:
            return None
        pushing = abs(drive) >= limits.full_drive / 2
        self._unexplained += (distance - limits.hysteresis) * elapsed if pushing else 0.0
        if self._unexplained < limits.patience:
            return None
        word = "heating" if self._heating else "cooling"
        return (
            f"{word} makes no progress: {distance:.1f} {self._unit} from the set-point, less than "
            f"{limits.gain:g} {self._unit} closer in {limits.gain_time:g} s; check drive, fan and sensor"
        )


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
    SENDERS = "senders"
    """More than one node publishes commands or temperatures."""
    CLOCK = "clock"
    """The plant's clock stands still."""
    STOPPED = "stopped"
    """The operator stopped the output."""


@dataclass(frozen=True)
class GuardFault:
    """A latched fault: kind, message and time (s)."""

    kind: FaultKind
    message: str
    since: float


@dataclass(frozen=True)
class GuardLimits:
    """Limits beyond which the output goes to zero."""

    command_timeout: float = setting(1.0, "Zero after this time without a command.", "s", 0.1, 10.0)
    temperature_timeout: float = setting(
        3.0, "Zero when the newest temperature is older than this{note}.", "s", 0.1, 60.0
    )
    highest: float = setting(110.0, "Over-temperature limit.", "{y}", -50.0, 150.0)
    lowest: float = setting(-10.0, "Under-temperature limit.", "{y}", -50.0, 150.0)
    jump: float = setting(10.0, "Jump of the temperature that is not believed.", "{y}", 1.0, 150.0)
    jump_rate: float = setting(5.0, "Fastest change of the temperature that is.", "{y}/s", 0.1, 150.0)
    commands: tuple[float, float] = (-255.0, 255.0)
    """Lowest and highest valid command."""
    thing: str = "plate"
    """Name of the heated object, for messages."""
    sensor: str = "camera"
    """Name of its sensor, for messages."""
    unit: str = "°C"
    """Unit of the output, that of the plant."""
    drive_unit: str = "PWM"
    """Unit of the commands."""
    runaway: RunawayLimits = field(default_factory=RunawayLimits)

    def __post_init__(self) -> None:
        timeouts = {n: getattr(self, n) for n in ("command_timeout", "temperature_timeout")}
        _within_a_minute("guard", **timeouts)
        if not self.lowest < self.highest:
            low, high = f"{self.lowest} {self.unit}", f"{self.highest} {self.unit}"
            msg = f"guard limits: lowest {low} must be below highest {high}"
            raise SafetyError(msg)


class OutputGuard:
    """Decides, tick by tick, whether a command may reach the driver.

        waiting ──fresh command and temperature──▶ armed ──anything doubtful──▶ latched
           ▲                                                                       │
           └────────────────────────────── clear() ◀───────────────────────────────┘

    Only an armed guard passes commands. A latched fault holds the output at zero until it is cleared;
    clearing does not arm, but a new command and a new temperature do. While waiting, silence is not a fault,
    so the nodes of a rig may start in any order; invalid values are a fault at any time. A guard that is held
    does not arm, and latches if it was armed.

    All times are seconds of one clock that does not step back, such as a `SafetyClock`.
    """

    fault: GuardFault | None
    """The latched fault, if any."""

    def __init__(self, limits: GuardLimits | None = None) -> None:
        """Start waiting, with the output at zero."""
        self.limits = limits or GuardLimits()
        self._runaway = Runaway(self.limits.runaway, self.limits.thing, self.limits.unit)
        self._held = False
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
        """Take a temperature measured `age` seconds ago; not one that a frozen sensor repeats.

        One that the plant cannot have reached since the one before is not taken: a sensor that failed, or a
        forged reading, which is dangerous if it is cold. If the readings do not come back, that is a fault.
        """
        limits, before = self.limits, self._temperature
        if self.fault is not None:
            return
        found = f"the {limits.thing} is at {celsius:.1f} {limits.unit}"
        if not math.isfinite(celsius):
            message = f"the temperature is {celsius}; check the {limits.sensor}"
            self.trip(FaultKind.TEMPERATURE_INVALID, message, now)
        elif celsius > limits.highest:
            message = f"{found}, above {limits.highest:g} {limits.unit}; let it cool and find the cause"
            self.trip(FaultKind.OVER_TEMPERATURE, message, now)
        elif celsius < limits.lowest:
            message = f"{found}, below {limits.lowest:g} {limits.unit}; check sensor and polarity"
            self.trip(FaultKind.UNDER_TEMPERATURE, message, now)
        elif abs(celsius - before.value) > limits.jump + limits.jump_rate * before.age(now):
            self._doubted = f"{found}, {before.age(now):.1f} s after {before.value:.1f} {limits.unit}"
        else:
            self._doubted = ""
            before.take(celsius, now - max(0.0, age))

    def loop(self, reference: float, temperature: float, drive: float, now: float) -> None:
        """Take one tick of the control loop, for the runaway watch."""
        if self.fault is not None or not all(map(math.isfinite, (reference, temperature, drive))):
            return
        found = self._runaway.check(now, reference, temperature, drive)
        if found is not None:
            self.trip(FaultKind.RUNAWAY, found, now)

    def hold(self, why: str, now: float) -> None:
        """Pass nothing as long as it is not known whose inputs these are; empty: it is known again."""
        self._held = bool(why)
        if why and self._armed:
            self.trip(FaultKind.SENDERS, why, now)

    def trip(self, kind: FaultKind, message: str, now: float) -> None:
        """Latch a fault, unless one is latched already: the first one shows the cause."""
        if self.fault is None:
            self.fault = GuardFault(kind, message, now)
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
            kind = FaultKind.TEMPERATURE_INVALID if self._doubted else FaultKind.TEMPERATURE_STALE
            message = f"the newest temperature is {age:.1f} s old; is the {self.limits.sensor} working?"
            if self._doubted:
                message = f"{self._doubted}: faster than it can; check the {self.limits.sensor}, and who else"
                message += " publishes temperatures"
            self.trip(kind, message, now)
        else:  # before arming, stale inputs are not a fault
            self._armed = not (silent or stale or self._held)
        return self._command.value if self._armed else 0.0

    def clear(self) -> None:
        """Clear the fault; the output stays at zero until a new command and temperature arrive."""
        self.fault = None
        self._runaway.reset()
        self._command = _Input()
        self._temperature = _Input()
        self._doubted = ""  # the newest temperature, if it was not taken
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
