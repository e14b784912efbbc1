"""The Peltier rig as tests run it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.dynamics import Parameters, PidGains, Sensor, begin, simulate_closed_loop
from twinmatch.plants import Peltier
from twinmatch.signals import Window

assert Peltier.loop is not None
assert Peltier.sensor is not None
GAINS: PidGains = Peltier.loop
SENSOR: Sensor = Peltier.sensor


def rig(structure: str | None = None, **values: float) -> Parameters:
    """Parameters of the rig; those not named are the plant's."""
    return Peltier.model(structure).parameters(**values)


def run(
    parameters: Parameters,
    reference: ArrayLike,
    *,
    start: float = 22.85,
    seed: int | None = None,
) -> Window:
    """The rig in its loop, from rest at `start`, °C; seen through its camera if there is a seed."""
    levels = np.array(reference, dtype=np.float64)
    realised = None if seed is None else SENSOR.realise(levels.size, GAINS.period, seed)
    loop_run = simulate_closed_loop(
        parameters, levels, states=begin(parameters, start), law=GAINS, sensor=realised
    )
    return Window(levels, loop_run.output, loop_run.input, period=GAINS.period)
