"""A simulated rig to record: richer than the twin, measured by its camera, on a staircase of set-points."""

from __future__ import annotations

import numpy as np

from twinmatch.dynamics import begin, simulate_closed_loop
from twinmatch.plants import Peltier
from twinmatch.sessions import samples_of
from twinmatch.signals import Sample, Window

__all__ = ["REGIME", "SINK", "recorded"]

SINK = Peltier.model("sink with mass").parameters(
    seebeck=0.06,
    conductance=0.5,
    heat_capacity=27.0,
    sink_heat_capacity=280.0,
    sink_convection=4.0,
)
"""A sink that warms up, which the twin's three parameters do not describe."""

REGIME = 300
"""Samples between two steps of the set-point."""


def recorded(samples: int, seed: int = 5) -> list[Sample]:
    """So many samples at 1 Hz; every five minutes another set-point between 30 and 90 °C."""
    rng = np.random.default_rng(seed)
    count = -(-samples // REGIME)
    levels = np.resize(
        [30.0, 60.0, 45.0, 80.0, 50.0, 90.0, 35.0, 70.0], count
    ) + rng.integers(-3, 4, count)
    reference = np.repeat(levels, REGIME)[:samples].astype(np.float64)
    camera = Peltier.sensor.realise(samples, 1.0, seed)
    run = simulate_closed_loop(
        SINK, reference, states=begin(SINK, 22.85), sensor=camera
    )
    return list(samples_of(Window(reference, run.output, run.input)))
