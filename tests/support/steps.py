"""Recorded steps of a simulated rig."""

from __future__ import annotations

import numpy as np

from tests.support.rig import GAINS, rig, run
from twinmatch.dynamics import Controller, advance, begin, read
from twinmatch.sessions import samples_of
from twinmatch.signals import Sample


def quarter_of_an_hour() -> list[Sample]:
    """920 samples: a set-point step that shows nothing, then two that do."""
    reference = np.repeat([25.0, 40.0, 60.0, 45.0], [60, 300, 300, 260])
    window = run(
        rig(seebeck=0.08, conductance=0.4, heat_capacity=30.0), reference, seed=7
    )
    return samples_of(window)


def drive_lost(at: int = 640) -> list[Sample]:
    """Twelve minutes of 720 samples; from one of them on the drive does nothing."""
    plant = rig(seebeck=0.06, conductance=0.6, heat_capacity=28.0)
    pid = Controller(GAINS)
    samples = []
    states = begin(plant, 22.85)
    for k, error in enumerate(np.random.default_rng(5).normal(0.0, 0.1, 720)):
        r = (40.0, 70.0, 45.0, 80.0)[k // 200]
        y = read(plant, states) + float(error)
        u = pid.step(r, y)[0]
        samples.append(Sample(k, k * 10**9, r, y, u))
        states = advance(plant, states, 0.0 if k >= at else u, GAINS.period)
    return samples
