"""What is read from a forecast, against closed solutions and runs of the plant."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.dynamics import begin, gains_of, simulate_closed_loop
from twinmatch.forecasting import (
    CONFIDENCE,
    Band,
    Forecast,
    ForecastError,
    Moment,
    largest_input,
    settling_time,
    time_to_reach,
)
from twinmatch.plants import Peltier
from twinmatch.signals import FloatArray


def forecast(output: FloatArray, input: FloatArray, width: float = 0.0, period: float = 1.0) -> Forecast:
    """A forecast whose bands reach `width` to both sides."""
    size = np.size(output)
    return Forecast(
        sample=100,
        candidate="twin_1",
        structure="held sink",
        confidence=CONFIDENCE,
        time=period * np.arange(1, size + 1),
        reference=np.zeros(size),
        output=Band(output, output - width, output + width),
        input=Band(input, input - width, input + width),
    )


def test_a_lag_reaches_its_level_when_its_solution_does() -> None:
    """y = 40 + 20·(1 − e^(−t/10)); the band is 2 wide to both sides, the tolerance 0.5."""
    time = 0.1 * np.arange(1, 1201)
    said = forecast(40 + 20 * (1 - np.exp(-time / 10)), np.zeros(time.size), 2.0, 0.1)

    def when(left: float) -> float:
        return 10 * math.log(20 / left)

    found = time_to_reach(said, 55.0, 0.5)
    assert found.expected == pytest.approx(when(5.5), abs=0.11)
    assert found.earliest == pytest.approx(when(7.5), abs=0.11)
    assert found.latest == pytest.approx(when(3.5), abs=0.11)
    settled = settling_time(said, 60.0, 1.0)
    assert settled.expected == pytest.approx(when(1.0), abs=0.11)
    assert settled.earliest == pytest.approx(when(3.0), abs=0.11)
    assert settled.latest is None  # a band of ±2 never fits into ±1
    assert time_to_reach(said, 65.0, 0.5) == Moment(None, None, None)
    assert time_to_reach(said, 61.5, 0.5).earliest is not None


def test_a_level_that_is_passed_between_two_samples_is_reached() -> None:
    said = forecast(np.array([60.0, 55.0, 45.0, 30.0, 45.0]), np.zeros(5))
    assert time_to_reach(said, 50.0, 0.1).expected == 3.0
    assert settling_time(said, 50.0, 0.1).expected is None
    assert time_to_reach(said, 60.0, 0.1) == Moment(1.0, 1.0, 1.0)


def test_an_overshoot_holds_only_behind_it() -> None:
    """The rig with too much integral gain: reached on the way up, held when it is back."""
    rig, gains = Peltier.model().parameters(), dataclasses.replace(gains_of(Peltier, 1.0), integral=15.0)
    run = simulate_closed_loop(rig, np.full(200, 60.0), states=begin(rig, 40.0), gains=gains)
    said = forecast(run.output, run.input)
    reached, settled = time_to_reach(said, 60.0, 0.2).expected, settling_time(said, 60.0, 0.2).expected
    assert reached is not None
    assert settled is not None
    within = np.abs(run.output - 60.0) <= 0.2
    assert within[int(settled) - 1 :].all()
    assert not within[int(settled) - 2]
    assert run.output[: int(reached) - 1].max() < 59.8
    assert run.output.max() > 60.2
    assert settled > reached
    peak = largest_input(said)
    assert peak.expected == np.abs(run.input).max() == peak.least == peak.most
    assert abs(run.input[int(peak.time) - 1]) == peak.expected


def test_the_largest_input_counts_both_signs() -> None:
    peak = largest_input(forecast(np.zeros(3), np.array([5.0, -40.0, 30.0]), 10.0))
    assert (peak.expected, peak.time, peak.least, peak.most) == (40.0, 2.0, 30.0, 50.0)
    assert largest_input(forecast(np.zeros(1), np.array([5.0]), 10.0)).least == 0.0


@given(
    seed=st.integers(0, 10_000),
    level=st.floats(-3.0, 3.0),
    tolerance=st.floats(0.05, 1.0),
    width=st.floats(0.0, 2.0),
)
def test_every_run_inside_the_band_keeps_what_is_said(
    seed: int, level: float, tolerance: float, width: float
) -> None:
    """A run drawn inside the band reaches and holds between earliest and latest."""
    rng = np.random.default_rng(seed)
    mean = np.cumsum(rng.standard_normal(60)) * 0.5
    said = forecast(mean, mean, width)
    inside = mean + width * rng.uniform(-1.0, 1.0, 60)
    inside[0] = mean[0]  # on the same side of the level
    for ask in (time_to_reach, settling_time):
        told, own = ask(said, level, tolerance), ask(forecast(inside, inside), level, tolerance).expected
        for one, other in ((told.earliest, told.expected), (told.expected, told.latest)):
            assert (one or math.inf) <= (other or math.inf)
        assert (told.earliest or math.inf) <= (own or math.inf)
        if ask is settling_time or abs(mean[0] - level) > tolerance:
            assert (own or math.inf) <= (told.latest or math.inf)
    peak = largest_input(said)
    assert peak.least <= peak.expected <= peak.most
    assert peak.least <= np.abs(inside).max() <= peak.most


def test_a_question_without_meaning_is_refused() -> None:
    said = forecast(np.zeros(3), np.zeros(3))
    with pytest.raises(ForecastError, match="forecast of twin_1: the level is nan; give a finite one"):
        time_to_reach(said, math.nan, 0.1)
    for ask in (time_to_reach, settling_time):
        with pytest.raises(ForecastError, match="the tolerance is 0; give a positive one"):
            ask(said, 1.0, 0.0)
