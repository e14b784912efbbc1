"""Carries commands to the PWM board, and zero whenever in doubt."""

from __future__ import annotations

import sys
import time
from typing import Any, ClassVar

from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import Temperature
from std_srvs.srv import Trigger

from twinmatch.links.pwm import Applied, LinkSettings, PwmLink
from twinmatch.nodes.diagnostics import Level, Report
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.nodes.output_gate import OutputGate, Times
from twinmatch.nodes.pwm_driver import DriverSettings, PwmDriver
from twinmatch.nodes.pwm_parameters import PWM_PARAMETERS, limits_from
from twinmatch.nodes.runner import run
from twinmatch.nodes.sample_messages import sample_from
from twinmatch.safety import ClockLimits, Fault, FaultKind
from twinmatch.signals import SignalError
from twinmatch_msgs.msg import LoopSample, PwmApplied, PwmCommand

__all__ = ["PwmBridge", "main"]

RELIABLE = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=100, reliability=ReliabilityPolicy.RELIABLE)
NAN = float("nan")
SIMULATED_POLL = 0.004
"""Longest sleep of the driver when the plant's clock may run many times as fast as the wall's, s."""
UNWATCHED = 5.0
"""Seconds without `plant/sample` after which the runaway watch is reported blind."""


class PwmBridge(TwinmatchNode):
    """Lets commands through while command, temperature, board and clock are sound.

    The callbacks only tell the gate; one thread of its own speaks to the board. A fault latches until
    `~/clear_fault` is called.
    """

    NAME = "pwm_bridge"
    PARAMETERS: ClassVar = PWM_PARAMETERS
    CLOSING: ClassVar = 3

    def read_parameters(self) -> None:
        """Make of them the link's settings and the guard's limits.

        Raises:
            TwinmatchError: some do not go together.
        """
        values = self.values
        self._link = PwmLink(values["port"], LinkSettings(values["timeout"], values["retries"]))
        self._gate = OutputGate(self._read_clocks, limits_from(values), ClockLimits(values["clock_timeout"]))
        self._pwm_driver: PwmDriver | None = None
        self._told_fault: Fault | None = None
        self._sampled_at = 0.0

    def open(self) -> None:
        """Listen, and begin to look for the board."""
        self.create_service(Trigger, "~/clear_fault", self._on_clear)
        self.create_service(Trigger, "~/stop", self._on_stop)
        self.create_subscription(
            Temperature, "plant/temperature", self._on_temperature, qos_profile_sensor_data
        )
        self._commands = self.create_subscription(
            PwmCommand, "plant/pwm_command", self._on_command, qos_profile_sensor_data
        )
        self.create_subscription(LoopSample, "plant/sample", self._on_sample, RELIABLE)
        self._applied = self.create_publisher(PwmApplied, "plant/pwm_applied", RELIABLE)
        settings = DriverSettings(repeat=self.values["repeat"])
        if self.get_parameter("use_sim_time").value:
            settings = DriverSettings(repeat=self.values["repeat"], poll=SIMULATED_POLL)
        self._pwm_driver = PwmDriver(self._link, self._gate, self._tell, self.health, settings)
        self.health.set("port", self.values["port"])
        self.report_on()
        self._pwm_driver.start()

    @property
    def failure(self) -> Exception | None:
        """What ended the driver's thread."""
        return None if self._pwm_driver is None else self._pwm_driver.failure

    def close(self) -> bool:
        """Set zero and let go of the board."""
        return self._pwm_driver is None or self._pwm_driver.close()

    def report(self) -> Report:
        """Fault, gate, link, clock, runaway watch."""
        self._note_fault()
        health, armed = self.health, self._gate.armed
        health.set("armed", armed)
        health.set("board restarts", self._link.restarts)
        health.say("commands pass" if armed else "waiting for a fresh command and temperature")
        if self._gate.clock_stopped:
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

    def _read_clocks(self) -> Times:
        stamps, wall = self.get_clock().now().nanoseconds, time.monotonic_ns()
        return Times(stamps, stamps if self.get_clock().ros_time_is_active else wall, wall)

    def _on_command(self, message: PwmCommand) -> None:
        self._gate.command(message.pwm, message.index, _nanoseconds(message.header.stamp))

    def _on_temperature(self, message: Temperature) -> None:
        self._gate.temperature(message.temperature, _nanoseconds(message.header.stamp))

    def _on_sample(self, message: LoopSample) -> None:
        try:
            sample = sample_from(message)
        except SignalError as error:
            self.health.complain("sample", Level.ERROR, f"plant/sample: {error}")
            return
        self._sampled_at = time.monotonic()
        self.health.withdraw("sample")
        self._gate.sample(sample.reference, sample.output, sample.input)

    def _on_clear(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        fault = self._gate.fault
        if fault is None:
            response.success, response.message = True, "there is no fault"
        elif self._pwm_driver is None or not self._pwm_driver.connected:
            response.message = f"{_text(fault)}; and the PWM board is not connected, which comes first"
        else:
            self._pwm_driver.clear()
            self._gate.clear()
            self._note_fault()
            response.success = True
            response.message = f"cleared {_text(fault)}; a new command and temperature will pass"
        return response

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._gate.trip(FaultKind.STOPPED, "stopped as asked; clear_fault lets it go on")
        self._note_fault()
        response.success, response.message = True, _text(self._gate.fault)
        return response

    def _tell(self, applied: Applied | None, index: int) -> None:
        """Publish what the board does; called in the driver's thread."""
        self._note_fault()
        message = PwmApplied(sequence=index, pwm=NAN, current=NAN, fault=_text(self._gate.fault))
        message.header.stamp = self.get_clock().now().to_msg()
        message.header.frame_id = self.values["frame_id"]
        if applied is None:
            self.health.set("applied", "unknown")
        else:
            message.pwm, message.current = float(applied.pwm), applied.current
            message.flags = int(applied.flags)
            self.health.set("applied", message.pwm)
            self.health.set("current", f"{applied.current:.2f} A")
        self._applied.publish(message)

    def _note_fault(self) -> None:
        """Bring a fault into the log, once, and into the health report."""
        fault, told = self._gate.fault, self._told_fault
        self._told_fault = fault
        if fault is None:
            self.health.withdraw("fault")
        elif fault is not told:
            self.health.complain("fault", Level.ERROR, _text(fault))
            self.health.count("faults")
            self.get_logger().error(f"output is zero: {_text(fault)}")


def _text(fault: Fault | None) -> str:
    return "" if fault is None else f"{fault.kind.value}: {fault.message}"


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def main() -> None:
    """Console script."""
    sys.exit(run([PwmBridge]))


if __name__ == "__main__":
    main()
