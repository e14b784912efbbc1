"""Windows of plants whose truth is known."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from twinmatch.dynamics import Parameters, Sensor, begin, simulate_closed_loop
from twinmatch.signals import Window

Recorder = Callable[..., Window]


@pytest.fixture(scope="session")
def record() -> Recorder:
    """`record(rig, levels=(30, 55, 42), seed=None)`: a loop settled at the first level, then steps."""

    def run(
        rig: Parameters,
        levels: Sequence[float] = (30.0, 55.0, 42.0),
        seed: int | None = None,
        noise: float = 0.1,
        samples: int = 100,
    ) -> Window:
        reference = np.concatenate([np.full(60, levels[0]), np.repeat(levels, samples)])
        sensor = (
            None
            if seed is None
            else Sensor(noise=noise).realise(reference.size, 1.0, seed)
        )
        response = simulate_closed_loop(
            rig, reference, states=begin(rig, levels[0]), sensor=sensor
        )
        whole = Window(reference, response.output, response.input, first=1000)
        return whole.part(1060, whole.last)

    return run
