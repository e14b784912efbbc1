"""An incubator: a polystyrene box with heat bed and fan, as the INTO-CPS Association built and published it.

The structures with two and four parameters are those of its authors: one lumped heat capacity, or separate
ones for heat bed and air. In these, heat leaving the air goes directly to the room. The others add a heat
capacity for the walls and contents of the box, which absorb heat for hours before much of it reaches the
room.

At constant room temperature, readings determine three parameters of air and bed, not four: a larger heat
capacity of the air can be offset by a smaller one of the bed. So the heat capacity of the air is fixed at the
published value, except in the authors' structure.

Temperatures are in °C; all equations are linear in them, so only differences count.

Source: github.com/INTO-CPS-Association/example_digital-twin_incubator.
"""

from __future__ import annotations

from typing import Final

from twinmatch.dynamics import (
    Disturbance,
    Drive,
    Equations,
    Output,
    Parameter,
    Plant,
    State,
    Structure,
)

_BED = "heat bed"
_BOX = "box with mass"
_LAG = "sensor lag"
_AIR: Final = ("bed_heat_capacity", "bed_conductance", "box_conductance")
_HEAVY: Final = (*_AIR, "box_heat_capacity")


class Incubator(Plant, name="incubator"):
    """A box with air heated by a bed that is on or off, and stirred by a fan."""

    title = "Incubator"
    surroundings = "lid, fan and room"
    typical = {  # noqa: RUF012
        "bed_heat_capacity": 240.0,
        "bed_conductance": 2.0,
        "box_conductance": 0.9,
        "box_heat_capacity": 25e3,
    }
    time_constant = 100.0  # air 39 s, bed 540 s
    parts = (_BED, _BOX, _LAG)

    temperature = Output(
        unit="°C",
        noise=0.1,
        span=(-20.0, 90.0),
        set_points=(22.0, 45.0),
        safe=(0.0, 60.0),
        absolute=273.15,
        text="temperature in the box",
        symbol="T",
        sensor="sensors in the box",
    )
    # The mean of two sensors with steps of 0.06 °C, in air that the fan does not mix instantly.
    heater = Drive(
        unit="",
        limits=(0.0, 1.0),
        noise=0.02,
        symbol="u",
        text="heat bed: off (0), on (1) or in between",
    )
    room = Disturbance(
        unit="°C", default=21.0, symbol="T_∞", text="temperature of the room"
    )

    air = State(unit="°C", span=(-20.0, 90.0), text="air in the box", symbol="T_A")
    bed = State(
        unit="°C",
        span=(-20.0, 250.0),
        start_bounds=(0.0, 150.0),
        text="heat bed",
        symbol="T_H",
    )
    box = State(
        unit="°C",
        span=(-20.0, 90.0),
        scale=5.0,
        text="walls and contents of the box",
        symbol="T_B",
    )
    seen = State(
        unit="°C", span=(-20.0, 90.0), text="temperature at the sensors", symbol="T_S"
    )

    power = Parameter(
        unit="W",
        default=127.1,
        bounds=(10.0, 1000.0),
        positive=True,
        symbol="P",
        text="power of the heat bed",
    )
    air_heat_capacity = Parameter(
        unit="J/K",
        default=177.6,
        bounds=(5.0, 2000.0),
        positive=True,
        symbol="C_A",
        text="heat capacity of the air and what follows it quickly",
    )
    bed_heat_capacity = Parameter(
        unit="J/K",
        default=239.6,
        bounds=(20.0, 5000.0),
        positive=True,
        symbol="C_H",
        text="heat capacity of the heat bed",
    )
    box_heat_capacity = Parameter(
        unit="J/K",
        default=1e4,
        bounds=(500.0, 2e5),
        positive=True,
        symbol="C_B",
        text="heat capacity of walls and contents",
    )
    bed_conductance = Parameter(
        unit="W/K",
        default=2.32,
        bounds=(0.05, 20.0),
        positive=True,
        symbol="G_H",
        text="conductance from the heat bed to the air",
    )
    box_conductance = Parameter(
        unit="W/K",
        default=0.773,
        bounds=(0.01, 20.0),
        positive=True,
        role="losses",
        symbol="G_B",
        text="conductance from the air to the box",
    )
    wall_conductance = Parameter(
        unit="W/K",
        default=1.0,
        bounds=(0.01, 20.0),
        positive=True,
        symbol="G_W",
        text="conductance from the box to the room",
    )
    sensor_lag = Parameter(
        unit="s",
        default=5.0,
        bounds=(0.5, 120.0),
        positive=True,
        symbol="τ",
        text="lag of the sensors",
    )

    followed = "box with mass"
    structures = {  # noqa: RUF012
        "air and bed": Structure(
            free=_AIR,
            parts=frozenset({_BED}),
            free_starts=("bed",),
            text="the authors' second twin, the air's heat capacity known",
        ),
        "two parameters": Structure(
            free=("air_heat_capacity", "box_conductance"),
            fixed={"air_heat_capacity": 500.0},
            watched=False,
            text="the authors' first twin: one lumped heat capacity",
        ),
        "four parameters": Structure(
            free=("air_heat_capacity", *_AIR),
            parts=frozenset({_BED}),
            free_starts=("bed",),
            watched=False,
            text="the authors' second twin",
        ),
        "box with mass": Structure(
            free=_HEAVY,
            parts=frozenset({_BED, _BOX}),
            free_starts=("bed", "box"),
            text="walls and contents that warm for hours",
        ),
        "box with mass, free walls": Structure(
            free=(*_HEAVY, "wall_conductance"),
            parts=frozenset({_BED, _BOX}),
            free_starts=("bed", "box"),
            watched=False,
        ),
        "box with mass, sensor lag": Structure(
            free=(*_HEAVY, "sensor_lag"),
            parts=frozenset({_BED, _BOX, _LAG}),
            free_starts=("air", "bed", "box"),
        ),
    }

    def equations(self, parts: frozenset[str]) -> Equations:
        """Heat goes from the bed to the air, from the air to the box, from the box to the room."""
        power = self.power * self.heater
        rates = {}
        start = {self.air: self.temperature}
        to_air = power
        if _BED in parts:
            to_air = self.bed_conductance * (self.bed - self.air)
            rates[self.bed] = (power - to_air) / self.bed_heat_capacity
            start[self.bed] = self.temperature

        outside = self.box if _BOX in parts else self.room
        lost = self.box_conductance * (self.air - outside)
        rates[self.air] = (to_air - lost) / self.air_heat_capacity
        if _BOX in parts:
            onwards = self.wall_conductance * (self.box - self.room)
            rates[self.box] = (lost - onwards) / self.box_heat_capacity
            start[self.box] = self.temperature

        measured = self.air
        if _LAG in parts:
            measured = self.seen
            rates[measured] = (self.air - measured) / self.sensor_lag
            start[measured] = self.temperature
        return Equations(
            rates=rates,
            output=measured,
            start=start,
            quantities={"given": to_air, "lost": lost},
        )
