"""The twin beside the plant."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.support.box_runs import PERIOD, TRUTH, step_test
from tests.support.plants import Box
from twinmatch.dynamics import begin, simulate_closed_loop, simulate_driven
from twinmatch.plants import Peltier
from twinmatch.sessions import samples_of
from twinmatch.signals import Window
from twinmatch.twin import Mirror, nrmse, window_fit
from twinmatch.twin.mirror import residuals
from twinmatch.twin.settings import TwinSettings

HELD = Peltier.model().parameters
RIG = HELD(seebeck=0.06, conductance=0.6, heat_capacity=28.0)
REFERENCE = np.repeat([40.0, 70.0, 30.0], 120)


def plant_run() -> Window:
    run = simulate_closed_loop(RIG, REFERENCE, states=begin(RIG, 22.85))
    return Window(REFERENCE, run.output, run.input)


def test_with_the_plants_own_parameters_nothing_is_left() -> None:
    mirror = Mirror(RIG)
    states = [mirror.push(s) for s in samples_of(plant_run())]
    # Celsius and back cost a rounding each tick; the loop forgets them.
    assert max(abs(s.closed_residual_y[0]) for s in states) < 1e-9
    assert max(abs(s.closed_residual_u[0]) for s in states) < 1e-6
    assert max(abs(s.driven_residual_y[0]) for s in states) < 1e-9


def test_the_driven_twin_is_the_simulation_of_the_recorded_control() -> None:
    window = plant_run()
    parameters = HELD(seebeck=0.05, conductance=0.5, heat_capacity=25.0)
    mirror = Mirror(parameters)
    driven = [mirror.push(s).driven_output[0] for s in samples_of(window)]
    simulated = simulate_driven(
        parameters, window.input, states=begin(parameters, float(window.output[0]))
    )
    np.testing.assert_array_equal(driven, simulated.output)


def test_new_parameters_take_over_without_a_jump() -> None:
    window = plant_run()
    mirror = Mirror(HELD(seebeck=0.05, conductance=0.5, heat_capacity=25.0))
    before = after = None
    for sample in samples_of(window):
        if sample.index == 200:
            mirror.parameters = RIG
        state = mirror.push(sample)
        if sample.index == 199:
            before = state
        if sample.index == 200:
            after = state
    assert before is not None
    assert after is not None
    assert abs(after.closed_output[0] - before.closed_output[0]) < 2.0


def test_a_gap_starts_both_twins_from_the_measured_temperature() -> None:
    samples = samples_of(plant_run())
    mirror = Mirror(HELD(seebeck=0.02, conductance=1.0, heat_capacity=60.0))
    for sample in samples[:100]:
        mirror.push(sample)
    state = mirror.push(samples[150])
    assert state.closed_residual_y[0] == 0.0
    assert state.driven_residual_y[0] == 0.0
    assert state.closed_rms_y[0] == 0.0


def test_its_own_plant_leaves_no_residuals_in_a_window() -> None:
    window = plant_run()
    law = TwinSettings().law
    exact = residuals(RIG, window, law)
    assert exact.y < 1e-9
    assert exact.u < 1e-6
    assert residuals(HELD(), window, law).y > 1.0
    assert np.isnan(residuals(RIG, window.part(0, 2), law).y)
    assert window_fit(RIG, window, law) == pytest.approx((1.0, 1.0), abs=1e-6)


def test_nrmse_is_one_for_equal_and_zero_for_the_mean() -> None:
    measured = np.array([1.0, 2.0, 3.0])
    assert nrmse(measured, measured) == 1.0
    assert nrmse(measured, np.full(3, 2.0)) == 0.0
    assert np.isnan(nrmse(np.ones(3), np.ones(3)))


def test_states_that_another_structure_has_too_stay_as_they_are() -> None:
    window = plant_run()
    mirror = Mirror(RIG)
    for sample in samples_of(window)[:150]:
        before = mirror.push(sample)
    with_mass = Peltier.model("sink with mass").parameters(
        **{n: RIG[n] for n in ("seebeck", "conductance")}
    )
    mirror.parameters = with_mass
    after = mirror.push(samples_of(window)[150])
    assert set(before.closed_states) == {"plate"}
    assert set(after.closed_states) == {"plate", "sink"}
    assert after.closed_states["plate"] == pytest.approx(
        after.closed_output[0] + 273.15
    )
    assert abs(after.closed_output[0] - before.closed_output[0]) < 2.0


def test_a_state_the_structure_before_did_not_have_is_found_from_the_newest_samples() -> (
    None
):
    """A twin of the right structure that takes over late is where one that ran all along is.

    The sink is not measured; after ten minutes of heating it is over 3 K away from the surroundings, where
    a beginning puts it. What an observer leaves of that in 300 s is less than a tenth.
    """
    plant = Peltier.model("sink with mass").parameters()
    reference = np.repeat([40.0, 90.0, 80.0], 250)
    run = simulate_closed_loop(plant, reference, states=begin(plant, 22.85))
    samples = samples_of(Window(reference, run.output, run.input))
    always = Mirror(plant)
    late = Mirror(RIG)
    for sample in samples[:-1]:
        always_state = always.push(sample)
        late.push(sample)
    driven = late.push(samples[-1]).driven_output[0]
    always_state = always.push(samples[-1])
    away = abs(always_state.driven_states["sink"] - plant["ambient"])
    assert away > 3.0
    late.parameters = plant
    following = dataclasses.replace(samples[-1], index=samples[-1].index + 1)
    late_state = late.push(following)
    always_state = always.push(following)
    for twin in ("closed_states", "driven_states"):
        assert (
            abs(getattr(late_state, twin)["sink"] - getattr(always_state, twin)["sink"])
            < away / 10
        )
    assert abs(late_state.driven_output[0] - driven) < 2.0


def test_without_a_loop_only_the_driven_twin_is_there() -> None:
    """What is said of the other is NaN, and a plant that is the twin leaves nothing."""
    samples = step_test(300, 7)
    mirror = Mirror(TRUTH, None, period=PERIOD)
    states = [mirror.push(sample) for sample in samples]
    last = states[-1]
    of_closed = [
        last.closed_output,
        last.closed_input,
        last.closed_residual_y,
        last.closed_residual_u,
    ]
    assert np.isnan([*of_closed, last.closed_rms_y, last.closed_rms_u]).all()
    assert np.isnan([*last.closed_states.values()]).all()
    # It starts from one reading, whose noise is forgotten slowly.
    assert last.driven_rms_y[0] < 4 * Box.output.noise
    mirror.parameters = TRUTH.replace(box_conductance=1.2)
    follows = mirror.push(dataclasses.replace(samples[-1], index=300))
    assert np.isfinite(follows.driven_output[0])
    assert follows.driven_output[0] != last.driven_output[0]
