"""Sends commands to the PWM board, and zero whenever in doubt."""

from __future__ import annotations

from typing import ClassVar

from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Temperature

from twinmatch.links.pwm_link import Applied, LinkSettings, PwmLink
from twinmatch.nodes.driver import PwmDriver
from twinmatch.nodes.gated import NAN, GatedNode, fault_text
from twinmatch.nodes.node import Report
from twinmatch.nodes.output_gate import gate_table
from twinmatch.nodes.runner import program
from twinmatch.nodes.sample_messages import nanoseconds
from twinmatch.nodes.topics import RELIABLE
from twinmatch.parameters.declared import Setting
from twinmatch.parameters.loop import unit_of
from twinmatch.plants import Peltier
from twinmatch.safety import GuardLimits
from twinmatch_msgs.msg import PwmApplied, PwmCommand

_TIMEOUT = "Longest wait for an answer of the board, by the wall clock."


class PwmBridge(GatedNode):
    """Passes commands on while command, temperature, board and clock are sound."""

    NAME = "pwm_bridge"
    BOARD = "PWM board"
    LIMITS: ClassVar = GuardLimits(unit=Peltier.output.unit, drive_unit=unit_of(Peltier.drive))
    PARAMETERS: ClassVar = (
        Setting("port", "/dev/ttyACM0", "Serial port of the PWM board."),
        Setting("timeout", LinkSettings().timeout, _TIMEOUT, "s", 0.01, 2.0),
        Setting("retries", LinkSettings().retries, "Retries of an unanswered request.", "", 0, 10),
        Setting("repeat", 0.1, "Interval at which the command is repeated.", "s", 0.02, 0.2),
        Setting("frame_id", "driver", "Frame of plant/pwm_applied."),
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
        self.health.set("port", self.values["port"])
        self.drive(PwmDriver(self._link, self.gate, self._tell, self.health, self.pace))

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
