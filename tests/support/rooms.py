"""Heated rooms of one to three stores of heat, recorded for twelve days, and a plant file with one store."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.linalg import expm

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
            rates={
                self.inner: (self.outside + self.gain * self.heating - self.inner)
                / self.lag
            },
            output=self.inner,
            start={self.inner: self.air},
        )


SETTINGS = TwinSettings.of(Room, period=PERIOD, law=None)


def recorded_room(
    seed: int, stores: int, period: float = PERIOD, free: float = 0.0
) -> Window:
    """Twelve days of a room; the second store is a heated floor or heavy walls, the third the other one.

    `free`: heat that no file knows of, of people and the sun, kW: as much as on a bright day at noon.
    """
    random = np.random.default_rng(seed)
    rows_per_period = round(PERIOD / period)
    size = _SIZE * rows_per_period
    hours = np.arange(size) * period / 3600.0
    wander = np.cumsum(random.normal(0.0, 0.15 / rows_per_period**0.5, size))
    outside = 5.0 + 4.0 * np.sin(2 * np.pi * hours / 24.0) + wander
    levels = random.uniform(0.0, 5.0, _SIZE // 6) * (
        random.uniform(size=_SIZE // 6) < 0.7
    )
    heating = np.repeat(levels, 6 * rows_per_period)
    store = random.uniform(2.0, 6.0)  # kWh/K
    loss = random.uniform(0.1, 0.25)  # kW/K
    floor = random.uniform(0.5, 2.0)
    to_floor = random.uniform(0.2, 0.5)
    walls = random.uniform(8.0, 25.0)
    to_walls = random.uniform(0.3, 1.0)
    has_floor = stores == 3 or (stores == 2 and seed % 2 == 0)
    has_walls = stores == 3 or (stores == 2 and seed % 2 == 1)
    to_floor = has_floor * to_floor
    to_walls = has_walls * to_walls
    rates = np.zeros((6, 6))  # air, floor, walls; heating, outside, what else heats
    rates[0] = [
        -(loss + to_floor + to_walls),
        to_floor,
        to_walls,
        not has_floor,
        loss,
        1.0,
    ]
    rates[1] = [to_floor, -to_floor, 0.0, has_floor, 0.0, 0.0]
    rates[2] = [to_walls, 0.0, -to_walls, 0.0, 0.0, 0.0]
    rates[:3] /= np.array([[store], [floor], [walls]])
    moves = expm(rates * period / 3600.0)[:3]
    states = np.full(3, 20.0)
    air = np.empty(size)
    noise = random.normal(0.0, 0.05, size)
    bright = np.repeat(random.uniform(0.0, 1.0, 12), size // 12)  # of each day
    at_home = np.repeat(random.uniform(size=2 * 12) < 0.6, size // 24)  # of each half
    sun = bright * np.maximum(np.sin(2 * np.pi * (hours - 6.0) / 24.0), 0.0)
    free_heat = free * (sun + 0.3 * at_home)
    for k in range(size):
        air[k] = states[0]
        states = moves @ [*states, heating[k], outside[k], free_heat[k]]
    air += noise
    return Window(air, air, heating, period=period, disturbances=outside[:, None])


def judged_room(seed: int, stores: int) -> str:
    """The reason of the match of such a room to the plant file with one store."""
    window = recorded_room(seed, stores)
    return carry_out(
        MatchRequest(window.last, 20.0, window, SETTINGS.start, None), SETTINGS
    ).match.reason


_STATES: Final = {"floor": "slab", "walls": "shell"}
"""The temperature of each store."""


def _air_beside(*stores: str) -> Structure:
    """Air with these stores, each with a capacity and a conductance to the air."""
    free = ["store", "loss", "free"]
    for store in stores:
        free += [store, f"to_{store}"]
    states = [_STATES[store] for store in stores]
    return Structure(
        free=tuple(free), parts=frozenset(stores), free_starts=tuple(states)
    )


class StoredRoom(Plant, name="stored_room"):
    """Air, and beside it a heated floor, walls or both; what else heats the room is constant."""

    parts = ("floor", "walls")
    time_constant = 10000.0  # of the air, s
    air = Output(unit="°C", noise=0.05, span=(0.0, 45.0))
    heating = Drive(unit="kW", limits=(0.0, 6.0), noise=0.1)
    outside = Disturbance(unit="°C", default=5.0)
    inner = State(unit="°C", span=(0.0, 45.0))
    slab = State(unit="°C", span=(0.0, 60.0), start_bounds=(0.0, 60.0))
    shell = State(unit="°C", span=(0.0, 45.0), start_bounds=(0.0, 45.0))
    store = Parameter(unit="kWh/K", default=3.0, bounds=(0.1, 50.0), positive=True)
    loss = Parameter(unit="kW/K", default=0.2, bounds=(0.01, 2.0), positive=True)
    free = Parameter(unit="kW", default=0.0, bounds=(-2.0, 2.0))
    floor = Parameter(unit="kWh/K", default=1.0, bounds=(0.05, 20.0), positive=True)
    to_floor = Parameter(unit="kW/K", default=0.3, bounds=(0.02, 5.0), positive=True)
    walls = Parameter(unit="kWh/K", default=15.0, bounds=(1.0, 200.0), positive=True)
    to_walls = Parameter(unit="kW/K", default=0.6, bounds=(0.02, 10.0), positive=True)
    structures = {  # noqa: RUF012
        "air": _air_beside(),
        "floor": _air_beside("floor"),
        "walls": _air_beside("walls"),
        "floor and walls": _air_beside("floor", "walls"),
    }

    def equations(self, parts: frozenset[str]) -> Equations:
        """Energy balances; a heated floor gets what heats."""
        lost = self.loss * (self.inner - self.outside) - self.free
        to_floor = self.to_floor * (self.inner - self.slab)
        to_walls = self.to_walls * (self.inner - self.shell)
        rates = {}
        if "floor" in parts:
            lost = lost + to_floor
            rates[self.slab] = (to_floor + self.heating) / self.floor / 3600.0
        else:
            lost = lost - self.heating
        if "walls" in parts:
            lost = lost + to_walls
            rates[self.shell] = to_walls / self.walls / 3600.0
        rates[self.inner] = -lost / self.store / 3600.0
        return Equations(
            rates=rates, output=self.inner, start=dict.fromkeys(rates, self.air)
        )
