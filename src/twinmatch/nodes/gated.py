"""What stands between commands and a heater: the gate, the thread that drives the hardware, the node of both.

The node's callbacks provide the gate's inputs, the driver's thread asks it for decisions. All times there are
from a `SafetyClock`, which reads its clocks through one function, so that tests need neither clocks nor ROS.
However the thread ends, its last command is zero. If it cannot send it, the board does so by itself after its
deadline, and for a kit the process that holds its port.
"""

from __future__ import annotations

import contextlib
import itertools
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final, Generic, NamedTuple, TypeVar

import numpy as np
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from std_srvs.srv import Trigger

from twinmatch.comparing import Verdict
from twinmatch.dynamics import Parameters, Plant
from twinmatch.errors import TwinmatchError
from twinmatch.links import Background
from twinmatch.links.kit_link import KitLink
from twinmatch.links.pwm_link import PwmLink
from twinmatch.nodes.fields import MessageError
from twinmatch.nodes.health import Level, NodeHealth, Report
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.nodes.senders import Senders
from twinmatch.nodes.step import FOREVER, InStep
from twinmatch.nodes.topics import RELIABLE
from twinmatch.parameters.declared import Setting, given_to, parameters_of
from twinmatch.safety import (
    ACCUSED,
    Accusations,
    ClockLimits,
    DriveObserver,
    FaultKind,
    GuardFault,
    GuardLimits,
    OutputGuard,
    SafetyClock,
)
from twinmatch.signals import Sample, Signals, point_values
from twinmatch.twin.law_on_estimates import accusation_in
from twinmatch_msgs.msg import LoopSample, ModelScore


class ClockTimes(NamedTuple):
    """The same moment on three clocks, ns."""

    stamps: int
    """The clock of the messages' stamps."""
    plant: int
    """The clock for deadlines: the simulated one if there is one, else the monotonic one."""
    wall: int
    """A monotonic clock of this machine."""


class Decision(NamedTuple):
    """What may be sent to the driver."""

    inputs: Signals
    """Commands u, in the drives' units."""
    armed: bool
    """Whether commands pass and the drivers' deadline may be kept alive."""
    sample: int
    """Sample at which the command was computed."""
    time: float
    """Time of the decision, s of the safety clock."""


class OutputGate:
    """The `OutputGuard`s of all drives with their clocks and a lock: all commands pass, or none.

    A fault of one is latched by all; a limit is that of its drive.
    """

    def __init__(
        self,
        read_clocks: Callable[[], ClockTimes],
        guards: Sequence[OutputGuard] = (),
        clock_limits: ClockLimits | None = None,
    ) -> None:
        """Start with the outputs at zero, waiting for inputs; the default is one drive with the usual
        limits."""
        self._read_clocks = read_clocks
        self._guards = tuple(guards) or (OutputGuard(),)
        self._safety_clock = SafetyClock(clock_limits)
        self.beside: Signals = ()
        """The last disturbances of the plant, which act beside the drives while commands pass."""
        self._index = 0
        self.commanded = 0
        """Stamp of the newest command, ns."""
        self._news = threading.Condition(threading.RLock())

    @property
    def fault(self) -> GuardFault | None:
        """The latched fault, or what limits an output, if any."""
        with self._news:
            faults = (
                *(guard.fault for guard in self._guards),
                *(guard.limited for guard in self._guards),
            )
            return next(filter(None, faults), None)

    @property
    def armed(self) -> bool:
        """Whether commands passed at the last decision."""
        with self._news:
            return all(guard.armed for guard in self._guards)

    @property
    def time(self) -> float:
        """Now, s of the safety clock."""
        with self._news:
            return self._now()[0]

    @property
    def clock_stopped(self) -> bool:
        """Whether the plant's clock stands still, or has not been seen to move."""
        with self._news:
            return self._safety_clock.stopped

    def command(self, values: Iterable[float] | float, index: int, stamp: int) -> None:
        """Take the commands sent at `stamp` (ns), computed at sample `index`."""
        with self._news:
            try:
                self._take(OutputGuard.command, values, stamp=stamp)
            except MessageError as error:
                self.trip(
                    FaultKind.COMMAND_INVALID, f"the command cannot be used: {error}"
                )
            self._index = index
            self.commanded = stamp

    def temperature(self, celsius: Iterable[float] | float, stamp: int) -> None:
        """Take the temperatures measured at `stamp` (ns)."""
        self._take(OutputGuard.temperature, celsius, stamp=stamp)

    def sample(
        self, references: Signals, temperatures: Signals, drives: Signals
    ) -> None:
        """Take one tick of the control loops."""
        self._take(OutputGuard.loop, references, temperatures, drives)

    def hold(self, why: str) -> None:
        """Pass nothing for this reason; empty: none."""
        self._take(OutputGuard.hold, [why] * len(self._guards))

    def trip(self, kind: FaultKind, message: str) -> None:
        """Latch a fault."""
        count = len(self._guards)
        self._take(OutputGuard.trip, [kind] * count, [message] * count)

    def clear(self) -> None:
        """Clear the fault; the outputs wait for new inputs."""
        with self._news:
            for guard in self._guards:
                guard.clear()

    def decide(self) -> Decision:
        """What may be sent now. Nothing is armed while the plant's clock stands still."""
        with self._news:
            safety_now, _ = self._now()
            clock = self._safety_clock
            guards = self._guards
            if clock.stopped:
                if self.armed:
                    message = f"/clock has stood still for {clock.standing:.1f} s; is the simulator running?"
                    self.trip(FaultKind.CLOCK, message)
                return Decision(
                    (0.0,) * len(guards),
                    armed=False,
                    sample=self._index,
                    time=safety_now,
                )
            passed_values = [guard.passed for guard in guards]
            for k, guard in enumerate(guards):
                beside = (*passed_values[:k], *passed_values[k + 1 :], *self.beside)
                guard.output(safety_now, np.array(beside) if beside else None)
            fault = next(filter(None, (guard.fault for guard in guards)), None)
            for guard in guards:
                if fault is not None:
                    guard.latch(fault)
            if not self.armed:
                for guard in guards:
                    guard.passed = 0.0
            return Decision(
                tuple(guard.passed for guard in guards),
                self.armed,
                self._index,
                safety_now,
            )

    def wait(self, timeout: float) -> None:
        """Sleep until there is a new input, `timeout` seconds of the wall clock at most."""
        with self._news:
            self._news.wait(timeout)

    def wake(self, *_: object) -> None:
        """Let `wait` return: a clock that may run many times faster than the wall clock has moved."""
        with self._news:
            self._news.notify_all()

    def _take(
        self, take: Callable[..., None], *signals: Any, stamp: int | None = None
    ) -> None:
        """Hand each guard its values with the time now, and with their age if they have a stamp (ns)."""
        with self._news:
            safety_now, times = self._now()
            age = () if stamp is None else ((times.stamps - stamp) / 1e9,)
            rows = list(map(point_values, signals))
            if wrong := [len(row) for row in rows if len(row) != len(self._guards)]:
                raise MessageError(
                    f"it has {wrong[0]} values for {len(self._guards)} drives"
                )
            for guard, values in zip(
                self._guards, zip(*rows, strict=True), strict=True
            ):
                take(guard, *values, safety_now, *age)
            self._news.notify_all()

    def _now(self) -> tuple[float, ClockTimes]:
        times = self._read_clocks()
        return self._safety_clock.read(times.plant, times.wall), times


def gate_table(usual: GuardLimits, note: str = "") -> tuple[Setting, ...]:
    """The parameters of the limits of a plant; `note` explains the default of the temperature's timeout."""
    most = max(map(abs, usual.commands))
    placeholders = {"y": usual.unit, "u": usual.drive_unit, "note": note}
    # /clock's timeout stands behind the first two, and the least full command depends on the drive.
    first, second, *further = parameters_of(usual, **placeholders)
    *runaway, full_command = parameters_of(usual.runaway, "runaway.", **placeholders)
    heat = (
        parameters_of(getattr(usual, name), f"{name}.", **placeholders)
        for name in ("budget", "observer")
    )
    clock = "Zero when /clock stands still for this long, by the wall clock."
    return (
        first,
        second,
        Setting("clock_timeout", ClockLimits().patience, clock, "s", 0.1, 60.0),
        *further,
        *runaway,
        replace(full_command, low=most / 255.0, high=most),
        *itertools.chain.from_iterable(heat),
        Setting(
            "act_on",
            sorted(ACCUSED),
            "What ends the drive when a trusted twin accuses it; an empty list: nothing.",
            choices=tuple(sorted(ACCUSED)),
        ),
    )


def gate_limits(usual: GuardLimits, values: Mapping[str, Any]) -> GuardLimits:
    """The guard's limits from checked parameter values; the other limits are those of `usual`.

    Raises:
        SafetyError: values contradict each other.
    """
    parts = {
        name: given_to(getattr(usual, name), values, f"{name}.")
        for name in ("runaway", "budget", "observer")
    }
    return replace(given_to(usual, values), **parts)


Link = TypeVar("Link", PwmLink, KitLink)
Tell = Callable[[Any, int], None]
"""Takes each report of the hardware (None: unknown), and the sample whose command it has applied."""


@dataclass(frozen=True)
class DriverPace:
    """Pace of a driver's thread."""

    repeat: float = 0.1
    """Interval at which a command is repeated, s of the plant's clock."""
    poll: float = 0.025
    """Longest sleep between two readings of that clock, wall s."""
    first_pause: float = 0.1
    """Pause before the first attempt to restore a lost link, s; doubled after each attempt."""
    longest_pause: float = 2.0
    """Longest such pause, s."""


class DriverThread(Background, ABC, Generic[Link]):
    """Applies what the gate passes, and nothing else, until it is closed or fails; then releases the link."""

    NAME: ClassVar[str]
    CLOSING: ClassVar[float]
    """Default time in which the thread has to end, s."""
    ERRORS: ClassVar[type[TwinmatchError]]
    """Errors of the link."""

    connected = False
    """Whether the hardware answered last."""
    step: InStep | None = None
    """Told which commands are applied, if the plant waits for them."""

    def __init__(
        self,
        link: Link,
        gate: OutputGate,
        tell: Tell,
        health: NodeHealth,
        pace: DriverPace | None = None,
    ) -> None:
        """`tell` is called in the thread, which `start` starts."""
        super().__init__(self.NAME, self._serve_gate, self.CLOSING)
        self.link: Link = link
        self._gate = gate
        self._tell = tell
        self._health = health
        self._pace = pace or DriverPace()
        self._clear_wanted = threading.Event()
        self._has_answered = False
        self._driving = False  # whether the last command had passed the gate
        self._sent_at = 0.0
        self._attempts = 0

    def clear(self) -> None:
        """Clear the fault latched by the hardware, before anything else is sent."""
        self._clear_wanted.set()

    @abstractmethod
    def _connect(self) -> None:
        """Open the link."""

    @abstractmethod
    def _serve(self, decision: Decision) -> None:
        """Apply a decision of the gate, or wait for the next one."""

    @abstractmethod
    def _zero(self) -> None:
        """Set zero."""

    @abstractmethod
    def _refusal(self, error: Any) -> FaultKind | None:
        """The fault of hardware that is there but refuses; None if the link is lost.

        Raises:
            TwinmatchError: the error itself, if waiting does not help.
        """

    def _serve_gate(self) -> None:
        try:
            while not self.ending.is_set():
                commanded = self._gate.commanded
                self._serve_once()
                if self.step is not None:
                    self.step.applied(commanded if self.connected else FOREVER)
        finally:
            self.connected = False
            if self.link.is_open:
                with contextlib.suppress(Exception):
                    # the port must be released whatever happens
                    self._zero()
            self.link.close()

    def _serve_once(self) -> None:
        """Apply one decision of the gate; open the link before that if it is closed."""
        try:
            if not self.link.is_open:
                self._connect()
                self._has_answered = True
                self._attempts = 0
                self._health.count("connections")
                self._health.withdraw("link")
            if self._clear_wanted.is_set():
                self.link.clear()
                self._clear_wanted.clear()
            self._serve(self._gate.decide())
        except self.ERRORS as error:
            kind = self._refusal(error)
            if kind is None:
                self._lost(error)
            else:
                self._driving = False
                self._gate.trip(kind, str(error))

    def _lost(self, error: TwinmatchError) -> None:
        """Close a lost link, and wait before the next attempt to restore it."""
        if self._driving:
            self._gate.trip(FaultKind.LINK, str(error))
        self._driving = self.connected = False
        self._health.count(type(error).__name__)
        self._health.flag("link", Level.ERROR, str(error))
        self.link.close()
        self._tell(None, 0)
        pause = self._pace.first_pause * 2.0 ** min(self._attempts, 30)
        self.ending.wait(min(pause, self._pace.longest_pause))
        self._attempts += 1


NAN = float("nan")
EVERY_MOVE: Final = JumpThreshold(
    min_forward=Duration(nanoseconds=1), min_backward=None, on_clock_change=False
)
"""Of simulated time; other clocks do not jump."""
UNWATCHED = 5.0
"""Time without `plant/sample` after which a warning says that runaway is not monitored, s."""


class GatedNode(TwinmatchNode):
    """Passes commands on while command, temperature, board and clock are sound.

    The callbacks only feed the gate; one thread of the subclass talks to the board. A fault latches until
    `plant/clear_fault` or `~/clear_fault` is called; `plant/stop` and `~/stop` latch one.
    """

    BOARD: ClassVar[str]
    """Name of the hardware in messages."""
    LIMITS: ClassVar[GuardLimits]
    """The usual limits, whose `gate_table` is part of the parameters."""
    PLANT: ClassVar[type[Plant]]
    STRUCTURE: ClassVar[str]
    """The structure with which the observer follows the drive."""

    def read_parameters(self) -> None:
        """Create the gate."""
        limits = gate_limits(self.LIMITS, self.values)
        clock = ClockLimits(self.values["clock_timeout"])
        self.gate = OutputGate(self._read_clocks, self.output_guards(limits), clock)
        self._accusations = Accusations(self.values["act_on"])
        self._reported_fault: GuardFault | None = None
        self._sampled_at = 0.0

    def output_guards(self, limits: GuardLimits) -> list[OutputGuard]:
        """The guard of each drive."""
        return [OutputGuard(limits, self.observer(limits))]

    @classmethod
    def observer(
        cls, limits: GuardLimits, typical: Parameters | None = None
    ) -> DriveObserver:
        """What follows the drive without the sensor, on the `typical` plant."""
        return DriveObserver(
            typical or cls.PLANT.model(cls.STRUCTURE).typical(),
            limits.observer,
            thing=limits.thing,
            sensor=limits.sensor,
            highest=limits.highest,
        )

    def drive(self, driver: DriverThread[Any], *inputs: str) -> None:
        """Start the thread that talks to the hardware; services and reports are offered from now on.

        Who publishes `inputs`, which decide about heat, is watched.
        """
        if self.step is not None:
            driver.step = self.step
            driver.link.plant_time = self.step.breathe
        self._driver = driver
        self._moves = self.get_clock().create_jump_callback(
            EVERY_MOVE, post_callback=self.gate.wake
        )
        self.beside.append(driver)
        self._senders = Senders(self, inputs, self._on_senders)
        for place in ("~", "plant"):
            self.create_service(Trigger, f"{place}/clear_fault", self._on_clear)
            self.create_service(Trigger, f"{place}/stop", self._on_stop)
        self.create_subscription(LoopSample, "plant/sample", self._on_sample, RELIABLE)
        self.create_subscription(
            ModelScore, "twin/model_score", self._on_verdict, RELIABLE
        )
        self.report_on()
        driver.start()

    def report(self) -> Report:
        """Fault, gate, clock, runaway watch."""
        self.note_fault()
        health = self.health
        armed = self.gate.armed
        health.set("armed", armed)
        health.say(
            "passing commands"
            if armed
            else "waiting for a fresh command and temperature"
        )
        unwatched = armed and time.monotonic() - self._sampled_at > UNWATCHED
        stopped = "the clock stands still; nothing is driven"
        health.flag_if(self.gate.clock_stopped, "clock", Level.WARN, stopped)
        unseen = "no messages on plant/sample; runaway is not monitored"
        health.flag_if(unwatched, "watch", Level.WARN, unseen)
        return super().report()

    def note_fault(self) -> None:
        """Put a fault into the health report, and once into the log."""
        fault = self.gate.fault
        reported = self._reported_fault
        self._reported_fault = fault
        if fault is None:
            self.health.withdraw("fault")
        elif fault is not reported:
            zero = fault.kind is not FaultKind.LIMITED
            self.health.flag(
                "fault", Level.ERROR if zero else Level.WARN, fault_text(fault)
            )
            self.health.count("faults" if zero else "limits")
            self.get_logger().error(
                f"output is {'zero: ' if zero else ''}{fault_text(fault)}"
            )

    def _read_clocks(self) -> ClockTimes:
        stamps = self.get_clock().now().nanoseconds
        wall = time.monotonic_ns()
        return ClockTimes(
            stamps, stamps if self.get_clock().ros_time_is_active else wall, wall
        )

    def _on_senders(self, why: str) -> None:
        self.gate.hold(why)
        self.note_fault()

    def _on_sample(self, sample: Sample) -> None:
        self._sampled_at = time.monotonic()
        self.gate.sample(sample.references, sample.outputs, sample.inputs)

    def _on_verdict(self, verdict: Verdict) -> None:
        accusation = accusation_in(verdict, self._accusations)
        if accusation is not None and not self.reads_through(verdict):
            self.end(FaultKind.TWIN, accusation)

    def reads_through(self, _: Verdict) -> bool:
        """Whether the drive continues without what a trusted twin accuses."""
        return False

    def end(self, kind: FaultKind, why: str) -> None:
        """End the drive, if there is any."""
        if self.gate.armed:
            self.gate.trip(kind, why)
            self.note_fault()

    def _on_clear(
        self, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        fault = self.gate.fault
        if fault is None:
            response.success = True
            response.message = "there is no fault"
        elif not self._driver.connected:
            response.message = (
                f"{fault_text(fault)}; not cleared: the {self.BOARD} is not connected"
            )
        else:
            self._driver.clear()
            self.gate.clear()
            self.note_fault()
            response.success = True
            response.message = f"cleared {fault_text(fault)}; commands pass again after a new command and temperature"
        return response

    def _on_stop(
        self, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        self.gate.trip(
            FaultKind.STOPPED, "stopped on request; call clear_fault to continue"
        )
        self.note_fault()
        response.success = True
        response.message = fault_text(self.gate.fault)
        return response


def fault_text(fault: GuardFault | None) -> str:
    """A fault as text in messages; empty if there is none."""
    return "" if fault is None else f"{fault.kind.value}: {fault.message}"
