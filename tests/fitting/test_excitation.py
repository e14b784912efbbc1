"""Whether inputs move outputs, by the samples where the defaults of a plant file are far from the plant."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.plants import Lag
from twinmatch.dynamics.movement import ExpectedMovement, InputEffect, effect_of
from twinmatch.fitting.excitation import (
    expected_movement,
    movement_by_inputs,
    shown_movement,
    unexpected_movement,
    why_not_moved,
)
from twinmatch.plants import TCLabBoth
from twinmatch.signals import FloatArray, Window

NOISE = Lag.output.noise
LEAST = np.array([Lag.output.least_step])


def weaker(factor: float) -> InputEffect:
    """What a plant file expects whose gain is so many times too small."""
    effect = effect_of(Lag, 1.0)
    return effect._replace(B=effect.B / factor, D=effect.D / factor)


def switching(count: int, seed: int, *, every: int = 1) -> FloatArray:
    """An input that may change its sign every so many samples."""
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], -(-count // every))
    return np.repeat(signs, every)[:count]


def follow(
    inputs: FloatArray, seed: int, gain: float = 2.0, lag: float = 5.0
) -> Window:
    """Readings of a lag that follows its inputs."""
    noise = np.random.default_rng(seed).normal(0.0, NOISE, inputs.size)
    states = np.zeros(inputs.size)
    for k in range(inputs.size - 1):
        states[k + 1] = states[k] + (gain * inputs[k] - states[k]) * -np.expm1(
            -1.0 / lag
        )
    return Window(np.zeros(inputs.size), states + noise, inputs)


@pytest.mark.parametrize("seed", range(3))
def test_the_samples_show_what_the_inputs_do(seed: int) -> None:
    window = follow(switching(300, seed), seed)
    shown = shown_movement(window)[:, 0]
    moved = window.output - np.mean(window.output)
    # noise pulls the fitted poles a little
    assert np.std(shown[30:] - moved[30:]) < 0.2 * np.std(moved)


def test_an_input_that_changes_its_sign_at_every_second_sample_moves_what_follows_it() -> (
    None
):
    """Its mean over ten samples stands nearly still."""
    inputs = np.resize([1.0, 1.0, -1.0, -1.0], 300)
    shown = shown_movement(follow(inputs, 1))
    assert np.ptp(shown) > 10.0 * NOISE


def test_a_plant_so_slow_that_noise_hides_each_step_shows_in_means() -> None:
    """From one sample to the next the output moves by an eighth of the noise of a reading."""
    window = follow(switching(720, 2, every=90), 3, gain=0.2, lag=300.0)
    assert np.ptp(shown_movement(window)) == pytest.approx(
        np.ptp(window.output), rel=0.5
    )


def test_a_window_is_expected_to_move_as_its_samples_one_by_one() -> None:
    """Two heaters whose outputs the schedule expects sample by sample, and a match all at once."""
    generator = np.random.default_rng(5)
    heaters = np.repeat(generator.uniform(0.0, 80.0, (12, 2)), 25, axis=0)
    effect = effect_of(TCLabBoth, 1.0)
    movement = ExpectedMovement(effect)
    one_by_one = np.array([movement.take(row) for row in heaters])
    assert np.ptp(one_by_one, axis=0).min() > 1.0
    window = Window(np.zeros((300, 2)), np.zeros((300, 2)), heaters)
    # sums of matrices are rounded in another order
    np.testing.assert_allclose(
        expected_movement(window, effect), one_by_one, rtol=0.0, atol=1e-11
    )


def test_each_of_several_inputs_moves_the_output_by_its_own_gain() -> None:
    """The noiseless answer of a lag to two inputs is the response of the model that is fitted to it."""
    inputs = np.column_stack(
        [switching(400, 3, every=7), 2.0 * switching(400, 4, every=11)]
    )
    states = np.zeros(400)
    for k in range(399):
        states[k + 1] = states[k] + 0.2 * (inputs[k] @ [3.0, -1.0] - states[k])
    window = Window(np.zeros(400), states, inputs)
    shown = shown_movement(window)[:, 0]
    # the model begins at the mean, and is scaled to the range of the output
    np.testing.assert_allclose(np.diff(shown[60:]), np.diff(states[60:]), rtol=1e-3)


def test_what_the_inputs_do_not_cause_is_not_taken_for_theirs() -> None:
    """Outputs that wander by themselves, beside inputs that switch: none of 200 counts."""
    generator = np.random.default_rng(7)
    for seed in range(200):
        wandering = np.cumsum(generator.normal(0.0, 0.3, 200)) + generator.normal(
            0.0, NOISE, 200
        )
        window = Window(
            np.zeros(200), wandering, switching(200, seed, every=1 + seed % 20)
        )
        assert not shown_movement(window).any()


def test_stand_ins_for_lost_samples_show_nothing() -> None:
    window = follow(switching(300, 4), 4)
    is_seen = np.random.default_rng(4).random(300) > 0.1
    estimates = np.where(is_seen, window.output, 1e6)
    thinned = Window(window.references, estimates, window.inputs, seen=is_seen)
    everything = Window(window.references, window.outputs, window.inputs)
    of_thinned = shown_movement(thinned)[20:, 0]
    assert np.corrcoef(of_thinned, shown_movement(everything)[20:, 0])[0, 1] > 0.95


@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_defaults_that_are_about_right_are_believed(factor: float) -> None:
    window = follow(switching(300, 5), 5)
    effect = weaker(factor)
    assert not unexpected_movement(window, effect).any()
    np.testing.assert_array_equal(
        movement_by_inputs(window, effect), expected_movement(window, effect)
    )


def test_defaults_that_are_far_off_are_not() -> None:
    window = follow(switching(300, 5), 5)
    np.testing.assert_array_equal(
        movement_by_inputs(window, weaker(250.0)), shown_movement(window)
    )
    np.testing.assert_array_equal(
        unexpected_movement(window, weaker(250.0)), shown_movement(window)
    )


def test_a_quiet_window_says_by_what_it_was_judged() -> None:
    still = Window(np.zeros(60), np.zeros(60), np.full(60, 3.0))
    assert why_not_moved(still, Lag, LEAST) == "the input did not move"
    resampled = Window(np.zeros(60), np.zeros(60), np.resize([3.0, 3.0 + 1e-14], 60))
    assert why_not_moved(resampled, Lag, LEAST) == "the input did not move"
    trembling = Window(np.zeros(60), np.zeros(60), np.resize([0.0, 0.02], 60))
    assert why_not_moved(trembling, Lag, LEAST) == (
        "the input moved by 0.02 V, which by the defaults of the plant file moves the output by 0.022 m, "
        "less than the 0.2 m that count"
    )
    drifting = Window(
        np.zeros(60), np.linspace(0.0, 5.0, 60), np.resize([0.0, 0.02], 60)
    )
    assert why_not_moved(drifting, Lag, LEAST).endswith(
        "; the output moved by 5 m, but the samples do not show that the input caused it"
    )
