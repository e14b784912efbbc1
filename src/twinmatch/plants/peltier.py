"""The paper's plant: a Peltier plate on a heat sink under a thermal camera (section III).

Electrical domain: the bridge applies a mean voltage proportional to the PWM to the module, and the driver
limits the current. Thermal domain: the Peltier effect, Joule heat and conduction move heat between the plate
(side A) and the sink (side B); the plate's heat capacity turns heat into temperature. Fluid domain: the sink
loses its heat to the room. Digital domain: the camera's reading, once a sample, and the PID.

If the module's Seebeck coefficient depends on temperature, α(T) = α + β·(T − T₀), all its effects are
modelled: the Seebeck voltage is ∫α dT = α(T̄)·(T_B − T_A), T̄ being the mean of both sides; the Peltier
heats are α(T_A)·T_A·I and −α(T_B)·T_B·I; half of the Thomson heat I·∫T dα goes to either side. Together that
is α(T̄)·T·I ± ¼·β·(T_B − T_A)²·I, and energy balances.

The paper prints its equation 2 with +α·T_B·I; energy balances only with the minus sign used here.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from twinmatch.dynamics import (
    Drive,
    Equations,
    Output,
    Parameter,
    PidGains,
    Plant,
    Sensor,
    State,
    Structure,
    limited,
    magnitude,
)
from twinmatch.signals import KELVIN

SEEBECK_REFERENCE: Final = 298.15
"""Temperature at which a module has its nominal Seebeck coefficient, K; data sheets use it too."""
COUNTS: Final = 255.0
"""PWM counts of a duty cycle of one."""

_MASS = "sink with mass"
_LAG = "sensor lag"
_SLOPE = "α(T)"

_PLATE: Final = ("seebeck", "conductance", "heat_capacity")
_ROOM: Final = (*_PLATE, "ambient")
_SINK: Final = (*_PLATE, "sink_heat_capacity", "sink_convection")
_BOTH: Final = (*_ROOM, "sink_heat_capacity", "sink_convection")

_RIG: Final = {"seebeck": 0.06, "conductance": 0.7, "heat_capacity": 28.0}
_VALLEY: Final = (
    {"seebeck": 0.09, "conductance": 0.6, "heat_capacity": 40.0},
    {"seebeck": 0.13, "conductance": 0.3, "heat_capacity": 58.0},
)
"""Starts along the valley in which Seebeck coefficient, conductance and heat capacity trade off."""


def _structure(
    free: tuple[str, ...],
    parts: tuple[str, ...] = (),
    *,
    switched: bool = False,
    room: float = 293.0,
    watched: bool = False,
) -> Structure:
    return Structure(
        free=free,
        parts=frozenset(parts),
        fixed={**_RIG, "ambient": room, "drive_ripple": float(switched)},
        free_starts=("sink",) if _MASS in parts else (),
        starts=_VALLEY,
        watched=watched,
    )


class Peltier(Plant, name="peltier"):
    """A Peltier plate on a heat sink, driven by a PWM bridge, measured by a thermal camera, held by a PID."""

    title = "Peltier rig"
    surroundings = "fan, heat sink and room"
    typical = {"seebeck": 0.06, "conductance": 0.65, "heat_capacity": 28.0}  # noqa: RUF012
    time_constant = 100.0  # plate 28 s, sink 128 s
    parts = (_MASS, _LAG, _SLOPE)

    temperature = Output(
        unit="°C",
        noise=0.1,
        span=(-60.0, 250.0),
        set_points=(20.0, 90.0),
        safe=(0.0, 100.0),
        absolute=KELVIN,
        text="plate temperature",
        symbol="y",
        sensor="camera",
    )
    # Below 0 °C the plate ices; the module's solder softens at 138 °C, and the loop overshoots.
    pwm = Drive(
        unit="PWM",
        limits=(-COUNTS, COUNTS),
        noise=7.0,
        text="PWM, positive heats",
        symbol="u",
    )

    plate = State(unit="K", span=(250.0, 400.0), text="plate (side A)", symbol="T_A")
    sink = State(
        unit="K",
        span=(250.0, 400.0),
        start_bounds=(253.0, 393.0),
        text="heat sink (side B)",
        symbol="T_B",
    )
    sensor_state = State(
        unit="K", span=(250.0, 400.0), text="temperature at the camera", symbol="T_C"
    )

    seebeck = Parameter(
        unit="V/K",
        default=0.075,
        bounds=(0.01, 0.2),
        least=0.0,
        symbol="α",
        text="Seebeck coefficient",
    )
    resistance = Parameter(
        unit="Ω",
        default=3.3,
        bounds=(0.5, 10.0),
        positive=True,
        symbol="R",
        text="electrical resistance",
    )
    conductance = Parameter(
        unit="W/K",
        default=0.35,
        bounds=(0.0, 2.0),
        least=0.0,
        symbol="K",
        text="thermal conductance",
    )
    heat_capacity = Parameter(
        unit="J/K",
        default=15.0,
        bounds=(5.0, 150.0),
        scale=30.0,
        positive=True,
        symbol="C",
        text="heat capacity of the plate",
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
    sink_heat_capacity = Parameter(
        unit="J/K",
        default=350.0,
        bounds=(20.0, 5000.0),
        scale=300.0,
        positive=True,
        symbol="C_S",
        text="heat capacity of the sink",
    )
    sink_convection = Parameter(
        unit="W/K",
        default=3.0,
        bounds=(0.1, 100.0),
        least=0.0,
        role="losses",
        symbol="h",
        text="convection from the sink to the room",
    )
    sensor_lag = Parameter(
        unit="s",
        default=1.0,
        bounds=(0.2, 20.0),
        scale=2.0,
        positive=True,
        symbol="τ",
        text="lag of the camera",
    )
    seebeck_slope = Parameter(
        unit="V/K²",
        default=0.0,
        bounds=(-5e-4, 5e-4),
        scale=1e-4,
        relative=False,
        symbol="β",
        text="change of the Seebeck coefficient with temperature",
    )
    drive_ripple = Parameter(
        unit="",
        default=0.0,
        bounds=(0.0, 1.0),
        scale=1.0,
        least=0.0,
        most=1.0,
        symbol="ρ",
        text="share of the bridge's switching ripple that reaches the module",
    )
    supply = Parameter(
        unit="V",
        default=12.0,
        bounds=(3.0, 24.0),
        positive=True,
        symbol="V_S",
        text="bridge voltage",
    )
    bridge_resistance = Parameter(
        unit="Ω",
        default=0.1,
        bounds=(0.0, 2.0),
        least=0.0,
        symbol="R_B",
        text="resistance of the bridge",
    )
    current_limit = Parameter(
        unit="A",
        default=5.0,
        bounds=(0.5, 10.0),
        positive=True,
        symbol="L",
        text="current limit",
    )

    followed = "sink with mass, free ambient, free ripple"
    structures = {  # noqa: RUF012
        "held sink": Structure(
            free=_PLATE,
            starts=(
                {"seebeck": 0.04, "conductance": 0.6, "heat_capacity": 18.0},
                {"seebeck": 0.12, "conductance": 0.5, "heat_capacity": 50.0},
            ),
            text="the paper's twin: a sink at constant temperature",
        ),
        "held sink, free ambient": _structure(_ROOM),
        "held sink, free ambient, switched drive": _structure(_ROOM, switched=True),
        "sink with mass": _structure(_SINK, (_MASS,), room=296.0, watched=True),
        "sink with mass, sensor lag": _structure(
            (*_SINK, "sensor_lag"), (_MASS, _LAG), room=296.0
        ),
        "sink with mass, free ambient": _structure(_BOTH, (_MASS,), watched=True),
        "sink with mass, switched drive": _structure(
            _SINK, (_MASS,), switched=True, room=296.0
        ),
        "sink with mass, free ambient, switched drive": _structure(
            _BOTH, (_MASS,), switched=True, watched=True
        ),
        "sink with mass, free ambient, free ripple": replace(
            _structure((*_BOTH, "drive_ripple"), (_MASS,)),
            fixed={**_RIG, "ambient": 294.0, "drive_ripple": 0.5},
        ),
        "sink with mass, free ambient, switched drive, sensor lag": _structure(
            (*_BOTH, "sensor_lag"), (_MASS, _LAG), switched=True
        ),
        "sink with mass, free ambient, switched drive, α(T)": _structure(
            (*_BOTH, "seebeck_slope"), (_MASS, _SLOPE), switched=True
        ),
        "sink with mass, free ambient, switched drive, sensor lag, α(T)": _structure(
            (*_BOTH, "sensor_lag", "seebeck_slope"),
            (_MASS, _LAG, _SLOPE),
            switched=True,
        ),
    }

    # Digital domain.
    loop = PidGains(
        proportional=38.57,
        integral=1.46877,
        derivative=6.66875,
        back_calculation=1.0,
        low=-COUNTS,
        high=COUNTS,
    )
    sensor = Sensor(noise=0.1, resolution=0.01, pause_period=180.0, pause_duration=0.9)

    def equations(self, parts: frozenset[str]) -> Equations:
        """The domains in the order of the power flow; temperatures in kelvin, heat drawn positive."""
        plate = self.plate
        sink = self.sink if _MASS in parts else self.ambient
        slope = self.seebeck_slope if _SLOPE in parts else 0
        seebeck = self.seebeck + slope * ((plate + sink) / 2 - SEEBECK_REFERENCE)

        # Electrical domain. Positive PWM heats the plate, positive current cools it.
        bridge = self.supply * self.pwm / COUNTS
        loop_resistance = self.resistance + self.bridge_resistance
        free_current = (-bridge - seebeck * (sink - plate)) / loop_resistance
        current = limited(free_current, -self.current_limit, self.current_limit)
        # An unsmoothed bridge lets the current swing about its mean, which adds Joule heat.
        swing = (
            magnitude(bridge) * (self.supply - magnitude(bridge)) / loop_resistance**2
        )
        ripple = self.resistance * self.drive_ripple * swing / 2

        # Thermal domain (equations 1 and 2).
        half_joule = current**2 * self.resistance / 2 + ripple
        conducted = self.conductance * (plate - sink)
        uneven = slope * (sink - plate) ** 2 * current / 4
        from_plate = seebeck * plate * current - half_joule + conducted + uneven
        from_sink = -seebeck * sink * current - half_joule - conducted - uneven
        rates = {plate: -from_plate / self.heat_capacity}
        start = {plate: self.temperature + KELVIN}

        # Fluid domain.
        if _MASS in parts:
            lost = self.sink_convection * (sink - self.ambient)
            rates[sink] = -(from_sink + lost) / self.sink_heat_capacity
            start[sink] = self.ambient

        measured = plate
        if _LAG in parts:
            measured = self.sensor_state
            rates[measured] = (plate - measured) / self.sensor_lag
            start[measured] = self.temperature + KELVIN
        return Equations(
            rates=rates,
            output=measured - KELVIN,
            start=start,
            quantities={
                "current": current,
                "voltage": seebeck * (sink - plate) + current * self.resistance,
                "from_plate": from_plate,
                "from_sink": from_sink,
                "ripple": 2 * ripple,
            },
        )
