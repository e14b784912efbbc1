"""Sets the heaters of a Temperature Control Lab, reads its sensors, and sets zero whenever in doubt."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

from rclpy.qos import qos_profile_sensor_data
from std_srvs.srv import Trigger

from twinmatch.comparing import Verdict
from twinmatch.links.kit_link import (
    KitAbsentError,
    KitError,
    KitLink,
    KitReading,
    KitSilentError,
)
from twinmatch.nodes.gated import (
    NAN,
    Decision,
    DriverPace,
    DriverThread,
    GatedNode,
    fault_text,
    gate_table,
)
from twinmatch.nodes.health import Level
from twinmatch.nodes.messages import nanoseconds
from twinmatch.nodes.topics import RELIABLE
from twinmatch.parameters.declared import ParameterError, Setting
from twinmatch.parameters.twin import outputs_named, unit_of
from twinmatch.plants import PLANTS, TCLab, TCLabBoth
from twinmatch.safety import (
    ACCUSED,
    BudgetLimits,
    FaultKind,
    GuardLimits,
    ObserverLimits,
    OutputGuard,
    RunawayLimits,
    StandIns,
)
from twinmatch_msgs.msg import (
    EstimatedReading,
    PlantApplied,
    PlantCommand,
    PlantReading,
)

_PORT = "Serial port of the kit, such as /dev/ttyACM0; empty: the first on the USB bus."
_PLANT = "Whether heater 1 is driven or both."
_READ_THROUGH = "Outputs for whose sensors the twin's estimate may stand in; needs both heaters; with spaces between."
_DEADLINE = "Zero after this time without a command from this node, by the wall clock."


SECOND = 0.55
"""Power of heater 2 as a share of that of heater 1. As published it is 0.75, of recorded kits 0.53 to 0.55, by the
firmware 0.5. With 0.6 the ceiling held heater 2 of a healthy kit of the last kind 1 K below its set-point."""
_SWAPPED = {"heating": "second_heating", "second_heating": "heating"}
"""Names of the heaters' powers as heater 2 sees the kit."""
MAX_SILENCE = 0.3
"""Longest time between two commands to a kit, wall s: well within the deadline of the process at its port."""


def _seen_from_heater_2(limits: ObserverLimits) -> ObserverLimits:
    """The observer's limits with what is measured of a kit as heater 2 sees it."""
    measured = limits.measured().items()
    swapped = ", ".join(
        f"{_SWAPPED.get(name, name)} = {value!r}" for name, value in measured
    )
    return replace(limits, known=swapped)


class KitDriver(DriverThread[KitLink]):
    """The one thread that talks to a Temperature Control Lab.

    Several times a second it sets the command that the gate passes, or zero, and forwards the kit's readings.
    """

    NAME = "kit driver"
    CLOSING = 5.0
    ERRORS = KitError

    _sent = (0.0, 0.0)
    _wall_sent_at = 0.0

    def _refusal(self, error: KitError) -> FaultKind | None:
        if isinstance(error, KitAbsentError) and not self._has_answered:
            raise error  # a kit that was never there is not waited for
        return FaultKind.BOARD if isinstance(error, KitSilentError) else None

    def _connect(self) -> None:
        self.link.open()
        self._health.set("port", self.link.port)
        self._health.set("firmware", self.link.firmware)

    def _zero(self) -> None:
        self._tell(self.link.drive(0.0, 0.0), 0)

    def _serve(self, decision: Decision) -> None:
        power, second_power = (
            (*decision.inputs, *self._gate.beside) if decision.armed else (0.0, 0.0)
        )
        wanted = (power, second_power)
        # By the wall clock too: a slow or stopped plant clock must not look like the end of this process.
        due = decision.time - self._sent_at >= self._pace.repeat or not self.connected
        if (
            due
            or wanted != self._sent
            or time.monotonic() - self._wall_sent_at >= MAX_SILENCE
        ):
            heats = wanted != (0.0, 0.0)
            # it may heat though its answer is lost
            self._driving = self._driving or heats
            reading = self.link.drive(*wanted)
            self._sent = wanted
            self._sent_at = decision.time
            self._wall_sent_at = time.monotonic()
            self._driving = heats
            self.connected = True
            self._tell(reading, decision.sample)
        self._gate.wait(self._pace.poll)


class TCLabBridge(GatedNode):
    """Passes commands to the heaters while command, temperatures, kit and clock are sound.

    Of plant tclab heater 1 is driven; heater 2 has the constant power of its parameter while commands pass,
    and is the plant's disturbance. Of tclab-both each heater is a disturbance for the guard of the other.
    """

    NAME = "tclab_bridge"
    BOARD = "kit"
    LIMITS: ClassVar = GuardLimits(
        commands=(0.0, 100.0),
        # 10 °C above the highest set-point; the kit itself tolerates 100 °C
        highest=85.0,
        lowest=-10.0,
        thing="heater",
        sensor="kit",
        unit=TCLab.output.unit,
        drive_unit=unit_of(TCLab.drive),
        # A heater at full power gains 8 °C in 30 s at first, and 2 °C near its highest temperature.
        runaway=RunawayLimits(gain=1.5, gain_time=30.0, full_drive=95.0),
        # Typical heaters are held by 1.3 % per °C; a degree costs 235 %·s, and the reading lags by 18 s.
        # With all parameters 25 % on the wrong side, and half as much again in a draught, it is 3.3 % per °C.
        budget=BudgetLimits(hold=3.3, least=6000.0, each=400.0),
    )
    PLANT: ClassVar = TCLab
    STRUCTURE: ClassVar = "sensor lag, neighbour"
    PARAMETERS: ClassVar = (
        Setting("port", "", _PORT),
        Setting("plant", TCLab.name, _PLANT, choices=(TCLab.name, TCLabBoth.name)),
        Setting(
            "second",
            0.0,
            "Power of heater 2 while heater 1 alone is driven.",
            "%",
            0.0,
            100.0,
        ),
        Setting("read_through", "", _READ_THROUGH),
        Setting(
            "repeat",
            0.25,
            "Interval between two exchanges with the kit.",
            "s",
            0.05,
            0.5,
        ),
        Setting("deadline", 1.0, _DEADLINE, "s", 0.6, 60.0),
        Setting("frame_id", "kit", "Frame of plant/reading and plant/applied."),
        *gate_table(LIMITS),
    )
    CLOSING: ClassVar = 6

    def read_parameters(self) -> None:
        """Create the link and the gate."""
        self._plant = PLANTS[self.values["plant"]]
        super().read_parameters()
        second = self.values["second"]
        both = self._plant is TCLabBoth
        if both and second:
            raise ParameterError(
                f"{self.NAME}: second is {second:g} %, but plant tclab-both drives heater 2"
            )
        self.gate.beside = () if both else (second,)
        if self.values["read_through"] and not both:
            raise ParameterError(
                f"{self.NAME}: read_through needs plant tclab-both: with one sensor, nothing else says what "
                "it should read"
            )
        readable = outputs_named(self.NAME, self.values["read_through"], TCLabBoth)
        self._stand_ins = StandIns(readable, self.values["highest"], TCLab.output.unit)
        self._link = KitLink(self.values["port"], self.values["deadline"])

    def output_guards(self, limits: GuardLimits) -> list[OutputGuard]:
        """The guard of each drive."""
        return (
            super().output_guards(limits)
            if self._plant is TCLab
            else self.guards_of_both(limits)
        )

    @classmethod
    def guards_of_both(cls, limits: GuardLimits) -> list[OutputGuard]:
        """The guards of both heaters; that of heater 2 sees the kit from there.

        Where one cools, it is a load on the other, which may need twice the time to get nearer.
        """
        kit = cls.PLANT.model(cls.STRUCTURE).typical()
        budget = limits.budget
        weaker = {
            name: getattr(budget, name) / SECOND for name in ("hold", "least", "each")
        }
        first_power = kit["heating"]
        second_power = SECOND * kit["heating"]
        common = replace(
            limits,
            runaway=replace(limits.runaway, gain_time=2.0 * limits.runaway.gain_time),
        )
        first_limits = replace(common, thing="first heater", sensor="first sensor")
        second_limits = replace(
            common,
            thing="second heater",
            sensor="second sensor",
            budget=replace(budget, **weaker),
            observer=_seen_from_heater_2(limits.observer),
        )
        seen_from_first = kit.replace(heating=first_power, second_heating=second_power)
        seen_from_second = kit.replace(heating=second_power, second_heating=first_power)
        return [
            OutputGuard(first_limits, cls.observer(first_limits, seen_from_first)),
            OutputGuard(second_limits, cls.observer(second_limits, seen_from_second)),
        ]

    def open(self) -> None:
        """Subscribe, and connect to the kit."""
        self.create_subscription(
            PlantCommand, "plant/command", self._on_command, qos_profile_sensor_data
        )
        self._readings = self.create_publisher(
            PlantReading, "plant/reading", qos_profile_sensor_data
        )
        self._applied = self.create_publisher(PlantApplied, "plant/applied", RELIABLE)
        inputs = ["plant/command", "plant/reading"]
        if self._stand_ins:
            self.create_subscription(
                EstimatedReading, "plant/estimate", self._on_estimate, RELIABLE
            )
            inputs.append("plant/estimate")
        driver = KitDriver(
            self._link,
            self.gate,
            self._tell,
            self.health,
            DriverPace(self.values["repeat"]),
        )
        self.drive(driver, *inputs)

    def _on_command(self, message: PlantCommand) -> None:
        self.gate.command(
            message.input, message.index, nanoseconds(message.header.stamp)
        )

    def _on_estimate(self, estimate: EstimatedReading) -> None:
        self._stand_ins.take(
            estimate.signal,
            estimate.value,
            estimate.band,
            estimate.wide,
            self.gate.time,
        )

    def reads_through(self, verdict: Verdict) -> bool:
        """Whether the sensor that is accused may be read through; from now on it is not believed."""
        return self._stand_ins.accuse(
            verdict.fault_signal, verdict.fault, self.gate.time
        )

    def _on_clear(
        self, request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        response = super()._on_clear(request, response)
        if response.success:  # somebody vouches for the readings
            self._stand_ins.give_back()
        return response

    def _on_verdict(self, verdict: Verdict) -> None:
        super()._on_verdict(verdict)
        if not verdict.fault:
            self._stand_ins.give_back()
        if verdict.fault not in ACCUSED["drive"]:
            return
        for name in self._stand_ins.accused:
            if verdict.fault_signal != name:
                self.end(
                    FaultKind.TWIN,
                    f"{name} is read through, and the twin reports {verdict.fault}",
                )

    def _taken(self) -> Sequence[float]:
        """What the law takes in place of the temperatures, NaN for those that are believed; empty without
        stand-ins.

        The drive ends where neither a sensor nor an estimate is known well enough.
        """
        if not self._stand_ins:
            return ()
        values = dict.fromkeys(self._plant.outputs, NAN)
        for name, (value, trouble) in self._stand_ins.look(self.gate.time).items():
            values[name] = value
            if trouble:
                self.end(FaultKind.ESTIMATE, trouble)
        on = " and ".join(
            name for name, value in values.items() if not math.isnan(value)
        )
        self.health.flag_if(
            bool(on),
            "estimate",
            Level.WARN,
            f"the law runs on the twin's estimate of {on}",
        )
        return list(values.values())

    def _tell(self, reading: KitReading | None, index: int) -> None:
        """Publish the kit's readings; called in the driver's thread."""
        stamp = self.get_clock().now()
        drives = len(self._plant.drives)
        applied = PlantApplied(sequence=index, input=[NAN] * drives)
        applied.header.stamp = stamp.to_msg()
        applied.header.frame_id = self.values["frame_id"]
        if reading is None:
            self.health.set("applied", "unknown")
        else:
            temperatures = reading[:2]
            powers = reading[2:]
            self.gate.temperature(temperatures[:drives], stamp.nanoseconds)
            message = PlantReading(
                output=temperatures[:drives],
                taken=self._taken(),
                disturbances=powers[drives:],
            )
            message.header = applied.header
            self._readings.publish(message)
            applied.input = powers[:drives]
            self.health.set("applied", ", ".join(map(str, powers[:drives])))
            for name, celsius in zip(("T1", "T2"), temperatures, strict=True):
                self.health.set(name, f"{celsius:.2f} °C")
        self.note_fault()
        applied.fault = fault_text(self.gate.fault)
        self._applied.publish(applied)
