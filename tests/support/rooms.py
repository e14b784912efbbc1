"""Heated rooms of one to three stores of heat, recorded for twelve days, and a plant file with one store."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from twinmatch.dynamics import Disturbance, Drive, Equations, Output, Parameter, Plant, State, Structure
from twinmatch.signals import Window
from twinmatch.twin import MatchRequest, TwinSettings, carry_out

PERIOD = 1800.0
_SIZE = 12 * 48


class Room(Plant, name="room"):
    """One store of heat, which loses it to the outside."""

    air = Output(unit="°C", noise=0.05, span=(0.0, 45.0))
    heating = Drive(unit="kW", limits=(0.0, 6.0), noise=0.1)
    outside = Disturbance(unit="°C", default=5.0)
    inner = State(unit="°C", span=(0.0, 45.0))
    gain = Parameter(unit="K/kW", default=5.0, bounds=(0.5, 60.0), positive=True)
    lag = Parameter(unit="s", default=60e3, bounds=(3e3, 1e6), positive=True)
    structures = {"one store": Structure(free=("gain", "lag"))}  # noqa: RUF012

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        """One energy balance."""
        return Equations(
            rates={self.inner: (self.outside + self.gain * self.heating - self.inner) / self.lag},
            output=self.inner,
            start={self.inner: self.air},
        )


SETTINGS = TwinSettings.of(Room, period=PERIOD, law=None)


def recorded_room(seed: int, stores: int) -> Window:
    """Twelve days of a room; the second store is a heated floor or heavy walls, the third the other one."""
    random = np.random.default_rng(seed)
    hours = np.arange(_SIZE) * PERIOD / 3600.0
    outside = 5.0 + 4.0 * np.sin(2 * np.pi * hours / 24.0) + np.cumsum(random.normal(0.0, 0.15, _SIZE))
    levels = random.uniform(0.0, 5.0, _SIZE // 6) * (random.uniform(size=_SIZE // 6) < 0.7)
    heating = np.repeat(levels, 6)
    store, loss = random.uniform(2.0, 6.0), random.uniform(0.1, 0.25)  # kWh/K, kW/K
    floor, to_floor = random.uniform(0.5, 2.0), random.uniform(0.2, 0.5)
    walls, to_walls = random.uniform(8.0, 25.0), random.uniform(0.3, 1.0)
    has_floor = stores == 3 or (stores == 2 and seed % 2 == 0)
    has_walls = stores == 3 or (stores == 2 and seed % 2 == 1)
    to_floor, to_walls = has_floor * to_floor, has_walls * to_walls
    rates = np.zeros((5, 5))  # air, floor, walls; heating, outside
    rates[0] = [-(loss + to_floor + to_walls), to_floor, to_walls, not has_floor, loss]
    rates[1] = [to_floor, -to_floor, 0.0, has_floor, 0.0]
    rates[2] = [to_walls, 0.0, -to_walls, 0.0, 0.0]
    rates[:3] /= np.array([[store], [floor], [walls]])
    moves = expm(rates * PERIOD / 3600.0)[:3]
    states, air = np.full(3, 20.0), np.empty(_SIZE)
    for k in range(_SIZE):
        air[k] = states[0]
        states = moves @ [*states, heating[k], outside[k]]
    air += random.normal(0.0, 0.05, _SIZE)
    return Window(air, air, heating, period=PERIOD, disturbances=outside[:, None])


def judged_room(seed: int, stores: int) -> str:
    """The reason of the match of such a room to the plant file with one store."""
    window = recorded_room(seed, stores)
    return carry_out(MatchRequest(window.last, 20.0, window, SETTINGS.start, None), SETTINGS).match.reason
