"""Base of the nodes between commands and a heater: gate, driver, fault services."""

from __future__ import annotations

import time
from typing import Any, ClassVar

from std_srvs.srv import Trigger

from twinmatch.nodes.driver import DriverPace, DriverThread
from twinmatch.nodes.node import Level, Report, TwinmatchNode
from twinmatch.nodes.output_gate import ClockTimes, OutputGate, gate_limits
from twinmatch.nodes.sample_messages import sample_from
from twinmatch.nodes.topics import RELIABLE
from twinmatch.safety import ClockLimits, FaultKind, GuardFault, GuardLimits
from twinmatch.signals import SignalError
from twinmatch_msgs.msg import LoopSample

NAN = float("nan")
SIMULATED_POLL = 0.004
"""Longest sleep of the driver when the plant's clock may run many times faster than the wall clock, s."""
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

    _driver: DriverThread[Any] | None = None

    def make_gate(self) -> None:
        """Create the gate.

        Raises:
            SafetyError: parameters contradict each other.
        """
        limits, clock = gate_limits(self.LIMITS, self.values), ClockLimits(self.values["clock_timeout"])
        self.gate = OutputGate(self._read_clocks, limits, clock)
        self._reported_fault: GuardFault | None = None
        self._sampled_at = 0.0

    def guard(self, commands: Any) -> None:
        """Offer the services and watch the samples; `commands` is the subscription to the commands."""
        self._commands = commands
        for place in ("~", "plant"):
            self.create_service(Trigger, f"{place}/clear_fault", self._on_clear)
            self.create_service(Trigger, f"{place}/stop", self._on_stop)
        self.create_subscription(LoopSample, "plant/sample", self._on_sample, RELIABLE)

    @property
    def pace(self) -> DriverPace:
        """Pace of the driver, which sleeps less if the plant's clock may run faster than the wall clock."""
        simulated = self.get_parameter("use_sim_time").value
        return DriverPace(self.values["repeat"], SIMULATED_POLL if simulated else DriverPace.poll)

    def drive(self, driver: DriverThread[Any]) -> None:
        """Report from now on, and start the thread that talks to the hardware."""
        if self.step is not None:
            driver.step, driver.link.plant_time = self.step, self.step.breathe
        self._driver = driver
        self.report_on()
        driver.start()

    @property
    def failure(self) -> Exception | None:
        """The error that ended the driver's thread, if any."""
        return None if self._driver is None else self._driver.failure

    def close(self) -> bool:
        """Set zero and release the hardware."""
        return self._driver is None or self._driver.close()

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

    def _read_clocks(self) -> ClockTimes:
        stamps, wall = self.get_clock().now().nanoseconds, time.monotonic_ns()
        return ClockTimes(stamps, stamps if self.get_clock().ros_time_is_active else wall, wall)

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
        elif self._driver is None or not self._driver.connected:
            response.message = f"{fault_text(fault)}; not cleared: the {self.BOARD} is not connected"
        else:
            self._driver.clear()
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


def fault_text(fault: GuardFault | None) -> str:
    """A fault as text in messages; empty if there is none."""
    return "" if fault is None else f"{fault.kind.value}: {fault.message}"
