"""The closed loop on a window, from its measured start."""

from __future__ import annotations

import numpy as np
import pytest

from twinmatch.plant import (
    Camera,
    PidGains,
    PlantError,
    RigParameters,
    simulate_closed_loop,
    simulate_window,
)
from twinmatch.signals import Window

RIG = RigParameters(seebeck=0.06, conductance=0.6, heat_capacity=28.0)
REFERENCE = np.repeat([40.0, 70.0], 60)


def window() -> Window:
    run = simulate_closed_loop(RIG, REFERENCE, plate=296.0)
    return Window(REFERENCE, run.output, run.input)


def test_the_twin_takes_up_a_run_where_it_stands() -> None:
    whole = window()
    for first in (0, 30, 61):
        part = whole.part(first, whole.last)
        taken_up = simulate_window(RIG, part, gains=PidGains())
        # Celsius and back cost a rounding, and the controller's state is recovered from two samples.
        np.testing.assert_allclose(taken_up.output, part.output[2:], atol=1e-9)
        np.testing.assert_allclose(taken_up.input, part.input[2:], atol=1e-6)


def test_a_camera_is_realised_with_its_seed() -> None:
    runs = [simulate_window(RIG, window(), camera=Camera(), seed=seed).output for seed in (1, 1, 2)]
    np.testing.assert_array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0], runs[2])


def test_too_short_a_window_is_refused() -> None:
    with pytest.raises(PlantError, match="2 samples"):
        simulate_window(RIG, window().part(0, 1))
