"""Plate, heat sink, fan and room of the virtual rig; the model is deliberately richer than the twin's."""

from __future__ import annotations

import math

from twinmatch.dynamics import Parameters, advance, begin, quantities, read
from twinmatch.emulation.arduino_pins import PinDrive
from twinmatch.plants import Peltier

__all__ = ["RICH_RIG", "VirtualPlant"]

RICH_RIG = Peltier.model("sink with mass").parameters(
    seebeck=0.06,
    resistance=3.3,
    conductance=0.5,
    heat_capacity=27.0,
    ambient=295.0,
    sink_heat_capacity=250.0,
    sink_convection=6.0,
)
"""The true parameters of the virtual rig: its heat sink has a mass, and a fan cools it."""

_STILL_AIR = 0.1
"""Fraction of the convection that remains without the fan."""
_AMBIENT_STEP = 10.0
"""K"""
_OPEN = 1e-9
"""Current limit of an open circuit, A: no current flows, not even from the Seebeck voltage."""


class VirtualPlant:
    """The plant between the driver's pins and the camera, in any structure of the Peltier rig."""

    def __init__(self, parameters: Parameters = RICH_RIG) -> None:
        self.states = begin(parameters, parameters["ambient"] - Peltier.output.absolute)
        self.wire_broken = False
        self.fan_failed = False
        self.warm_room = False
        self._parameters = parameters
        self._made: dict[tuple[bool, ...], Parameters] = {}
        # The first tick loads the plant's compiled code, which must not delay board time later.
        advance(self._under(enabled=False), self.states, 0.0, 1e-3)
        quantities(parameters, self.states, 0.0)

    @property
    def parameters(self) -> Parameters:
        """The rig's current parameters, including faults of the surroundings."""
        return self._under(enabled=True)

    @property
    def plate(self) -> float:
        """Temperature of the plate, °C."""
        return self._celsius("plate")

    @property
    def seen(self) -> float:
        """Temperature that the camera sees, °C: the plate's, with the sensor's lag if it has one."""
        return read(self.parameters, self.states)

    @property
    def sink(self) -> float:
        """Temperature of the heat sink, °C."""
        return self._celsius("sink")

    def advance(self, drive: PinDrive, seconds: float) -> None:
        """Advance under a drive. If the driver is off or the wire broken, the circuit is open."""
        found = self._under(enabled=drive.enabled and not self.wire_broken)
        self.states = advance(found, self.states, drive.pwm, seconds)

    def feedback(self, drive: PinDrive) -> float:
        """Mean current at the driver's feedback pin, A.

        The driver measures on its supply side, so the pin shows the current while the PWM is high and zero
        while it is low.
        """
        if self.wire_broken or not drive.enabled:
            return 0.0
        current = quantities(self.parameters, self.states, drive.pwm)["current"]
        return math.fabs(current * drive.pwm) / Peltier.drive.limits[1]

    def _celsius(self, name: str) -> float:
        """A state, °C; a sink without mass is at room temperature."""
        known = dict(zip(self._parameters.model.states, self.states.tolist(), strict=True))
        return float(known.get(name, self.parameters["ambient"])) - Peltier.output.absolute

    def _under(self, *, enabled: bool) -> Parameters:
        """Parameters under the active faults, with a closed or an open circuit; cached."""
        case = (self.fan_failed, self.warm_room, enabled)
        if case not in self._made:
            found = self._parameters
            if self.fan_failed and "sink_convection" in found:
                found = found.replace(sink_convection=_STILL_AIR * found["sink_convection"])
            if self.warm_room:
                found = found.replace(ambient=found["ambient"] + _AMBIENT_STEP)
            self._made[case] = found if enabled else found.replace(current_limit=_OPEN)
        return self._made[case]
