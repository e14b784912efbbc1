"""Recordings of a simulated box whose loop nobody tells: a step test, and a switch with dwell times."""

from __future__ import annotations

import numpy as np

from tests.support.plants import Box
from twinmatch.dynamics import advance, begin, read, simulate_driven
from twinmatch.signals import FloatArray, Sample

PERIOD = 3.0
TRUTH = Box.model().parameters(
    air_capacity=650.0, bed_conductance=1.2, box_conductance=0.9
)
_LEVELS = (0.0, 0.4, 0.15, 0.6, 0.3, 0.1, 0.5, 0.2)


def step_test(size: int, seed: int) -> list[Sample]:
    """The heater stands still at eight levels, one after the other."""
    rng = np.random.default_rng(seed)
    room = _room(size, rng)
    noise = Box.output.noise * rng.standard_normal(size)
    heater = np.repeat(_LEVELS, -(-size // len(_LEVELS)))[:size]
    run = simulate_driven(
        TRUTH, heater, states=_cold(room), period=PERIOD, disturbances=room[:, None]
    )
    return [
        Sample(k, round(k * PERIOD * 1e9), 0.0, float(y), float(u), (float(r),))
        for k, (y, u, r) in enumerate(
            zip(run.output + noise, heater, room, strict=True)
        )
    ]


def switched(size: int, seed: int) -> list[Sample]:
    """A switch keeps 35 °C: below it heats for 20 s, and then waits for 30 s at least."""
    rng = np.random.default_rng(seed)
    room = _room(size, rng)
    noise = Box.output.noise * rng.standard_normal(size)
    states = _cold(room)
    samples = []
    on = False
    since = np.inf
    for k in range(size):
        row = room[k : k + 1]
        y = read(TRUTH, states, row) + float(noise[k])
        if (on and since >= 20.0) or (not on and since >= 30.0 and y < 35.0):
            on = not on
            since = 0.0
        samples.append(
            Sample(k, round(k * PERIOD * 1e9), 35.0, y, float(on), (float(room[k]),))
        )
        states = advance(TRUTH, states, float(on), PERIOD, row)
        since = since + PERIOD
    return samples


def _room(size: int, rng: np.random.Generator) -> FloatArray:
    """A room that warms and cools slowly, °C."""
    return np.asarray(21.0 + np.cumsum(rng.normal(0.0, 0.01, size)), dtype=np.float64)


def _cold(room: FloatArray) -> FloatArray:
    return begin(TRUTH, float(room[0]), disturbances=room[:1])
