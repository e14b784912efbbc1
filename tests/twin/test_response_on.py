"""The twin as it is shown beside a whole window: hidden states begin where the measurements say."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.faulty_incubator import run, some_incubator
from tests.support.plants import Motor
from twinmatch.dynamics import begin, simulate_driven, simulate_window
from twinmatch.plants import Incubator
from twinmatch.signals import Window
from twinmatch.twin import response_on, window_fit

HEAVY = Incubator.model("box with mass").parameters(**Incubator.typical)


def recorded(bed: float, box: float, noise: float = 0.0, size: int = 400) -> Window:
    """A driven run whose bed and walls begin so much warmer than the air."""
    states = begin(HEAVY, 23.0)
    states[HEAVY.model.states.index("bed")] += bed
    states[HEAVY.model.states.index("box")] += box
    heater = np.where(np.arange(size) % 150 < 20, 1.0, 0.0)
    room = np.full((size, 1), 21.0)
    clean = simulate_driven(
        HEAVY, heater, states=states, period=3.0, disturbances=room
    ).output
    output = clean + noise * np.random.default_rng(1).standard_normal(size)
    return Window(np.zeros(size), output, heater, period=3.0, disturbances=room)


@settings(deadline=None, max_examples=15)
@given(bed=st.floats(0.0, 40.0), box=st.floats(-1.0, 4.0))
def test_the_true_twin_lies_on_the_plant_wherever_it_began(
    bed: float, box: float
) -> None:
    """Parameters are the plant's, so only the initial states can be off; they are not, to a hundredth."""
    window = recorded(bed, box)
    shown = response_on(HEAVY, window, None)
    np.testing.assert_allclose(shown.output, window.output[2:], atol=0.01)


def test_from_the_plant_files_states_it_would_be_off_for_the_whole_window() -> None:
    window = recorded(20.0, 3.0, noise=0.03)
    filed = simulate_window(HEAVY, window, law=None)
    assert np.sqrt(np.mean((filed.output - window.output[2:]) ** 2)) > 1.0
    of_output, of_input = window_fit(HEAVY, window, None)
    assert of_output > 0.97
    assert np.isnan(of_input)


def test_a_wrong_twin_stays_wrong() -> None:
    """Two initial states cannot make up for a heater that is half as strong again."""
    samples = run(some_incubator(3), 3, 700)
    window = Window.from_samples(samples, 3.0)
    right = some_incubator(3)
    assert window_fit(right, window, None)[0] > 0.97
    assert window_fit(right.replace(power=1.5 * right["power"]), window, None)[0] < 0.8


def test_a_closed_loop_twin_begins_as_ever() -> None:
    motor = Motor.model().parameters()
    steps = np.repeat([20.0, 60.0, 40.0], 80)
    window = Window(
        steps,
        steps + 0.1,
        np.full(240, 3.0),
        period=0.05,
        disturbances=np.zeros((240, 1)),
    )
    shown = response_on(motor, window, Motor.loop)
    filed = simulate_window(motor, window)
    np.testing.assert_array_equal(shown.output, filed.output)
    np.testing.assert_array_equal(shown.input, filed.input)


@pytest.mark.parametrize("size", [3, 4])
def test_too_short_a_window_takes_the_plant_files_states(size: int) -> None:
    window = recorded(5.0, 1.0, size=size)
    np.testing.assert_array_equal(
        response_on(HEAVY, window, None).output,
        simulate_window(HEAVY, window, law=None).output,
    )
