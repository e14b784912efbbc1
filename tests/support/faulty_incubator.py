"""Simulated incubators whose lid is opened.

An open lid lets the air of the box mix with that of the room: a conductance from air to room, which the
plant that the monitor follows does not have.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twinmatch.dynamics import Parameters, advance, begin, read
from twinmatch.health import Alarm, HealthSettings, Monitor
from twinmatch.plants import Incubator
from twinmatch.signals import Sample

PERIOD = 3.0
"""Seconds."""
RESOLUTION = 0.0625
"""Step of each of the two sensors, °C."""


@dataclass(frozen=True)
class Lid:
    """When a lid is open, in samples, and what it then lets through, W/K."""

    opened: int
    closed: int
    conductance: float


def some_incubator(seed: int) -> Parameters:
    """One of its kind: every parameter within ±25 % of what is typical, walls that pass on some heat."""
    random = np.random.default_rng(seed)
    model = Incubator.model("box with mass, sensor lag")
    free = {n: v * random.uniform(0.75, 1.25) for n, v in Incubator.typical.items()}
    return model.parameters(
        **free,
        sensor_lag=random.uniform(1.0, 5.0),
        wall_conductance=random.uniform(0.3, 2.0),
    )


def run(
    plant: Parameters,
    seed: int,
    size: int,
    lid: Lid | None = None,
    *,
    limits: tuple[float, float] = (30.0, 35.0),
    warming: tuple[int, int, float] = (0, 0, 0.0),
) -> list[Sample]:
    """Samples of one run: two levels, 20 s on and 30 s off between them, from a bed that is warm already.

    `warming`: samples from and to which the room warms evenly, and by how much.
    """
    random = np.random.default_rng(seed)
    states = begin(plant, random.uniform(21.5, 25.0))
    states[plant.model.states.index("bed")] += random.uniform(0.0, 8.0)
    air = plant.model.states.index("air")
    room = random.uniform(19.0, 23.0)
    heating = True
    since = 0
    samples = []
    for k in range(size):
        both_sensors = read(plant, states) + random.normal(0.0, 0.02, 2)
        y = float(np.mean(np.round(both_sensors / RESOLUTION) * RESOLUTION))
        if heating and y > limits[1]:
            heating = False
        elif not heating and y < limits[0]:
            heating = True
            since = 0
        u = float(heating and since % 17 < 7)
        since += 1
        room += random.normal(0.0, 0.01)
        if warming[0] <= k < warming[1]:
            room += warming[2] / (warming[1] - warming[0])
        measured = round(room / RESOLUTION) * RESOLUTION
        samples.append(Sample(k, k, y, y, u, (measured,)))
        share = 0.0
        if lid is not None and lid.opened <= k < lid.closed:
            share = 1.0 - np.exp(-lid.conductance * PERIOD / plant["air_heat_capacity"])
        states = advance(plant, states, u, PERIOD, np.array([room]))
        states[air] += share * (room - states[air])
    return samples


def watch(samples: list[Sample]) -> tuple[Alarm, ...]:
    """The alarms of a monitor that knows of the plant what its file says."""
    monitor = Monitor(HealthSettings.of(Incubator, PERIOD))
    for sample in samples:
        monitor.push(sample)
    return monitor.alarms
