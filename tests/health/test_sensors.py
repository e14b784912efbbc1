"""What is learned of a sensor, and what its forecasts are worth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.health.mixture_forecasts import ForecastSkill, ScoredForecast
from twinmatch.health.sensors import LearnedSensor, RunLengths


def test_runs_of_a_display_continue_as_often_as_they_have() -> None:
    """Repeats are independent: the ratio is that of their probability at any length."""
    random = np.random.default_rng(3)
    runs = RunLengths()
    for _ in range(4000):
        runs.take(int(random.geometric(1.0 - 0.8)) - 1)
    # The standard deviation of a ratio of 0.8 over 300 runs is 0.02.
    for repeats in (0, 1, 2, 5, 9):
        assert runs.continues(repeats) == pytest.approx(0.8, abs=0.08)


@given(st.lists(st.integers(0, 100_000), max_size=30), st.integers(0, 1_000_000))
def test_whether_a_run_continues_is_a_probability_and_unknown_beyond_all_doublings(
    ended: list[int], repeats: int
) -> None:
    runs = RunLengths()
    for length in ended:
        runs.take(length)
    assert 0.0 <= runs.continues(repeats) < 1.0
    if not ended or repeats >= 2 * (max(ended) + 1):
        assert runs.continues(repeats) == 0.0


def sensor_that_stands(*runs: int) -> LearnedSensor:
    """A sensor whose display has stood for so many samples each, of a probability of 0.9 each."""
    sensor = LearnedSensor(0.1, (0.0, 100.0), 1.0)
    value = 20.0
    for length in runs:
        value += 0.3
        for _ in range(length):
            sensor.read(value, counts=True)
            sensor.learn(value, math.log(0.5), value, counts=True)
    return sensor


def test_a_display_that_has_often_stood_for_long_says_little_by_standing() -> None:
    usual = sensor_that_stands(*[30] * 20, 30)
    sudden = sensor_that_stands(*[1] * 600, 30)
    assert sudden.frozen > 15.0  # 29 repeats, each of a probability of a half
    assert usual.frozen < 2.0


def test_a_run_of_a_frozen_sensor_is_not_how_it_usually_reads() -> None:
    sensor = sensor_that_stands(*[1] * 100, 400)
    sensor.is_accused = True
    for value in (50.0, 51.0, 51.0):
        sensor.read(value, counts=True)
        sensor.learn(value, math.log(0.5), value, counts=True)
    assert sensor.run_lengths.continues(300) == 0.0


@pytest.mark.parametrize(
    ("readings", "expected", "jumps"),
    [
        ((45.0, 45.3, 45.6), 35.0, True),
        ((45.0, 35.3, 35.6), 35.0, False),  # an outlier
        ((45.0, 53.0, 60.0), 35.0, False),  # it continues: the plant moves
        ((45.0, 45.3, 45.6), 39.0, False),  # the equations expected a good part of it
        ((45.0, 45.3, 45.6), 29.0, True),  # they expected the contrary
    ],
)
def test_only_a_movement_that_stays_and_that_nobody_expected_is_a_jump(
    readings: tuple[float, ...], expected: float, jumps: bool
) -> None:
    sensor = sensor_that_stands(*[1] * 50)  # up to 35
    for value, due in zip(readings, (expected, *readings[1:]), strict=True):
        sensor.read(value, counts=True)
        sensor.learn(value, math.log(0.5), due, counts=True)
    assert sensor.jump.stays is jumps
    if jumps:
        assert (sensor.jump.age, sensor.jump.size) == (2, pytest.approx(10.0))


def forecast(error: float, standing: float, ahead: int = 3) -> ScoredForecast:
    return ScoredForecast(
        0,
        ahead,
        1.0,
        np.array([error**2, 0.0]),
        np.array([standing**2, 0.0]),
        np.zeros(2),
    )


@pytest.mark.parametrize(
    ("error", "standing", "knows"),
    [(1.0, 2.0, True), (3.0, 2.0, True), (4.5, 2.0, False), (0.5, 0.0, True)],
)
def test_equations_that_err_twice_as_far_as_a_reading_that_stands_know_nothing(
    error: float, standing: float, knows: bool
) -> None:
    skill = ForecastSkill(2)
    variance = np.array([0.01, 0.01])
    for _ in range(11):
        skill.take(forecast(error, standing))
        assert skill.knows(variance).all()  # too few to say
    for _ in range(5):
        skill.take(forecast(error, standing))
    assert skill.knows(variance).tolist() == [knows, True]


def test_forecasts_of_a_few_seconds_do_not_count() -> None:
    skill = ForecastSkill(2)
    for _ in range(50):
        skill.take(forecast(9.0, 0.0, ahead=1))
    assert skill.knows(np.array([0.01, 0.01])).all()
