"""The controller: against the recordings of the real one, and its state found again."""

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
    Pid,
    PidGains,
    PidState,
    PlantError,
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
        window, pid = recorded_hour(number), Pid(RIG)
        pwm = [pid.step(r, y) for r, y in zip(window.reference, window.output, strict=True)]
        np.testing.assert_allclose(pwm, window.input, atol=1e-4)
        assert np.max(np.abs(pwm)) == 255.0  # saturation was among them


def test_a_controller_picked_up_anywhere_in_a_recording_continues(
    recorded_hour: Callable[[int], Window],
) -> None:
    hour = recorded_hour(5)
    for first in range(0, len(hour) - 20, 37):  # steps, saturated stretches and rest alike
        window = hour.part(first, first + 19)
        pid = Pid(RIG, controller_state(window, RIG))
        pwm = [pid.step(window.reference[k], window.output[k]) for k in range(2, 20)]
        np.testing.assert_allclose(pwm, window.input[2:], atol=1e-3)


def test_a_hand_calculation() -> None:
    pid = Pid(PidGains(2.0, 0.5, 1.0, 0.25, low=-10.0, high=10.0))
    assert pid.step(3.0, 1.0) == 2.0 * 2.0 + 1.0 * 2.0
    assert pid.state == PidState(1.0, 2.0)
    assert pid.step(8.0, 1.0) == 10.0  # 14 + 1 + 5 = 20 wanted
    assert pid.state == PidState(1.0 + 3.5 + 0.25 * (10.0 - 20.0), 7.0)


@given(errors)
def test_following_a_controller_adopts_its_state(values: list[float]) -> None:
    leader, follower = Pid(RIG), Pid(RIG, PidState(77.0, 0.0))
    for error in values:
        follower.follow(error, 0.0, leader.step(error, 0.0))
        assert follower.state.previous == leader.state.previous
        assert follower.state.integral == pytest.approx(leader.state.integral, rel=1e-9, abs=1e-9)


@given(errors, st.sampled_from([0.0, 0.3, 0.8, 1.0, 1.5]), st.sampled_from([0.5, 1.0, 2.0]))
def test_the_state_is_found_for_any_back_calculation(
    values: list[float], back_calculation: float, period: float
) -> None:
    gains = dataclasses.replace(RIG, back_calculation=back_calculation, period=period)
    pid, pwm, states = Pid(gains), [], []
    for error in values:
        pwm.append(pid.step(error, 0.0))
        states.append(pid.state)
    window = Window(np.array(values), np.zeros(len(values)), np.array(pwm), period=period)
    free = next((k for k in range(1, len(pwm)) if abs(pwm[k]) < 255.0), None)
    found = controller_state(window, gains)
    assert found.previous == states[1].previous
    kept = abs(1.0 - back_calculation * period)
    if kept == 0.0 or (free is not None and kept ** (free - 1) >= 1e-3):
        assert found.integral == pytest.approx(states[1].integral, rel=1e-8, abs=1e-6)
    else:
        assert math.isfinite(found.integral)


def test_a_window_limited_throughout_gets_the_least_state_that_explains_it() -> None:
    gains = dataclasses.replace(RIG, back_calculation=0.5)
    window = Window(np.full(5, 30.0), np.zeros(5), np.full(5, 255.0))
    least = 255.0 - gains.proportional * 30.0
    assert controller_state(window, gains) == PidState(least + gains.integral * 30.0, 30.0)
    pid = Pid(gains, PidState(least, 30.0))
    assert pid.step(30.0, 0.0) == 255.0


def test_a_limited_follower_without_exact_back_calculation_forgets_its_error() -> None:
    gains = dataclasses.replace(RIG, back_calculation=0.5)
    leader, follower = Pid(gains), Pid(gains, PidState(500.0, 0.0))
    gaps = []
    for _ in range(12):
        follower.follow(20.0, 0.0, leader.step(20.0, 0.0))
        gaps.append(abs(follower.state.integral - leader.state.integral))
    np.testing.assert_allclose(gaps, 500.0 * 0.5 ** np.arange(1, 13), rtol=1e-6)
    follower.follow(12.0, 0.0, leader.step(12.0, 0.0))
    assert abs(leader.state.integral - follower.state.integral) < 1e-9  # the first free sample tells it


def test_a_simulation_from_a_found_state_continues_where_the_first_left_off() -> None:
    rig, reference = Peltier.model().parameters(), np.repeat([30.0, 70.0, 40.0], 60)
    whole = simulate_closed_loop(rig, reference, states=begin(rig, 22.85))
    window = Window(reference, whole.output, whole.input).part(100, 179)
    rest = simulate_closed_loop(
        rig,
        window.reference[2:],
        states=begin(rig, window.output[2]),
        controller=controller_state(window, RIG),
    )
    np.testing.assert_allclose(rest.output, window.output[2:], atol=1e-9)
    np.testing.assert_allclose(rest.input, window.input[2:], atol=1e-7)


def test_a_derivative_of_the_measurement_is_not_kicked_by_a_step_and_its_state_is_found() -> None:
    gains = dataclasses.replace(RIG, on_measurement=True)
    assert Pid(gains).step(1.0, 0.0) == gains.proportional
    output = 30.0 + np.sin(np.arange(12.0) / 3)
    reference = np.where(np.arange(12) < 6, 30.0, 31.0)
    pid = Pid(gains)
    input_ = [pid.step(r, y) for r, y in zip(reference, output, strict=True)]
    for first in range(9):
        window = Window(reference, output, np.array(input_)).part(first, 11)
        other = Pid(gains, controller_state(window, gains))
        again = [other.step(window.reference[k], window.output[k]) for k in range(2, len(window))]
        np.testing.assert_allclose(again, input_[first + 2 :], atol=1e-9)


def test_what_is_not_a_number_is_refused_and_changes_nothing() -> None:
    pid = Pid(RIG, PidState(3.0, 1.0))
    with pytest.raises(PlantError, match="PID: output is nan"):
        pid.step(40.0, math.nan)
    with pytest.raises(PlantError, match="PID: reference is inf"):
        pid.step(math.inf, 30.0)
    with pytest.raises(PlantError, match="PID: input is nan"):
        pid.follow(40.0, 30.0, math.nan)
    assert pid.state == PidState(3.0, 1.0)
    with pytest.raises(PlantError, match="holds a value that is not finite"):
        dataclasses.replace(RIG, integral=math.nan)
    with pytest.raises(PlantError, match=r"period 0.0 s must be positive"):
        dataclasses.replace(RIG, period=0.0)
    with pytest.raises(PlantError, match="the window holds 1 sample; give at least two"):
        controller_state(Window(np.zeros(1), np.zeros(1), np.zeros(1)), RIG)
