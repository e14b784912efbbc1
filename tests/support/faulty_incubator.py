"""Simulated incubators whose lid is opened: how soon it is reported, and what of those that are left alone.

    python -m tests.support.faulty_incubator 40

An open lid lets the air of the box mix with that of the room: a conductance from air to room, which the
plant that the monitor follows does not have.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass

import numpy as np

from twinmatch.dynamics import Parameters, advance, begin, read
from twinmatch.health import Alarm, Fault, HealthSettings, Monitor
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
        **free, sensor_lag=random.uniform(1.0, 5.0), wall_conductance=random.uniform(0.3, 2.0)
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
    room, heating, since = random.uniform(19.0, 23.0), True, 0
    samples = []
    for k in range(size):
        seen = read(plant, states) + random.normal(0.0, 0.02, 2)
        y = float(np.mean(np.round(seen / RESOLUTION) * RESOLUTION))
        if heating and y > limits[1]:
            heating = False
        elif not heating and y < limits[0]:
            heating, since = True, 0
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


def _opened(seed: int, minutes: float) -> tuple[Lid, tuple[Alarm, ...]]:
    random = np.random.default_rng(seed + 100)
    opened = int(random.integers(250, 500))
    lid = Lid(opened, opened + round(60 * minutes / PERIOD), random.uniform(3.0, 10.0))
    return lid, watch(run(some_incubator(seed), seed, 900, lid))


def _measure(runs: int, minutes: float) -> str:
    told, early, other = [], 0, Counter[str]()
    closed: list[float] = []
    for seed in range(runs):
        lid, alarms = _opened(seed, minutes)
        early += any(a.flagged < lid.opened for a in alarms)
        found = [a for a in alarms if a.fault is Fault.LOSSES_CHANGED and a.flagged >= lid.opened]
        other.update(a.fault.value for a in alarms if a not in found[:1])
        if not found:
            continue
        told.append((found[0].flagged - lid.opened) * PERIOD)
        if found[0].last is not None:
            closed.append((found[0].last + 1 - lid.closed) * PERIOD)
    delays = f"{np.median(told):.0f}, {max(told):.0f} s" if told else "–"
    ends = f"{np.median(closed):.0f}, {max(closed):.0f} s" if closed else "–"
    rest = ", ".join(f"{n} {name}" for name, n in other.most_common()) or "nothing"
    return (
        f"open for {minutes:g} min: {len(told)} of {runs} reported, {delays}; "
        f"over after {ends}; {early} before; else {rest}"
    )


def main() -> None:
    """Print the figures of docs/incubator.md."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 40
    for minutes in (1.0, 3.0):
        print(_measure(runs, minutes), flush=True)
    healthy = (watch(run(some_incubator(seed + 500), seed, 1200)) for seed in range(runs))
    alarms = Counter(a.fault.value for found in healthy for a in found)
    print(f"{runs} healthy hours: {dict(alarms) or 'no alarm'}")


if __name__ == "__main__":
    main()
