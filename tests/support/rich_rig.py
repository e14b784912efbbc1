"""A rig of the richest structure that is watched, and how far plants are from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.support.rig import GAINS, rig, run
from twinmatch.comparing import LoopConditions, plant_gap, spans_of
from twinmatch.dynamics import Parameters
from twinmatch.plants import Peltier
from twinmatch.signals import Window

RIG = rig(
    "sink with mass, free ambient, switched drive",
    seebeck=0.06,
    conductance=0.7,
    heat_capacity=30.0,
    ambient=296.0,
    sink_heat_capacity=350.0,
    sink_convection=4.0,
)


def recorded(parameters: Parameters, seed: int, first: int = 0) -> Window:
    """A thousand samples of a rig on its way through five set-points, seen through its camera."""
    window = run(
        parameters,
        np.repeat([30.0, 50.0, 70.0, 40.0, 60.0], 200),
        start=25.0,
        seed=seed,
    )
    return replace(window, first=first)


def apart(first: Parameters, second: Parameters) -> float:
    """The ν-gap between two plants at 30, 50 and 70 °C."""
    return plant_gap(
        first, second, (30.0, 50.0, 70.0), LoopConditions(GAINS, spans_of(Peltier))
    )
