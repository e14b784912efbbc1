"""Base of the nodes between commands and a heater: gate, fault services, runaway watch."""

from __future__ import annotations

import time
from abc import abstractmethod
from typing import Any

from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger

from twinmatch.nodes.diagnostics import Level, Report
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.nodes.output_gate import OutputGate, Times
from twinmatch.nodes.sample_messages import sample_from
from twinmatch.safety import ClockLimits, Fault, FaultKind, GuardLimits
from twinmatch.signals import SignalError
from twinmatch_msgs.msg import LoopSample

__all__ = ["KEPT", "GatedNode", "fault_text"]

KEPT = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=100, reliability=ReliabilityPolicy.RELIABLE)
"""For samples and for the applied command."""
UNWATCHED = 5.0
"""Time without `plant/sample` after which a warning says that runaway is not monitored, s."""


class GatedNode(TwinmatchNode):
    """Passes commands on while command, temperature, board and clock are sound.

    The callbacks only feed the gate; one thread of the subclass talks to the board. A fault latches until
    `plant/clear_fault` or `~/clear_fault` is called; `plant/stop` and `~/stop` latch one.
    """

    BOARD: str
    """Name of the hardware in messages."""

    def make_gate(self, limits: GuardLimits, clock: ClockLimits) -> None:
        """Create the gate."""
        self.gate = OutputGate(self._read_clocks, limits, clock)
        self._reported_fault: Fault | None = None
        self._sampled_at = 0.0

    def guard(self, commands: Any) -> None:
        """Offer the services and watch the samples; `commands` is the subscription to the commands."""
        self._commands = commands
        for place in ("~", "plant"):
            self.create_service(Trigger, f"{place}/clear_fault", self._on_clear)
            self.create_service(Trigger, f"{place}/stop", self._on_stop)
        self.create_subscription(LoopSample, "plant/sample", self._on_sample, KEPT)

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
        if self.gate.clock_stopped:
            health.flag("clock", Level.WARN, "the clock stands still; nothing is driven")
        else:
            health.withdraw("clock")
        if armed and time.monotonic() - self._sampled_at > UNWATCHED:
            health.flag("watch", Level.WARN, "no messages on plant/sample; runaway is not monitored")
        else:
            health.withdraw("watch")
        if self.count_publishers(self._commands.topic_name) > 1:
            health.flag("senders", Level.WARN, "more than one node publishes commands; stop the others")
        else:
            health.withdraw("senders")
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
