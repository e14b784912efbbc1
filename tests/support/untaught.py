"""A plant whose file declares no typical twin, as those of `new-plant`: it is learned from the samples."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import replace
from functools import lru_cache

import numpy as np

from tests.support.places import temporary_folder
from tests.support.plant_files import plant_file
from twinmatch.dynamics import begin, simulate_driven
from twinmatch.offline.judging import Judgement, judge_samples
from twinmatch.plants import find_plant
from twinmatch.sessions import samples_of
from twinmatch.signals import Sample, Window
from twinmatch.twin import TwinSettings

SPIKE = 450
"""Index of a reading 40 °C too high: within the sensor's span, and far behind the first nominal twin."""
TAUGHT = 175
"""Sample of the first verdict with a nominal twin."""


@lru_cache(maxsize=1)
def settings() -> TwinSettings:
    # The plant's code is made from its file when it is first used.
    plant = find_plant(str(plant_file(temporary_folder(), "untaught")))
    assert not plant.typical
    return TwinSettings.of(plant, law=None)


@lru_cache(maxsize=1)
def clean() -> tuple[Sample, ...]:
    """Steps of the heater; the time constant is 50 s, and readings have the noise of the plant file."""
    true = settings().plant.model().parameters(capacity=50.0)
    u = np.repeat([20.0, 60.0, 30.0, 80.0, 10.0, 50.0, 25.0, 70.0], 80)
    run = simulate_driven(true, u, states=begin(true, 30.0))
    y = run.output + np.random.default_rng(1).normal(0.0, 0.1, u.size)
    rooms = np.full((u.size, 1), 20.0)
    return tuple(
        samples_of(Window(np.zeros(u.size), y, u, disturbances=rooms, period=1.0))
    )


def spiked(lost: Container[int] = ()) -> list[Sample]:
    """The same with one spike, and without the lost samples."""
    return [
        replace(s, outputs=(s.output + 40.0,)) if s.index == SPIKE else s
        for s in clean()
        if s.index not in lost
    ]


@lru_cache(maxsize=1)
def judged() -> Judgement:
    return judge_samples("spiked", spiked(), settings())
