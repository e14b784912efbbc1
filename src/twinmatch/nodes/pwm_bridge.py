"""Sends commands to the PWM board, and zero whenever in doubt."""

from __future__ import annotations

import time
from typing import ClassVar

from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Temperature

from twinmatch.links.pwm_link import (
    Applied,
    LinkSettings,
    PwmLatchedError,
    PwmLink,
    PwmLinkError,
    PwmResetError,
    PwmVersionError,
)
from twinmatch.links.pwm_protocol import Banner, Flags
from twinmatch.nodes.gated import (
    NAN,
    Decision,
    DriverPace,
    DriverThread,
    GatedNode,
    fault_text,
    gate_table,
)
from twinmatch.nodes.health import Level, Report
from twinmatch.nodes.messages import nanoseconds
from twinmatch.nodes.topics import RELIABLE
from twinmatch.parameters.declared import Setting, given_to, parameters_of
from twinmatch.parameters.twin import unit_of
from twinmatch.plants import Peltier
from twinmatch.safety import FaultKind, GuardLimits
from twinmatch_msgs.msg import PwmApplied, PwmCommand

IDLE = 0.25
"""Interval between two queries to a board that is not driven, wall s."""


class PwmDriver(DriverThread[PwmLink]):
    """The one thread that talks to the PWM board.

    Several times a second it sends the command that the gate passes, which keeps the board's watchdog
    satisfied. When the gate closes, it sends zero once and then only queries: after its deadline the board
    switches the output off by itself.
    """

    NAME = "pwm driver"
    CLOSING = 3.0
    ERRORS = PwmLinkError

    _sent = 0.0  # the command that was sent last
    _queried_at = 0.0  # wall s

    def _refusal(self, error: PwmLinkError) -> FaultKind | None:
        if isinstance(error, PwmVersionError):
            raise error
        if isinstance(error, PwmLatchedError) and error.flags & Flags.DRIVER:
            return FaultKind.DRIVER
        return (
            FaultKind.BOARD
            if isinstance(error, PwmLatchedError | PwmResetError)
            else None
        )

    def _connect(self) -> None:
        banner = self.link.open()
        self._check_pace(banner)
        flags = self.link.query().flags
        if flags & Flags.DRIVER:
            tripped = "the board has tripped because the motor driver reported a fault"
            self._gate.trip(FaultKind.DRIVER, tripped)
        elif flags & Flags.BUDGET:
            tripped = (
                "the board has switched off: high drive for longer than a plant needs"
            )
            self._gate.trip(
                FaultKind.BOARD, f"{tripped}; check sensor and drive, let it cool"
            )
        elif not self._has_answered:
            self.link.clear()
        elif flags & Flags.RESET:
            self._gate.trip(FaultKind.BOARD, "the PWM board restarted; find the cause")
        self.connected = True
        self._health.set("firmware", banner.firmware)

    def _zero(self) -> None:
        self._tell(self.link.command(0.0), 0)

    def _check_pace(self, banner: Banner) -> None:
        deadline = banner.deadline_ms / 1000
        link = self.link.settings
        self._health.set("board deadline", f"{deadline:g} s")
        longest = link.timeout * (link.retries + 1) + self._pace.repeat
        if longest >= deadline:
            message = (
                f"an answer may take {longest:g} s, but the board's deadline is {deadline:g} s; "
                "lower timeout, retries or repeat"
            )
            self._health.flag("pace", Level.WARN, message)

    def _serve(self, decision: Decision) -> None:
        if decision.armed:
            due = decision.time - self._sent_at >= self._pace.repeat
            if due or not self._driving or decision.inputs[0] != self._sent:
                self._drive(decision)
                return
        elif self._driving:
            self._driving = False
            self._tell(self.link.command(0.0), decision.sample)
            return
        elif time.monotonic() - self._queried_at >= IDLE:
            self._queried_at = time.monotonic()
            self._tell(self.link.query(), decision.sample)
            return
        self._gate.wait(self._pace.poll)

    def _drive(self, decision: Decision) -> None:
        if not self._driving:
            self._wake()
            # clearing takes time, in which the gate may have closed
            decision = self._gate.decide()
            if not decision.armed:
                return
        self._driving = True
        self._sent = decision.inputs[0]
        self._sent_at = decision.time
        applied = self.link.command(decision.inputs[0])
        self._tell(applied, decision.sample)
        if applied.pwm != round(decision.inputs[0]):
            message = f"the board applies {applied.pwm}, but {round(decision.inputs[0])} was sent"
            self._gate.trip(FaultKind.BOARD, f"{message}; is another program using it?")

    def _wake(self) -> None:
        """Clear a board that tripped on its deadline, which was intended; nothing else.

        Raises:
            PwmLatchedError: the board tripped for another reason.
        """
        flags = self.link.query().flags
        if flags & (Flags.DRIVER | Flags.RESET | Flags.BUDGET):
            self.link.command(0.0)  # refused, with the reason
        elif flags & Flags.TRIPPED:
            self.link.clear()


class PwmBridge(GatedNode):
    """Passes commands on while command, temperature, board and clock are sound."""

    NAME = "pwm_bridge"
    BOARD = "PWM board"
    PLANT: ClassVar = Peltier
    STRUCTURE: ClassVar = Peltier.followed
    LIMITS: ClassVar = GuardLimits(
        unit=Peltier.output.unit, drive_unit=unit_of(Peltier.drive)
    )
    PARAMETERS: ClassVar = (
        Setting("port", "/dev/ttyACM0", "Serial port of the PWM board."),
        *parameters_of(LinkSettings()),
        Setting(
            "repeat", 0.1, "Interval at which the command is repeated.", "s", 0.02, 0.2
        ),
        Setting("frame_id", "driver", "Frame of plant/pwm_applied."),
        *gate_table(LIMITS, "; a flat-field correction takes 1 s"),
    )
    CLOSING: ClassVar = 3

    def read_parameters(self) -> None:
        """Create the link and the gate."""
        super().read_parameters()
        self._link = PwmLink(self.values["port"], given_to(LinkSettings(), self.values))

    def open(self) -> None:
        """Subscribe, and start to search for the board."""
        commands = "plant/pwm_command"
        temperatures = "plant/temperature"
        self.create_subscription(
            Temperature, temperatures, self._on_temperature, qos_profile_sensor_data
        )
        self.create_subscription(
            PwmCommand, commands, self._on_command, qos_profile_sensor_data
        )
        self._applied = self.create_publisher(PwmApplied, "plant/pwm_applied", RELIABLE)
        self.health.set("port", self.values["port"])
        driver = PwmDriver(
            self._link,
            self.gate,
            self._tell,
            self.health,
            DriverPace(self.values["repeat"]),
        )
        self.drive(driver, commands, temperatures)

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
        message = PwmApplied(
            sequence=index, pwm=NAN, current=NAN, fault=fault_text(self.gate.fault)
        )
        message.header.stamp = self.get_clock().now().to_msg()
        message.header.frame_id = self.values["frame_id"]
        if applied is None:
            self.health.set("applied", "unknown")
        else:
            message.pwm = float(applied.pwm)
            message.current = applied.current
            message.flags = int(applied.flags)
            self.health.set("applied", message.pwm)
            self.health.set("current", f"{applied.current:.2f} A")
        self._applied.publish(message)
