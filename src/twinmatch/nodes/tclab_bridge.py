"""Sets the heaters of a Temperature Control Lab, reads its sensors, and sets zero whenever in doubt."""

from __future__ import annotations

import time
from typing import ClassVar

import numpy as np
from rclpy.qos import qos_profile_sensor_data

from twinmatch.links.kit_link import KitAbsentError, KitError, KitLink, KitReading, KitSilentError
from twinmatch.nodes.gated import NAN, Decision, DriverPace, DriverThread, GatedNode, fault_text, gate_table
from twinmatch.nodes.messages import nanoseconds
from twinmatch.nodes.topics import RELIABLE
from twinmatch.parameters.declared import Setting
from twinmatch.parameters.twin import unit_of
from twinmatch.plants import TCLab
from twinmatch.safety import BudgetLimits, FaultKind, GuardLimits, RunawayLimits
from twinmatch_msgs.msg import PlantApplied, PlantCommand, PlantReading

_PORT = "Serial port of the kit, such as /dev/ttyACM0; empty: the first on the USB bus."
_DEADLINE = "Zero after this time without a command from this node, by the wall clock."


MAX_SILENCE = 0.3
"""Longest time between two commands to a kit, wall s: well within the deadline of the process at its port."""


class KitDriver(DriverThread[KitLink]):
    """The one thread that talks to a Temperature Control Lab.

    Several times a second it sets the command that the gate passes, or zero, and forwards the kit's readings.
    """

    NAME = "kit driver"
    CLOSING = 5.0
    ERRORS = KitError

    other = 0.0
    """Power of the second heater while commands pass, %."""
    _sent = (0.0, 0.0)
    _said_at = 0.0

    def _refusal(self, error: KitError) -> FaultKind | None:
        if isinstance(error, KitAbsentError) and not self._known:
            raise error  # a kit that was never there is not waited for
        return FaultKind.BOARD if isinstance(error, KitSilentError) else None

    def _connect(self) -> None:
        self.link.open()
        self._health.set("port", self.link.port)
        self._health.set("firmware", self.link.firmware)

    def _zero(self) -> None:
        self._tell(self.link.drive(0.0, 0.0), 0)

    def _serve(self, decision: Decision) -> None:
        wanted = (decision.input, self.other) if decision.armed else (0.0, 0.0)
        # By the wall clock too: a slow or stopped plant clock must not look like the end of this process.
        due = decision.time - self._sent_at >= self._pace.repeat or not self.connected
        if due or wanted != self._sent or time.monotonic() - self._said_at >= MAX_SILENCE:
            heats = wanted != (0.0, 0.0)
            self._driving = self._driving or heats  # it may heat though its answer is lost
            reading = self.link.drive(*wanted)
            self._sent, self._sent_at, self._said_at = wanted, decision.time, time.monotonic()
            self._driving, self.connected = heats, True
            self._tell(reading, decision.sample)
        self._gate.wait(self._pace.poll)


class TCLabBridge(GatedNode):
    """Passes commands to heater 1 while command, temperature, kit and clock are sound.

    Heater 2 has the constant power of its parameter while commands pass; it is the plant's disturbance.
    """

    NAME = "tclab_bridge"
    BOARD = "kit"
    LIMITS: ClassVar = GuardLimits(
        commands=(0.0, 100.0),
        highest=85.0,  # 10 °C above the highest set-point; the kit itself tolerates 100 °C
        lowest=-10.0,
        thing="heater",
        sensor="kit",
        unit=TCLab.output.unit,
        drive_unit=unit_of(TCLab.drive),
        # A heater at full power gains 8 °C in 30 s at first, and 2 °C near its highest temperature.
        runaway=RunawayLimits(gain=1.5, gain_time=30.0, full_drive=95.0),
        # Typical heaters are held by 1.3 % per °C; a degree costs 235 %·s, and the reading lags by 18 s.
        # With all parameters 25 % on the wrong side, a set-point uses two thirds of it.
        budget=BudgetLimits(hold=2.5, least=6000.0, each=400.0),
    )
    PLANT: ClassVar = TCLab
    STRUCTURE: ClassVar = "sensor lag, neighbour"
    PARAMETERS: ClassVar = (
        Setting("port", "", _PORT),
        Setting("second", 0.0, "Power of heater 2 while heater 1 is driven.", "%", 0.0, 100.0),
        Setting("repeat", 0.25, "Interval between two exchanges with the kit.", "s", 0.05, 0.5),
        Setting("deadline", 1.0, _DEADLINE, "s", 0.6, 60.0),
        Setting("frame_id", "kit", "Frame of plant/reading and plant/applied."),
        *gate_table(LIMITS),
    )
    CLOSING: ClassVar = 6

    def read_parameters(self) -> None:
        """Create the link and the gate."""
        super().read_parameters()
        self._link = KitLink(self.values["port"], self.values["deadline"])

    def open(self) -> None:
        """Subscribe, and connect to the kit."""
        self.create_subscription(PlantCommand, "plant/command", self._on_command, qos_profile_sensor_data)
        self._readings = self.create_publisher(PlantReading, "plant/reading", qos_profile_sensor_data)
        self._applied = self.create_publisher(PlantApplied, "plant/applied", RELIABLE)
        driver = KitDriver(self._link, self.gate, self._tell, self.health, DriverPace(self.values["repeat"]))
        driver.other = self.values["second"]
        self.gate.beside = np.array([driver.other])
        self.drive(driver, "plant/command", "plant/reading")

    def _on_command(self, message: PlantCommand) -> None:
        self.gate.command(message.input, message.index, nanoseconds(message.header.stamp))

    def _tell(self, reading: KitReading | None, index: int) -> None:
        """Publish the kit's readings; called in the driver's thread."""
        stamp = self.get_clock().now()
        applied = PlantApplied(sequence=index, input=NAN)
        applied.header.stamp, applied.header.frame_id = stamp.to_msg(), self.values["frame_id"]
        if reading is None:
            self.health.set("applied", "unknown")
        else:
            first, second, power, other = reading
            self.gate.temperature(first, stamp.nanoseconds)
            message = PlantReading(output=first, disturbances=[other])
            message.header = applied.header
            self._readings.publish(message)
            applied.input = power
            self.health.set("applied", power)
            self.health.set("T1", f"{first:.2f} °C")
            self.health.set("T2", f"{second:.2f} °C")
        self.note_fault()
        applied.fault = fault_text(self.gate.fault)
        self._applied.publish(applied)
