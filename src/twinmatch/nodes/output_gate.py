"""Base of the nodes between commands and a heater: parameters and gate of the output, fault services.

The node's callbacks provide the gate's inputs, the driver's thread asks it for decisions. All times there are
from a `SafetyClock`, which reads its clocks through one function, so that tests need neither clocks nor ROS.
"""

from __future__ import annotations

import threading
import time
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple

from std_srvs.srv import Trigger

from twinmatch.nodes.node import Level, Report, TwinmatchNode
from twinmatch.nodes.sample_messages import sample_from
from twinmatch.nodes.topics import RELIABLE
from twinmatch.parameters.declared import Parameter, group, parameters_of
from twinmatch.safety import (
    ClockLimits,
    Fault,
    FaultKind,
    GuardLimits,
    OutputGuard,
    SafetyClock,
)
from twinmatch.signals import SignalError
from twinmatch_msgs.msg import LoopSample


class Times(NamedTuple):
    """The same moment on three clocks, ns."""

    stamps: int
    """The clock of the messages' stamps."""
    plant: int
    """The clock for deadlines: the simulated one if there is one, else the monotonic one."""
    wall: int
    """A monotonic clock of this machine."""


class Decision(NamedTuple):
    """What may be sent to the driver."""

    input: float
    """Command u, in the drive's unit."""
    armed: bool
    """Whether commands pass and the driver's deadline may be kept alive."""
    sample: int
    """Sample at which the command was computed."""
    time: float
    """Time of the decision, s of the safety clock."""


class OutputGate:
    """An `OutputGuard` with its clocks and a lock."""

    def __init__(
        self,
        read_clocks: Callable[[], Times],
        limits: GuardLimits | None = None,
        clock_limits: ClockLimits | None = None,
    ) -> None:
        """Start with the output at zero, waiting for inputs."""
        self._read_clocks = read_clocks
        self._guard = OutputGuard(limits)
        self._safety_clock = SafetyClock(clock_limits)
        self._index = 0
        self.commanded = 0
        """Stamp of the newest command, ns."""
        self._news = threading.Condition(threading.RLock())

    @property
    def fault(self) -> Fault | None:
        """The latched fault, if any."""
        with self._news:
            return self._guard.fault

    @property
    def armed(self) -> bool:
        """Whether commands passed at the last decision."""
        with self._news:
            return self._guard.armed

    @property
    def clock_stopped(self) -> bool:
        """Whether the plant's clock stands still, or has not been seen to move."""
        with self._news:
            return self._safety_clock.stopped

    def command(self, value: float, index: int, stamp: int) -> None:
        """Take a command sent at `stamp` (ns), computed at sample `index`."""
        with self._news:
            now, times = self._now()
            self._guard.command(value, now, (times.stamps - stamp) / 1e9)
            self._index, self.commanded = index, stamp
            self._news.notify_all()

    def temperature(self, celsius: float, stamp: int) -> None:
        """Take a temperature measured at `stamp` (ns)."""
        with self._news:
            now, times = self._now()
            self._guard.temperature(celsius, now, (times.stamps - stamp) / 1e9)
            self._news.notify_all()

    def sample(self, reference: float, temperature: float, drive: float) -> None:
        """Take one tick of the control loop."""
        with self._news:
            self._guard.loop(reference, temperature, drive, self._now()[0])
            self._news.notify_all()

    def trip(self, kind: FaultKind, message: str) -> None:
        """Latch a fault."""
        with self._news:
            self._guard.trip(kind, message, self._now()[0])
            self._news.notify_all()

    def clear(self) -> Fault | None:
        """Clear the fault and return it; the output waits for new inputs."""
        with self._news:
            fault = self._guard.fault
            self._guard.clear()
            return fault

    def decide(self) -> Decision:
        """What may be sent now. Nothing is armed while the plant's clock stands still."""
        with self._news:
            now, _ = self._now()
            clock = self._safety_clock
            if clock.stopped:
                if self._guard.armed:
                    message = f"/clock has stood still for {clock.standing:.1f} s; is the simulator running?"
                    self._guard.trip(FaultKind.CLOCK, message, now)
                return Decision(0.0, False, self._index, now)
            value = self._guard.output(now)
            return Decision(value, self._guard.armed, self._index, now)

    def wait(self, timeout: float) -> None:
        """Sleep until there is a new input, `timeout` seconds of the wall clock at most."""
        with self._news:
            self._news.wait(timeout)

    def _now(self) -> tuple[float, Times]:
        times = self._read_clocks()
        return self._safety_clock.read(times.plant, times.wall), times


def gate_table(usual: GuardLimits, note: str = "") -> tuple[Parameter, ...]:
    """The parameters of the limits of a plant; `note` explains the default of the temperature's timeout."""
    most = max(map(abs, usual.commands))
    names = {"y": usual.unit, "u": usual.drive_unit, "note": note}
    silence, *others = parameters_of(usual, **names)
    *runaway, full = parameters_of(usual.runaway, "runaway.", **names)
    clock = "Zero when /clock stands still for this long, by the wall clock."
    return (
        silence,
        others[0],
        Parameter("clock_timeout", ClockLimits().patience, clock, "s", 0.1, 60.0),
        *others[1:],
        *runaway,
        replace(full, low=most / 255.0, high=most),
    )


def gate_limits(usual: GuardLimits, values: Mapping[str, Any]) -> GuardLimits:
    """The guard's limits from checked parameter values; the other limits are those of `usual`.

    Raises:
        SafetyError: values contradict each other.
    """
    own = {parameter.name: values[parameter.name] for parameter in parameters_of(usual)}
    return replace(usual, **own, runaway=replace(usual.runaway, **group(values, "runaway.")))


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

    def make_gate(self) -> None:
        """Create the gate.

        Raises:
            SafetyError: parameters contradict each other.
        """
        limits, clock = gate_limits(self.LIMITS, self.values), ClockLimits(self.values["clock_timeout"])
        self.gate = OutputGate(self._read_clocks, limits, clock)
        self._reported_fault: Fault | None = None
        self._sampled_at = 0.0

    def guard(self, commands: Any) -> None:
        """Offer the services and watch the samples; `commands` is the subscription to the commands."""
        self._commands = commands
        for place in ("~", "plant"):
            self.create_service(Trigger, f"{place}/clear_fault", self._on_clear)
            self.create_service(Trigger, f"{place}/stop", self._on_stop)
        self.create_subscription(LoopSample, "plant/sample", self._on_sample, RELIABLE)

    @property
    @abstractmethod
    def board_there(self) -> bool:
        """Whether the hardware answers."""

    @abstractmethod
    def clear_board(self) -> None:
        """Clear the fault latched by the hardware."""

    def report(self) -> Report:
        """Fault, gate, clock, runaway watch."""
        self.note_fault()
        health, armed = self.health, self.gate.armed
        health.set("armed", armed)
        health.say("passing commands" if armed else "waiting for a fresh command and temperature")
        unwatched = armed and time.monotonic() - self._sampled_at > UNWATCHED
        several = self.count_publishers(self._commands.topic_name) > 1
        for failed, key, message in (
            (self.gate.clock_stopped, "clock", "the clock stands still; nothing is driven"),
            (unwatched, "watch", "no messages on plant/sample; runaway is not monitored"),
            (several, "senders", "more than one node publishes commands; stop the others"),
        ):
            health.flag_if(failed, key, Level.WARN, message)
        return super().report()

    def note_fault(self) -> None:
        """Put a fault into the health report, and once into the log."""
        fault, reported = self.gate.fault, self._reported_fault
        self._reported_fault = fault
        if fault is None:
            self.health.withdraw("fault")
        elif fault is not reported:
            self.health.flag("fault", Level.ERROR, fault_text(fault))
            self.health.count("faults")
            self.get_logger().error(f"output is zero: {fault_text(fault)}")

    def _read_clocks(self) -> Times:
        stamps, wall = self.get_clock().now().nanoseconds, time.monotonic_ns()
        return Times(stamps, stamps if self.get_clock().ros_time_is_active else wall, wall)

    def _on_sample(self, message: LoopSample) -> None:
        try:
            sample = sample_from(message)
        except SignalError as error:
            self.health.flag("sample", Level.ERROR, f"plant/sample: {error}")
            return
        self._sampled_at = time.monotonic()
        self.health.withdraw("sample")
        self.gate.sample(sample.reference, sample.output, sample.input)

    def _on_clear(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        fault = self.gate.fault
        if fault is None:
            response.success, response.message = True, "there is no fault"
        elif not self.board_there:
            response.message = f"{fault_text(fault)}; not cleared: the {self.BOARD} is not connected"
        else:
            self.clear_board()
            self.gate.clear()
            self.note_fault()
            response.success = True
            response.message = (
                f"cleared {fault_text(fault)}; commands pass again after a new command and temperature"
            )
        return response

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.gate.trip(FaultKind.STOPPED, "stopped on request; call clear_fault to continue")
        self.note_fault()
        response.success, response.message = True, fault_text(self.gate.fault)
        return response


def fault_text(fault: Fault | None) -> str:
    """A fault as text in messages; empty if there is none."""
    return "" if fault is None else f"{fault.kind.value}: {fault.message}"
