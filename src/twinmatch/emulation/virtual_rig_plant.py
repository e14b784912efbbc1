"""The plate, the heat sink, the fan and the room of the virtual rig: richer than the twin, on purpose."""

from __future__ import annotations

import math

from twinmatch.emulation.arduino_pins import Drive
from twinmatch.plant import Driver, PlantState, RigParameters, advance, heat_flows
from twinmatch.signals import KELVIN, PWM_LIMIT

__all__ = ["RICH_RIG", "VirtualPlant"]

RICH_RIG = RigParameters(
    seebeck=0.06,
    resistance=3.3,
    conductance=0.5,
    heat_capacity=27.0,
    ambient=295.0,
    sink_heat_capacity=250.0,
    sink_convection=6.0,
)
"""The truth behind the virtual rig: its heat sink has a mass, and a fan cools it."""

_STILL_AIR = 0.1
"""Share of the convection that is left without the fan."""
_AMBIENT_STEP = 10.0
"""K."""
_OPEN = Driver(current_limit=1e-9)
"""A circuit that is open: no current flows, not even that of the Seebeck voltage."""


class VirtualPlant:
    """The plant between the driver's pins and the camera's eye."""

    def __init__(self, parameters: RigParameters = RICH_RIG) -> None:
        self.state = PlantState(parameters.ambient, parameters.ambient)
        self.wire_broken = False
        self.fan_failed = False
        self.warm_room = False
        self._parameters = parameters
        self._driver = Driver()
        # The first tick compiles the plant's arithmetic, which must not hold up the board's time later.
        advance(parameters, self.state, 0.0, 1e-3, _OPEN)
        heat_flows(parameters, self.state, 0.0, self._driver)

    @property
    def parameters(self) -> RigParameters:
        """The rig's parameters as of now, faults included."""
        found = self._parameters
        if self.fan_failed:
            found = found.replace(sink_convection=_STILL_AIR * found.sink_convection)
        if self.warm_room:
            found = found.replace(ambient=found.ambient + _AMBIENT_STEP)
        return found

    @property
    def plate(self) -> float:
        """Temperature of the plate, °C."""
        return self.state.plate - KELVIN

    @property
    def seen(self) -> float:
        """Temperature that the camera sees, °C: the plate's, with the sensor's lag if it has one."""
        return self.state.sensor - KELVIN

    @property
    def sink(self) -> float:
        """Temperature of the heat sink, °C."""
        return self.state.sink - KELVIN

    def advance(self, drive: Drive, seconds: float) -> None:
        """Let time pass under a drive. A driver that is off, or a broken wire, leaves the circuit open."""
        driver = self._driver if drive.enabled and not self.wire_broken else _OPEN
        self.state = advance(self.parameters, self.state, drive.pwm, seconds, driver)

    def feedback(self, drive: Drive) -> float:
        """Mean current at the driver's feedback pin, A.

        The driver measures at its supply side, so that the pin shows the current while the PWM is high
        and nothing while it is low.
        """
        if self.wire_broken or not drive.enabled:
            return 0.0
        current = heat_flows(self.parameters, self.state, drive.pwm, self._driver).current
        return math.fabs(current * drive.pwm) / PWM_LIMIT
