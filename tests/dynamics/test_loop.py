"""The loop: the controller against recordings of the real one, and what its sensor adds, rounds, repeats."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.dynamics import (
    Controller,
    PidGains,
    PidState,
    PlantError,
    Sensor,
    SensorRealisation,
    begin,
    controller_state,
    simulate_closed_loop,
)
from twinmatch.plants import Peltier
from twinmatch.signals import Window

assert Peltier.loop is not None
RIG = Peltier.loop

errors = st.lists(st.floats(-30.0, 30.0), min_size=3, max_size=40)


def test_every_recorded_command_is_reproduced(
    recordings: dict[int, Path], recorded_hour: Callable[[int], Window]
) -> None:
    for number in recordings:
        window = recorded_hour(number)
        pid = Controller(RIG)
        pwm = [
            pid.step(r, y)[0]
            for r, y in zip(window.reference, window.output, strict=True)
        ]
        np.testing.assert_allclose(pwm, window.input, atol=1e-4)
        assert np.max(np.abs(pwm)) == 255.0  # saturation was among them


def test_a_controller_picked_up_anywhere_in_a_recording_continues(
    recorded_hour: Callable[[int], Window],
) -> None:
    hour = recorded_hour(5)
    for first in range(0, len(hour) - 20, 37):
        # steps, saturated stretches and rest alike
        window = hour.part(first, first + 19)
        pid = Controller(RIG, controller_state(window, RIG))
        pwm = [pid.step(window.reference[k], window.output[k])[0] for k in range(2, 20)]
        np.testing.assert_allclose(pwm, window.input[2:], atol=1e-3)


def test_a_pid_steps_as_calculated_by_hand() -> None:
    pid = Controller(PidGains(2.0, 0.5, 1.0, 0.25, low=-10.0, high=10.0))
    assert pid.step(3.0, 1.0)[0] == 2.0 * 2.0 + 1.0 * 2.0
    assert PidState(*pid.state) == PidState(1.0, 2.0)
    assert pid.step(8.0, 1.0)[0] == 10.0  # 14 + 1 + 5 = 20 wanted
    assert PidState(*pid.state) == PidState(1.0 + 3.5 + 0.25 * (10.0 - 20.0), 7.0)


@given(errors)
def test_following_a_controller_adopts_its_state(values: list[float]) -> None:
    leader = Controller(RIG)
    follower = Controller(RIG, PidState(77.0, 0.0))
    for error in values:
        follower.follow(error, 0.0, leader.step(error, 0.0)[0])
        assert follower.state[1] == leader.state[1]
        assert follower.state[0] == pytest.approx(leader.state[0], rel=1e-9, abs=1e-9)


@given(
    errors, st.sampled_from([0.0, 0.3, 0.8, 1.0, 1.5]), st.sampled_from([0.5, 1.0, 2.0])
)
def test_the_state_is_found_for_any_back_calculation(
    values: list[float], back_calculation: float, period: float
) -> None:
    gains = dataclasses.replace(RIG, back_calculation=back_calculation, period=period)
    pid = Controller(gains)
    pwm = []
    states = []
    for error in values:
        pwm.append(pid.step(error, 0.0)[0])
        states.append(pid.state)
    window = Window(
        np.array(values), np.zeros(len(values)), np.array(pwm), period=period
    )
    free = next((k for k in range(1, len(pwm)) if abs(pwm[k]) < 255.0), None)
    state = controller_state(window, gains)
    assert state.previous == states[1][1]
    decay = abs(1.0 - back_calculation * period)
    if decay == 0.0 or (free is not None and decay ** (free - 1) >= 1e-3):
        assert state.integral == pytest.approx(states[1][0], rel=1e-8, abs=1e-6)
    else:
        assert math.isfinite(state.integral)


def test_a_window_limited_throughout_gets_the_least_state_that_explains_it() -> None:
    gains = dataclasses.replace(RIG, back_calculation=0.5)
    window = Window(np.full(5, 30.0), np.zeros(5), np.full(5, 255.0))
    least = 255.0 - gains.proportional * 30.0
    assert controller_state(window, gains) == PidState(
        least + gains.integral * 30.0, 30.0
    )
    pid = Controller(gains, PidState(least, 30.0))
    assert pid.step(30.0, 0.0)[0] == 255.0


def test_a_limited_follower_without_exact_back_calculation_forgets_its_error() -> None:
    gains = dataclasses.replace(RIG, back_calculation=0.5)
    leader = Controller(gains)
    follower = Controller(gains, PidState(500.0, 0.0))
    gaps = []
    for _ in range(12):
        follower.follow(20.0, 0.0, leader.step(20.0, 0.0)[0])
        gaps.append(abs(follower.state[0] - leader.state[0]))
    np.testing.assert_allclose(gaps, 500.0 * 0.5 ** np.arange(1, 13), rtol=1e-6)
    follower.follow(12.0, 0.0, leader.step(12.0, 0.0)[0])
    # the first free sample tells it
    assert abs(leader.state[0] - follower.state[0]) < 1e-9


def test_a_simulation_from_a_found_state_continues_where_the_first_left_off() -> None:
    rig = Peltier.model().parameters()
    reference = np.repeat([30.0, 70.0, 40.0], 60)
    whole = simulate_closed_loop(rig, reference, states=begin(rig, 22.85))
    window = Window(reference, whole.output, whole.input).part(100, 179)
    continued = simulate_closed_loop(
        rig,
        window.reference[2:],
        states=begin(rig, window.output[2]),
        controller=controller_state(window, RIG),
    )
    np.testing.assert_allclose(continued.output, window.output[2:], atol=1e-9)
    np.testing.assert_allclose(continued.input, window.input[2:], atol=1e-7)


def test_a_derivative_of_the_measurement_is_not_kicked_by_a_step_and_its_state_is_found() -> (
    None
):
    gains = dataclasses.replace(RIG, on_measurement=True)
    assert Controller(gains).step(1.0, 0.0)[0] == gains.proportional
    output = 30.0 + np.sin(np.arange(12.0) / 3)
    reference = np.where(np.arange(12) < 6, 30.0, 31.0)
    pid = Controller(gains)
    input_ = [pid.step(r, y)[0] for r, y in zip(reference, output, strict=True)]
    for first in range(9):
        window = Window(reference, output, np.array(input_)).part(first, 11)
        restored = Controller(gains, controller_state(window, gains))
        commands = [
            restored.step(window.reference[k], window.output[k])[0]
            for k in range(2, len(window))
        ]
        np.testing.assert_allclose(commands, input_[first + 2 :], atol=1e-9)


def test_what_is_not_a_number_is_refused_and_changes_nothing() -> None:
    pid = Controller(RIG, PidState(3.0, 1.0))
    single = np.zeros(1)
    for message, use in (
        ("controller: output is nan", lambda: pid.step(40.0, math.nan)),
        ("controller: reference is inf", lambda: pid.step(math.inf, 30.0)),
        ("controller: input is nan", lambda: pid.follow(40.0, 30.0, math.nan)),
        (
            "holds a value that is not finite",
            lambda: dataclasses.replace(RIG, integral=math.nan),
        ),
        ("period 0.0 s must be positive", lambda: dataclasses.replace(RIG, period=0.0)),
        (
            "holds 1 sample; give at least two",
            lambda: controller_state(Window(single, single, single), RIG),
        ),
    ):
        with pytest.raises(PlantError, match=message):
            use()
    assert PidState(*pid.state) == PidState(3.0, 1.0)


CAMERA = Peltier.sensor or Sensor()

HOUR = 3600


def test_the_same_seed_gives_the_same_run() -> None:
    first, second, other_seed = (CAMERA.realise(HOUR, 1.0, seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.noise, second.noise)
    np.testing.assert_array_equal(first.frozen, second.frozen)
    assert not np.array_equal(first.noise, other_seed.noise)


def test_noise_is_white_and_has_its_declared_size() -> None:
    noise = Sensor(noise=0.2).realise(20000, 1.0, 1).noise
    # four standard errors of 20000 values
    assert np.std(noise) == pytest.approx(0.2, rel=0.02)
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 0.03


def test_corrections_come_once_a_period() -> None:
    frozen = Sensor(pause_period=180.0, pause_duration=2.5).realise(HOUR, 1.0, 2).frozen
    starts = np.flatnonzero(np.diff(frozen.astype(int)) == 1)
    np.testing.assert_array_equal(np.diff(starts), 180)
    assert len(starts) in (19, 20)
    assert 2 * 19 <= frozen.sum() <= 3 * 20
    assert not Sensor(pause_period=None).realise(HOUR, 1.0, 2).frozen.any()


def test_a_frozen_camera_repeats_itself_in_the_loop() -> None:
    camera = Sensor(0.1, pause_period=30.0, pause_duration=3.0).realise(300, 1.0, 4)
    rig = Peltier.model().parameters()
    response = simulate_closed_loop(
        rig, np.full(300, 60.0), states=begin(rig, 23.0), sensor=camera
    )
    repeats = np.diff(response.output) == 0.0
    assert camera.frozen.sum() >= 27
    assert repeats[camera.frozen[1:]].all()


@given(
    st.floats(-20.0, 130.0), st.sampled_from([0.01, 0.05, 0.5]), st.floats(-1.0, 1.0)
)
def test_a_reading_is_a_multiple_of_the_resolution_next_to_the_output(
    output: float, resolution: float, noise: float
) -> None:
    camera = SensorRealisation(np.array([noise]), np.array([False]), resolution)
    value = camera.reading(0, output)
    assert value / resolution == pytest.approx(round(value / resolution), abs=1e-6)
    assert abs(value - (output + noise)) <= resolution / 2 + 1e-9


def test_a_camera_frozen_from_the_start_shows_the_output_once() -> None:
    camera = SensorRealisation(np.zeros(3), np.ones(3, dtype=bool), 0.0)
    rig = Peltier.model().parameters()
    response = simulate_closed_loop(
        rig, [60.0] * 3, states=begin(rig, 27.0), sensor=camera
    )
    np.testing.assert_array_equal(response.output, np.full(3, 300.15 - 273.15))
    assert camera.reading(0, 27.0) == 27.0
    assert camera.reading(2, 37.0, last=12.0) == 12.0


def test_impossible_cameras_are_refused() -> None:
    def realised(noise: list[float], frozen: int = 2) -> SensorRealisation:
        return SensorRealisation(np.array(noise), np.zeros(frozen, dtype=bool), 0.0)

    for message, make in (
        (r"sensor: noise is -0\.1", lambda: Sensor(noise=-0.1)),
        ("sensor: resolution is nan", lambda: Sensor(resolution=math.nan)),
        ("a pause every 0.5 s leaves no time", lambda: Sensor(pause_period=0.5)),
        ("cannot realise -1 samples", lambda: CAMERA.realise(-1, 1.0, 0)),
        (r"cannot realise 3 samples of 0\.0 s", lambda: CAMERA.realise(3, 0.0, 0)),
        (r"noise has shape \(2,\) and frozen \(3,\)", lambda: realised([0.0, 0.0], 3)),
        ("must be finite", lambda: realised([math.nan, math.nan])),
        ("reading 2 of 2", lambda: realised([0.0, 0.0]).reading(2, 27.0)),
    ):
        with pytest.raises(PlantError, match=message):
            make()
