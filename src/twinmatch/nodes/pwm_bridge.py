"""Sends commands to the PWM board, and zero whenever in doubt."""

from __future__ import annotations

from typing import ClassVar

from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Temperature

from twinmatch.links.pwm_link import Applied, LinkSettings, PwmLink
from twinmatch.nodes.node import Report
from twinmatch.nodes.output_gate import GatedNode, fault_text, gate_table
from twinmatch.nodes.pwm_driver import DriverSettings, PwmDriver
from twinmatch.nodes.runner import program
from twinmatch.nodes.sample_messages import nanoseconds
from twinmatch.nodes.topics import RELIABLE
from twinmatch.parameters.declared import Parameter
from twinmatch.parameters.loop import unit_of
from twinmatch.plants import Peltier
from twinmatch.safety import GuardLimits
from twinmatch_msgs.msg import PwmApplied, PwmCommand

NAN = float("nan")
_TIMEOUT = "Longest wait for an answer of the board, by the wall clock."
SIMULATED_POLL = 0.004
"""Longest sleep of the driver when the plant's clock may run many times faster than the wall clock, s."""


class PwmBridge(GatedNode):
    """Passes commands on while command, temperature, board and clock are sound."""

    NAME = "pwm_bridge"
    BOARD = "PWM board"
    LIMITS: ClassVar = GuardLimits(unit=Peltier.output.unit, drive_unit=unit_of(Peltier.drive))
    PARAMETERS: ClassVar = (
        Parameter("port", "/dev/ttyACM0", "Serial port of the PWM board."),
        Parameter("timeout", LinkSettings().timeout, _TIMEOUT, "s", 0.01, 2.0),
        Parameter("retries", LinkSettings().retries, "Retries of an unanswered request.", "", 0, 10),
        Parameter("repeat", 0.1, "Interval at which the command is repeated.", "s", 0.02, 0.2),
        Parameter("frame_id", "driver", "Frame of plant/pwm_applied."),
        *gate_table(LIMITS, "; a flat-field correction takes 1 s"),
    )
    CLOSING: ClassVar = 3

    def read_parameters(self) -> None:
        """Derive the link's settings and the guard's limits.

        Raises:
            TwinmatchError: parameters contradict each other.
        """
        values = self.values
        self._link = PwmLink(values["port"], LinkSettings(values["timeout"], values["retries"]))
        self.make_gate()
        self._pwm_driver: PwmDriver | None = None

    def open(self) -> None:
        """Subscribe, and start to search for the board."""
        self.create_subscription(
            Temperature, "plant/temperature", self._on_temperature, qos_profile_sensor_data
        )
        self.guard(
            self.create_subscription(
                PwmCommand, "plant/pwm_command", self._on_command, qos_profile_sensor_data
            )
        )
        self._applied = self.create_publisher(PwmApplied, "plant/pwm_applied", RELIABLE)
        settings = DriverSettings(repeat=self.values["repeat"])
        if self.get_parameter("use_sim_time").value:
            settings = DriverSettings(repeat=self.values["repeat"], poll=SIMULATED_POLL)
        self._pwm_driver = PwmDriver(self._link, self.gate, self._tell, self.health, settings)
        if self.step is not None:
            self._pwm_driver.step, self._link.plant_time = self.step, self.step.breathe
        self.health.set("port", self.values["port"])
        self.report_on()
        self._pwm_driver.start()

    @property
    def failure(self) -> Exception | None:
        """The error that ended the driver's thread, if any."""
        return None if self._pwm_driver is None else self._pwm_driver.failure

    @property
    def board_there(self) -> bool:
        """Whether the board answers."""
        return self._pwm_driver is not None and self._pwm_driver.connected

    def clear_board(self) -> None:
        """Clear the fault latched by the board."""
        if self._pwm_driver is not None:
            self._pwm_driver.clear()

    def close(self) -> bool:
        """Set zero and release the board."""
        return self._pwm_driver is None or self._pwm_driver.close()

    def report(self) -> Report:
        """The gate, and the number of board restarts."""
        self.health.set("board restarts", self._link.restarts)
        return super().report()

    def _on_command(self, message: PwmCommand) -> None:
        self.gate.command(message.pwm, message.index, nanoseconds(message.header.stamp))

    def _on_temperature(self, message: Temperature) -> None:
        self.gate.temperature(message.temperature, nanoseconds(message.header.stamp))

    def _tell(self, applied: Applied | None, index: int) -> None:
        """Publish the command that the board applies; called in the driver's thread."""
        self.note_fault()
        message = PwmApplied(sequence=index, pwm=NAN, current=NAN, fault=fault_text(self.gate.fault))
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


main = program(PwmBridge)


if __name__ == "__main__":
    main()
