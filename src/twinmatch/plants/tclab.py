"""The Temperature Control Lab: heater 1 warms sensor 1, next to a second heater.

Hedengren's energy balance (apmonitor.com/heat.htm; Park et al., Computers & Chemical Engineering 2020): the
power of the heater's transistor warms it, and it loses heat to the room by convection and radiation, and to
its neighbour likewise; the sensor, glued to it, follows with a lag.

    m c_p dT_H/dt = U A (T_∞ − T_H) + ε σ A (T_∞⁴ − T_H⁴) + Q_C12 + Q_R12 + α Q,    τ dT_C/dt = T_H − T_C

Except in the radiation, heat capacity, losses and heating power appear only as ratios, so the readings do not
determine their size; m c_p is fixed at the published 4 g of 500 J/(kg K).

The second heater's command Q2 is the measured disturbance, and its temperature a state. That temperature is
measured, too, but it depends on heater 1, so a forecast cannot take it as given, whereas future values of Q2
are known as far as they are planned.

Some kits answer later than this balance says, and some tables hold each input a row early. The structures
with a dead time of heater 1 are tried where the others leave too much of a window.

`TCLabBoth` is the whole kit: both heaters are driven and both temperatures measured.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar, Final

from twinmatch.dynamics import (
    DeadTime,
    Disturbance,
    Drive,
    Equations,
    Output,
    Parameter,
    PidGains,
    PidLoops,
    Plant,
    Sensor,
    State,
    Structure,
)
from twinmatch.settings import Rule
from twinmatch.signals import KELVIN


class HeaterSurface(Rule):
    """The surface of a heater."""

    to_room: float = 10e-4
    """Towards the room, m²."""
    to_neighbour: float = 2e-4
    """Towards the other heater, m²."""
    emissivity: float = 0.9


_SURFACE: Final = HeaterSurface()
_STEFAN_BOLTZMANN: Final = 5.670374e-8
"""W/(m² K⁴)."""

RESOLUTION: Final = 0.3223
"""Step of a reading, °C: 3.3 V in 1024 steps, 10 mV per degree."""

_LAG = "sensor lag"
_RADIATION = "radiation"
_NEIGHBOUR = "neighbour"
_DEAD = "dead time"

_HEATER: Final = ("losses", "heating", "ambient")
_LAGGED: Final = (*_HEATER, "sensor_lag")
_BOTH: Final = (*_LAGGED, "exchange")


def _structure(
    free: tuple[str, ...], *parts: str, watched: bool = True, text: str = ""
) -> Structure:
    return Structure(
        free=free,
        parts=frozenset(parts),
        # Without radiation, convection has to account for all losses.
        fixed={"losses": 8.0 if _RADIATION in parts else 14.0},
        free_starts=("neighbour",) if _NEIGHBOUR in parts else (),
        watched=watched,
        text=text,
    )


class TCLab(Plant, name="tclab"):
    """Heater 1 of a Temperature Control Lab, held by a PID, with heater 2 as disturbance."""

    title = "Temperature Control Lab"
    typical = {"losses": 11.0, "heating": 0.0085, "sensor_lag": 18.0}  # noqa: RUF012
    surroundings = "room, draught and second heater"
    time_constant = 100.0  # heater 110 to 180 s
    parts: ClassVar[tuple[str, ...]] = (_LAG, _RADIATION, _NEIGHBOUR, _DEAD)

    temperature = Output(
        unit="°C",
        noise=0.12,
        span=(-45.0, 130.0),
        set_points=(25.0, 70.0),
        safe=(0.0, 75.0),
        absolute=KELVIN,
        text="temperature T1",
        symbol="T₁",
        sensor="kit",
    )
    # The sensor is specified for −40 to 125 °C, and reads −50 °C if its wire is off. Above 75 °C skin burns.
    power = Drive(
        unit="%", limits=(0.0, 100.0), noise=2.0, text="heater 1", symbol="Q₁"
    )
    second = Disturbance(unit="%", default=0.0, text="heater 2", symbol="Q₂")

    heater = State(
        unit="K",
        span=(263.0, 423.0),
        start_bounds=(263.0, 423.0),
        text="heater 1",
        symbol="T_H1",
    )
    neighbour = State(
        unit="K",
        span=(263.0, 423.0),
        start_bounds=(263.0, 423.0),
        text="heater 2",
        symbol="T_H2",
    )
    sensor_state = State(
        unit="K", span=(263.0, 423.0), text="temperature of the sensor", symbol="T_C1"
    )

    # Two states follow it well enough behind the lag, in half the time of four.
    acting = DeadTime(
        unit="%", span=(0.0, 100.0), order=2, text="power that acts on heater 1"
    )

    losses = Parameter(
        unit="W/(m² K)",
        default=6.0,
        bounds=(1.0, 60.0),
        scale=5.0,
        least=0.0,
        role="losses",
        symbol="U",
        text="convection to the room",
    )
    heating = Parameter(
        unit="W/%",
        default=0.01,
        bounds=(0.001, 0.05),
        positive=True,
        symbol="α₁",
        text="power of heater 1",
    )
    ambient = Parameter(
        unit="K",
        default=296.0,
        bounds=(263.0, 323.0),
        scale=10.0,
        least=150.0,
        most=600.0,
        relative=False,
        role="room",
        symbol="T_∞",
        text="temperature of the room",
    )
    sensor_lag = Parameter(
        unit="s",
        default=15.0,
        bounds=(1.0, 60.0),
        positive=True,
        symbol="τ",
        text="lag of the sensor",
    )
    dead_time = Parameter(
        unit="s",
        default=6.0,
        bounds=(2.0, 30.0),
        positive=True,
        symbol="θ",
        text="dead time of a heater",
    )
    exchange = Parameter(
        unit="W/(m² K)",
        default=10.0,
        bounds=(0.0, 200.0),
        scale=10.0,
        least=0.0,
        symbol="U_S",
        text="convection between the heaters",
    )
    second_heating = Parameter(
        unit="W/%",
        default=0.0075,
        bounds=(0.0005, 0.05),
        positive=True,
        symbol="α₂",
        text="power of heater 2",
    )
    heat_capacity = Parameter(
        unit="J/K",
        default=2.0,
        bounds=(0.5, 10.0),
        positive=True,
        symbol="m c_p",
        text="heat capacity of one heater",
    )

    followed = "sensor lag"
    structures = {  # noqa: RUF012
        "sensor lag": _structure(
            _LAGGED, _LAG, text="one heater with proportional heat loss"
        ),
        "no lag": _structure(
            _HEATER, watched=False, text="the same without sensor lag"
        ),
        "radiation": _structure(_HEATER, _RADIATION, watched=False),
        "sensor lag, radiation": _structure(_LAGGED, _LAG, _RADIATION),
        "sensor lag, neighbour": _structure(_BOTH, _LAG, _NEIGHBOUR),
        "sensor lag, radiation, neighbour": _structure(
            _BOTH, _LAG, _RADIATION, _NEIGHBOUR, text="the published balance"
        ),
        "sensor lag, dead time": _structure(
            (*_LAGGED, "dead_time"), _LAG, _DEAD, watched=False
        ),
        "sensor lag, radiation, neighbour, dead time": _structure(
            (*_BOTH, "dead_time"), _LAG, _RADIATION, _NEIGHBOUR, _DEAD, watched=False
        ),
        "sensor lag, radiation, free neighbour": _structure(
            (*_BOTH, "second_heating"), _LAG, _RADIATION, _NEIGHBOUR, watched=False
        ),
    }

    # Kc = 5 %/K, τ_I = 120 s, τ_D = 2 s, derivative on measurement; the tracking time constant of the
    # back-calculation is √(τ_I τ_D), as Åström and Hägglund advise.
    loop = PidGains(
        proportional=5.0,
        integral=5.0 / 120.0,
        derivative=10.0,
        back_calculation=0.0645,
        low=0.0,
        high=100.0,
        on_measurement=True,
    )
    sensor = Sensor(noise=0.043, resolution=RESOLUTION)

    def equations(self, parts: frozenset[str]) -> Equations:
        """Heat into each heater, W; temperatures in kelvin."""
        heater = self.heater
        neighbour = self.neighbour
        reading = self.temperature + KELVIN

        def gained(
            temperature: Any, surroundings: Any, area: float, convection: Any
        ) -> Any:
            """Heat gained from a body at another temperature through a surface."""
            heat = convection * area * (surroundings - temperature)
            if _RADIATION in parts:
                heat += (
                    _SURFACE.emissivity
                    * _STEFAN_BOLTZMANN
                    * area
                    * (surroundings**4 - temperature**4)
                )
            return heat

        lost = -gained(heater, self.ambient, _SURFACE.to_room, self.losses)
        rates: dict[Any, Any] = {}
        start: dict[Any, Any] = {heater: reading}
        power = self.power
        if _DEAD in parts:
            arrives = self.acting.after(self.power, self.dead_time)
            power = arrives.value
            rates |= arrives.rates
            start |= arrives.start
        into = self.heating * power - lost
        if _NEIGHBOUR in parts:
            crossing = gained(heater, neighbour, _SURFACE.to_neighbour, self.exchange)
            into += crossing
            room = gained(neighbour, self.ambient, _SURFACE.to_room, self.losses)
            rates[neighbour] = (
                self.second_heating * self.second + room - crossing
            ) / self.heat_capacity
            start[neighbour] = self.ambient
        rates[heater] = into / self.heat_capacity
        measured = heater
        if _LAG in parts:
            measured = self.sensor_state
            rates[measured] = (heater - measured) / self.sensor_lag
            start[measured] = reading
        return Equations(
            rates=rates,
            output=measured - KELVIN,
            start=start,
            quantities={"heat_drawn": self.heating * power, "heat_lost": lost},
        )


def _whole(*parts: str, watched: bool = True, text: str = "") -> Structure:
    """Behind lags, the readings do not tell how warm the heaters are when a window begins."""
    free = (*(_LAGGED if _LAG in parts else _HEATER), "exchange", "second_heating")
    free += ("dead_time",) if _DEAD in parts else ()
    starts = ("heater", "neighbour") if _LAG in parts else ()
    return replace(
        _structure(free, *parts, watched=watched, text=text), free_starts=starts
    )


class TCLabBoth(TCLab, name="tclab-both"):
    """Both heaters of a Temperature Control Lab, each held by a PID: two inputs, two outputs."""

    title = "Temperature Control Lab, both heaters"
    surroundings = "room and draught"
    parts = (_LAG, _RADIATION, _DEAD)
    followed = "sensor lags, radiation"
    loop = PidLoops.of(TCLab.loop, TCLab.loop)  # type: ignore[assignment]

    second = Drive(
        unit="%", limits=(0.0, 100.0), noise=2.0, text="heater 2", symbol="Q₂"
    )
    second_temperature = Output(
        unit="°C",
        noise=0.12,
        span=(-45.0, 130.0),
        set_points=(25.0, 70.0),
        safe=(0.0, 75.0),
        absolute=KELVIN,
        text="temperature T2",
        symbol="T₂",
        sensor="kit",
    )
    second_sensor = State(
        unit="K", span=(263.0, 423.0), text="temperature of sensor 2", symbol="T_C2"
    )
    second_acting = DeadTime(
        unit="%", span=(0.0, 100.0), order=2, text="power that acts on heater 2"
    )

    structures = {  # noqa: RUF012
        "sensor lags": _whole(_LAG, text="both heaters, proportional losses"),
        "sensor lags, radiation": _whole(
            _LAG, _RADIATION, text="the published balance"
        ),
        "no lags": _whole(watched=False),
        "sensor lags, radiation, dead time": _whole(
            _LAG, _RADIATION, _DEAD, watched=False
        ),
    }

    def equations(self, parts: frozenset[str]) -> Equations:
        """The equations of heater 1 with its neighbour, which has a sensor here."""
        of_first = super().equations(parts | {_NEIGHBOUR})
        reading = self.second_temperature + KELVIN
        rates = {**of_first.rates}
        start = {**of_first.start, self.neighbour: reading}
        measured = self.neighbour
        if _DEAD in parts:
            arrives = self.second_acting.after(self.second, self.dead_time)
            rates[self.neighbour] = rates[self.neighbour].subs(
                self.second, arrives.value
            )
            rates |= arrives.rates
            start |= arrives.start
        if _LAG in parts:
            measured = self.second_sensor
            rates[measured] = (self.neighbour - measured) / self.sensor_lag
            start[measured] = reading
        output = {
            self.temperature: of_first.output,
            self.second_temperature: measured - KELVIN,
        }
        return Equations(
            rates=rates, output=output, start=start, quantities=of_first.quantities
        )
