"""The guard: which command may reach the driver."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import Final

from twinmatch.safety.budget import BudgetLimits, HeatBudget
from twinmatch.safety.limits import SafetyError, within_a_minute
from twinmatch.safety.observer import DriveObserver, ObserverLimits
from twinmatch.safety.runaway import Runaway, RunawayLimits
from twinmatch.settings import setting
from twinmatch.signals import FloatArray

BLIND: Final = 20.0
"""Time for which a drive is limited whose sensor has shown nothing of it yet, s; cameras freeze for some."""


class FaultKind(Enum):
    """Cause of a latched fault."""

    COMMAND_SILENT = "command_silent"
    COMMAND_INVALID = "command_invalid"
    TEMPERATURE_STALE = "temperature_stale"
    TEMPERATURE_INVALID = "temperature_invalid"
    OVER_TEMPERATURE = "over_temperature"
    UNDER_TEMPERATURE = "under_temperature"
    RUNAWAY = "runaway"
    BUDGET = "budget"
    """More drive passed than the readings explain."""
    DISAGREES = "disagrees"
    """The sensor reads something else than the drive must have done."""
    LIMITED = "limited"
    """The drive takes the plant beyond set-point and reading: not zero, but no more than holds it there."""
    TWIN = "twin"
    """The twin, trusted until then, no longer believes sensor or drive."""
    ESTIMATE = "estimate"
    """The law runs on an estimate of a reading, and that is no longer good enough."""
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


def is_limit(text: str) -> bool:
    """Whether a reported fault limits the output and does not hold it at zero."""
    return text.partition(": ")[0] == FaultKind.LIMITED.value


@dataclass(frozen=True)
class GuardLimits:
    """Limits beyond which the output goes to zero."""

    command_timeout: float = setting(
        1.0, "Zero after this time without a command.", "s", 0.1, 10.0
    )
    temperature_timeout: float = setting(
        3.0,
        "Zero when the newest temperature is older than this{note}.",
        "s",
        0.1,
        60.0,
    )
    highest: float = setting(110.0, "Over-temperature limit.", "{y}", -50.0, 150.0)
    lowest: float = setting(-10.0, "Under-temperature limit.", "{y}", -50.0, 150.0)
    jump: float = setting(
        10.0, "Jump of the temperature that is not believed.", "{y}", 1.0, 150.0
    )
    jump_rate: float = setting(
        5.0, "Fastest change of the temperature that is.", "{y}/s", 0.1, 150.0
    )
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
    budget: BudgetLimits = field(default_factory=BudgetLimits)
    observer: ObserverLimits = field(default_factory=ObserverLimits)

    def __post_init__(self) -> None:
        timeouts = {
            n: getattr(self, n) for n in ("command_timeout", "temperature_timeout")
        }
        within_a_minute("guard", **timeouts)
        if not self.lowest < self.highest:
            low = f"{self.lowest} {self.unit}"
            high = f"{self.highest} {self.unit}"
            raise SafetyError(
                f"guard limits: lowest {low} must be below highest {high}"
            )


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
    limited: GuardFault | None
    """Why less than the command passes; None: all of it does."""
    passed: float
    """What passed at the last decision; a gate of several drives may let pass less."""

    def __init__(
        self, limits: GuardLimits | None = None, observer: DriveObserver | None = None
    ) -> None:
        """Start waiting, with the output at zero; an `observer` follows what passes."""
        self.limits = limits or GuardLimits()
        self._runaway = Runaway(
            self.limits.runaway, self.limits.thing, self.limits.unit
        )
        self._budget = HeatBudget(
            self.limits.budget, self.limits.thing, self.limits.drive_unit
        )
        self._observer = observer
        self.fault = self.limited = None
        self._reference = self.limits.highest  # before anybody says what is wanted
        self.passed = 0.0
        self._passed_at = math.nan
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
            message = f"the command of the {self.limits.thing} is {value}, outside {low:g} to {high:g}"
            self.trip(FaultKind.COMMAND_INVALID, f"{message}; check its publisher", now)
            return
        self._command.take(value, now - max(0.0, age))

    def temperature(self, celsius: float, now: float, age: float = 0.0) -> None:
        """Take a temperature measured `age` seconds ago; not one that a frozen sensor repeats.

        One that the plant cannot have reached since the one before is not taken: a sensor that failed, or a
        forged reading, which is dangerous if it is cold. If the readings do not come back, that is a fault.
        """
        limits = self.limits
        before = self._temperature
        if self.fault is not None:
            return
        state = f"the {limits.thing} is at {celsius:.1f} {limits.unit}"
        if not math.isfinite(celsius):
            message = f"the temperature is {celsius}; check the {limits.sensor}"
            self.trip(FaultKind.TEMPERATURE_INVALID, message, now)
        elif celsius > limits.highest:
            message = f"{state}, above {limits.highest:g} {limits.unit}; let it cool and find the cause"
            self.trip(FaultKind.OVER_TEMPERATURE, message, now)
        elif celsius < limits.lowest:
            message = f"{state}, below {limits.lowest:g} {limits.unit}; check sensor and polarity"
            self.trip(FaultKind.UNDER_TEMPERATURE, message, now)
        elif abs(celsius - before.value) > limits.jump + limits.jump_rate * before.age(
            now
        ):
            self._doubted = f"{state}, {before.age(now):.1f} s after {before.value:.1f} {limits.unit}"
        else:
            self._doubted = ""
            before.take(celsius, now - max(0.0, age))

    def loop(
        self, reference: float, temperature: float, drive: float, now: float
    ) -> None:
        """Take one tick of the control loop, for the runaway watch."""
        if self.fault is not None or not all(
            map(math.isfinite, (reference, temperature, drive))
        ):
            return
        self._reference = reference
        if self.limited is not None:
            # a drive that is held back cannot reach its set-point
            self._runaway.reset()
            return
        runaway = self._runaway.check(now, reference, temperature, drive)
        if runaway is not None:
            self.trip(FaultKind.RUNAWAY, runaway, now)

    def hold(self, why: str, now: float) -> None:
        """Pass nothing as long as it is not known whose inputs these are; empty: it is known again."""
        self._held = bool(why)
        if why and self._armed:
            self.trip(FaultKind.SENDERS, why, now)

    def trip(self, kind: FaultKind, message: str, now: float) -> None:
        """Latch a fault, unless one is latched already: the first one shows the cause."""
        self.latch(GuardFault(kind, message, now))

    def latch(self, fault: GuardFault) -> None:
        """Latch a fault that may be another drive's, unless one is latched already."""
        self.fault = self.fault or fault
        self._armed = False

    def output(self, now: float, beside: FloatArray | None = None) -> float:
        """The value that may be sent now: the newest command, or zero.

        `beside` are the disturbances, shape (d,), that go with commands that pass, such as a second heater.
        """
        self._judge_heat(now, beside if self._armed else None)
        self.passed = self._limit(self._decide(now), now)
        self._passed_at = now
        return self.passed

    def _limit(self, value: float, now: float) -> float:
        """What of a command may pass. Once it was limited it is called so until all drive may pass."""
        if self._observer is None:
            return value
        ceiling = self._observer.ceiling
        reading = self._temperature.value
        most = ceiling.share * self.limits.commands[1]
        if ceiling.share >= 1.0:
            self.limited = None
        elif value > most and self.limited is None:
            self.limited = GuardFault(
                FaultKind.LIMITED, self._observer.hotter(reading), now
            )
        elif (
            self.limited is not None
            and not ceiling.seen
            and now - self.limited.since > BLIND
        ):
            band = self.limits.observer.margin / 2
            self.trip(
                FaultKind.DISAGREES,
                self._observer.contradicts(reading, ceiling.estimate, band),
                now,
            )
            return 0.0
        return min(value, most)

    def _judge_heat(self, now: float, beside: FloatArray | None) -> None:
        """Judge what has passed since the last decision, by what the sensor shows of it."""
        elapsed = now - self._passed_at
        reading = self._temperature.value
        if not (elapsed > 0.0 and self._temperature.known):
            return
        # Without a new decision the board has gone to zero.
        drove = min(elapsed, self.limits.command_timeout)
        for drive, span in ((self.passed, drove), (0.0, elapsed - drove)):
            if span <= 0.0:
                continue
            spent = self._budget.take(span, drive, self._reference, reading)
            if spent is not None:
                self.trip(FaultKind.BUDGET, spent, now)
            if self._observer is None:
                continue
            contradiction = self._observer.take(
                span,
                drive,
                reading,
                beside,
                reference=self._reference,
                believed=self.fault is None,
            )
            if contradiction is not None and self._armed:
                self.trip(FaultKind.DISAGREES, contradiction, now)

    def _decide(self, now: float) -> float:
        if self.fault is not None:
            return 0.0
        silence = self._command.age(now)
        age = self._temperature.age(now)
        silent = silence > self.limits.command_timeout
        stale = age > self.limits.temperature_timeout
        if self._armed and silent:
            message = f"no command for {silence:.1f} s; is the controller running?"
            self.trip(FaultKind.COMMAND_SILENT, message, now)
        elif self._armed and stale:
            kind = (
                FaultKind.TEMPERATURE_INVALID
                if self._doubted
                else FaultKind.TEMPERATURE_STALE
            )
            message = f"the newest temperature is {age:.1f} s old; is the {self.limits.sensor} working?"
            if self._doubted:
                message = f"{self._doubted}: faster than it can; check the {self.limits.sensor}, and who else"
                message += " publishes temperatures"
            self.trip(kind, message, now)
        else:  # before arming, stale inputs are not a fault
            self._armed = not (silent or stale or self._held)
        return self._command.value if self._armed else 0.0

    def clear(self) -> None:
        """Clear the fault; the output stays at zero until a new command and temperature arrive.

        Without a fault, a limit is lifted: from now on the readings are right.
        """
        if (
            self.fault is None
            and self.limited is not None
            and self._observer is not None
        ):
            self._observer.believe()
        self.fault = self.limited = None
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

    @property
    def known(self) -> bool:
        """Whether there is a value."""
        return self._since > -math.inf

    def take(self, value: float, since: float) -> None:
        self.value = value
        self._since = max(self._since, since)

    def age(self, now: float) -> float:
        return max(0.0, now - self._since)
