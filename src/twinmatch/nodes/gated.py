"""What nodes have in common that stand between commands and something that heats."""

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
"""For samples and for what was applied."""
UNWATCHED = 5.0
"""Seconds without `plant/sample` after which the runaway watch is reported blind."""


class GatedNode(TwinmatchNode):
    """Lets commands through while command, temperature, board and clock are sound.

    The callbacks only tell the gate; one thread of the subclass speaks to the board. A fault latches until
    `plant/clear_fault` is called, which `~/clear_fault` is as well; `plant/stop` makes one.
    """

    BOARD: str
    """What is driven, in words."""

    def make_gate(self, limits: GuardLimits, clock: ClockLimits) -> None:
        """Make the gate."""
        self.gate = OutputGate(self._read_clocks, limits, clock)
        self._told_fault: Fault | None = None
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
        """Whether what is driven answers."""

    @abstractmethod
    def clear_board(self) -> None:
        """Let go of its own latch."""

    def report(self) -> Report:
        """Fault, gate, clock, runaway watch."""
        self.note_fault()
        health, armed = self.health, self.gate.armed
        health.set("armed", armed)
        health.say("commands pass" if armed else "waiting for a fresh command and temperature")
        if self.gate.clock_stopped:
            health.complain("clock", Level.WARN, "the clock stands still; nothing is driven")
        else:
            health.withdraw("clock")
        if armed and time.monotonic() - self._sampled_at > UNWATCHED:
            health.complain("watch", Level.WARN, "no plant/sample comes; nobody watches for a runaway")
        else:
            health.withdraw("watch")
        if self.count_publishers(self._commands.topic_name) > 1:
            health.complain("senders", Level.WARN, "two nodes send commands; end one of them")
        else:
            health.withdraw("senders")
        return super().report()

    def note_fault(self) -> None:
        """Bring a fault into the log, once, and into the health report."""
        fault, told = self.gate.fault, self._told_fault
        self._told_fault = fault
        if fault is None:
            self.health.withdraw("fault")
        elif fault is not told:
            self.health.complain("fault", Level.ERROR, fault_text(fault))
            self.health.count("faults")
            self.get_logger().error(f"output is zero: {fault_text(fault)}")

    def _read_clocks(self) -> Times:
        stamps, wall = self.get_clock().now().nanoseconds, time.monotonic_ns()
        return Times(stamps, stamps if self.get_clock().ros_time_is_active else wall, wall)

    def _on_sample(self, message: LoopSample) -> None:
        try:
            sample = sample_from(message)
        except SignalError as error:
            self.health.complain("sample", Level.ERROR, f"plant/sample: {error}")
            return
        self._sampled_at = time.monotonic()
        self.health.withdraw("sample")
        self.gate.sample(sample.reference, sample.output, sample.input)

    def _on_clear(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        fault = self.gate.fault
        if fault is None:
            response.success, response.message = True, "there is no fault"
        elif not self.board_there:
            response.message = (
                f"{fault_text(fault)}; and the {self.BOARD} is not connected, which comes first"
            )
        else:
            self.clear_board()
            self.gate.clear()
            self.note_fault()
            response.success = True
            response.message = f"cleared {fault_text(fault)}; a new command and temperature will pass"
        return response

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.gate.trip(FaultKind.STOPPED, "stopped as asked; clear_fault lets it go on")
        self.note_fault()
        response.success, response.message = True, fault_text(self.gate.fault)
        return response


def fault_text(fault: Fault | None) -> str:
    """A fault as messages have it; empty if there is none."""
    return "" if fault is None else f"{fault.kind.value}: {fault.message}"
