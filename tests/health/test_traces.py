"""The traces one by one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.health import Movement
from twinmatch.health.traces import Effect, Lag, Repeats

NOISE = 0.1
"""Of a reading, °C."""
STILL = Movement(0.0, 0.0, 0.0)


def test_the_share_is_what_the_plate_shows_of_the_drive() -> None:
    effect = Effect(1.0, NOISE)
    for _ in range(20):
        effect.push(Movement(2.0, -1.0, -0.3), 0.05)  # 0.3 of 2 °C are missing every second
    assert effect.share == pytest.approx(0.85)
    assert effect.follows


@given(share=st.floats(-1.0, 2.0), drive=st.floats(1.0, 4.0), sign=st.sampled_from([-1.0, 1.0]))
def test_any_share_is_found_in_heating_and_in_cooling(share: float, drive: float, sign: float) -> None:
    effect = Effect(1.0, NOISE)
    for k in range(24):
        # It comes on as a drive does that the controller turns up, so that no step looks like the camera's.
        part = sign * drive * min(1.0, k / 10)
        effect.push(Movement(part, 0.0, (share - 1.0) * part), 0.05)
    assert effect.share == pytest.approx(share, abs=0.35)


def test_too_little_drive_is_not_judged() -> None:
    effect = Effect(1.0, NOISE)
    for _ in range(60):
        effect.push(Movement(0.4, -0.4, -0.4), 0.05)
    assert np.isnan(effect.share)
    assert not effect.follows


def test_a_rough_balance_wants_more_drive() -> None:
    effect = Effect(1.0, NOISE)
    for _ in range(60):
        effect.push(Movement(1.0, -1.0, -0.4), 0.6)
    assert np.isnan(effect.share)


def test_a_step_of_the_camera_is_not_taken_for_movement() -> None:
    effect = Effect(1.0, NOISE)
    for k in range(40):
        effect.push(Movement(1.0, -1.0, -5.0 if k == 30 else 0.0), 0.05)
    assert effect.share == pytest.approx(1.0)


@pytest.mark.parametrize("inward", [-1.0, 1.0])
def test_a_reading_may_stay_at_an_end_of_the_span(inward: float) -> None:
    """A level sensor that ends at 10 V shows no noise there; but the level is known to fall at last."""
    repeats = Repeats(1.0, 10.0, NOISE)
    noisy(repeats, 200)
    for _ in range(40):
        repeats.push(0.0, Movement(-inward, 0.0, inward), inward)  # driven further out
    assert not repeats.stands
    for _ in range(80):
        repeats.push(0.0, Movement(inward, 0.0, -inward), inward)
    assert repeats.stands


def noisy(repeats: Repeats, samples: int) -> None:
    for change in np.random.default_rng(8).normal(0.0, 0.1, samples):
        repeats.push(float(change), STILL)


def test_ten_equal_readings_of_a_noisy_camera_are_not_a_coincidence() -> None:
    repeats = Repeats(1.0, 10.0, NOISE)
    noisy(repeats, 100)
    for count in range(1, 12):
        repeats.push(0.0, STILL)
        assert repeats.count == count
        assert repeats.stands == (count >= 9)
    repeats.push(0.3, STILL)
    assert not repeats.stands


def test_a_coarse_camera_may_repeat_itself() -> None:
    random, repeats = np.random.default_rng(8), Repeats(1.0, 10.0, NOISE)
    readings = np.round(random.normal(40.0, 0.1, 3000) * 2) / 2  # half a degree: nearly always the same
    longest = 0
    for change in np.diff(readings):
        repeats.push(float(change), STILL)
        longest = max(longest, repeats.count)
        assert not repeats.stands
    assert longest > 20


def test_a_sensor_without_noise_stands_still_only_if_the_plate_should_move() -> None:
    repeats = Repeats(1.0, 10.0, NOISE)
    for _ in range(60):
        repeats.push(0.0, STILL)
        assert not repeats.stands
    for _ in range(4):
        repeats.push(0.0, Movement(1.5, -0.5, -1.0))
    assert repeats.stands


@given(lag=st.integers(2, 6), seed=st.integers(0, 1000))
def test_a_lag_is_found(lag: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    drive = np.convolve(random.normal(0.0, 2.0, 60), np.ones(4) / 2, "valid")
    trace = Lag(1.0)
    for k in range(lag, drive.size):
        seen = drive[k - lag] + random.normal(0.0, 0.05)
        trace.push(Movement(float(drive[k]), 0.0, float(seen - drive[k])))
    assert trace.seconds(20) == lag


@given(seed=st.integers(0, 1000))
def test_a_dead_drive_is_not_a_lag(seed: int) -> None:
    random = np.random.default_rng(seed)
    trace = Lag(1.0)
    for drive in np.convolve(random.normal(0.0, 2.0, 60), np.ones(4) / 2, "valid"):
        trace.push(Movement(float(drive), 0.0, float(random.normal(0.0, 0.05) - drive)))
    assert trace.seconds(20) is None
