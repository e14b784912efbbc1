"""Forecasts, how they came true, and how often the leader turned out to be right."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.documented_trust import check_trust, documents_of_verdicts
from tests.support.guessing import ever_trusted, levels
from twinmatch.forecasting import Band, Forecast
from twinmatch.twin import Outcome
from twinmatch.twin.trust import BandCheck, BandHistory, LeaderConfidence, check_band

NOISE = 0.1


def forecast(mean: float, half: float, samples: int = 100) -> Forecast:
    band = Band(*(np.full(samples, v) for v in (mean, mean - half, mean + half)))
    return Forecast(
        sample=0,
        candidate="c",
        structure="s",
        confidence=0.9,
        time=np.arange(1.0, samples + 1),
        references=np.zeros(samples),
        outputs=(band,),
        inputs=(band,),
    )


def test_errors_of_the_expected_size_leave_six_tenths_of_the_half_width() -> None:
    """A normal error has a standard deviation of 1/1.645 of the half width that holds 90 % of it."""
    errors = np.random.default_rng(3).normal(0.0, 2.0 / 1.6449, (2, 20_000))
    check = check_band(
        forecast(50.0, 2.0, 20_000), 50.0 + errors[:1], 50.0 + errors[1:]
    )
    # 20 000 draws: standard error 0.003
    assert check.miss_y == pytest.approx(0.608, abs=0.01)
    assert check.inside_y == pytest.approx(0.9, abs=0.01)
    assert check.inside_u == pytest.approx(0.9, abs=0.01)


@given(st.floats(0.1, 10.0), st.floats(0.0, 5.0))
def test_a_miss_counts_in_half_widths(half: float, miss: float) -> None:
    values = np.full((1, 60), 20.0 + miss * half)
    check = check_band(forecast(20.0, half), values, values)
    assert check.miss_y == pytest.approx(miss, abs=1e-9)
    assert check.miss == max(check.miss_y, check.miss_u)


def test_the_newest_samples_are_held_against_the_end_of_the_forecast() -> None:
    band = Band(np.arange(100.0), np.arange(100.0) - 1, np.arange(100.0) + 1)
    ramp = forecast(0.0, 1.0)
    ramp = Forecast(0, "c", "s", 0.9, ramp.time, ramp.reference, (band,), (band,))
    newest = np.arange(90.0, 100.0)[None]
    assert check_band(ramp, newest, newest) == BandCheck(
        0.0, 1.0, 0.0, 1.0, 90.0, 99.0, 99.0, ((0.0, 1.0), (0.0, 1.0))
    )


def test_readings_outside_their_band_are_not_level() -> None:
    values = np.full((1, 60), 20.0)
    values[0, 30] = 22.0
    values[0, 59] = 19.5
    check = check_band(forecast(20.0, 1.0), values, None)
    assert check.inside_y == pytest.approx(59 / 60)
    assert (check.low, check.high, check.last) == (19.5, 20.0, 19.5)


def test_readings_that_do_not_count_are_neither_a_miss_nor_a_level() -> None:
    values = np.full((1, 60), 20.0)
    values[0, 30] = 120.0
    values[0, 59] = -40.0
    counted = np.abs(values[0] - 20.0) < 1.0
    check = check_band(forecast(20.0, 1.0), values, None, counted)
    assert (check.miss, check.inside_y, check.low, check.high, check.last) == (
        0.0,
        1.0,
        20.0,
        20.0,
        20.0,
    )
    assert check_band(forecast(20.0, 1.0), values, None).miss > 10.0


def inside(*output: float) -> BandCheck:
    return BandCheck(0.6, 0.9, 0.6, 0.9, min(output), max(output), output[-1])


def outside(*output: float) -> BandCheck:
    return inside(*output)._replace(miss_u=3.0, inside_u=0.1)


def test_a_band_on_the_limit_of_the_controller_has_one_side() -> None:
    """Where the mean is the limit, what comes below is judged by the side that is there."""
    on_limit = Band(np.full(60, 255.0), np.full(60, 253.0), np.full(60, 255.0))
    limited_forecast = Forecast(
        0, "c", "s", 0.9, np.arange(1.0, 61.0), np.zeros(60), (on_limit,), (on_limit,)
    )
    check = check_band(
        limited_forecast, np.full((1, 60), 255.0), np.full((1, 60), 251.0)
    )
    assert check.miss_y == 0.0
    assert check.miss_u == pytest.approx(2.0)


def test_a_miss_lasts_once_separate_windows_fail_and_levels_are_those_that_held() -> (
    None
):
    bands = BandHistory(2.0, NOISE)
    assert bands.levels is None
    bands.push(inside(30.0, 40.0), 0, 60)
    bands.push(inside(40.5, 50.0), 60, 60)
    assert bands.levels == (30.0, 50.0)
    assert bands.since is None
    bands.push(outside(50.0, 70.0), 120, 60)
    assert not bands.lasts
    bands.push(outside(50.0, 70.0), 170, 60)
    assert not bands.lasts, "most of these readings were in the window before, too"
    bands.push(outside(70.0, 75.0), 180, 60)
    assert bands.lasts
    assert bands.since == 120
    assert bands.levels == (30.0, 50.0), (
        "a level at which it failed is not one to trust it at"
    )
    bands.push(inside(80.0, 82.0), 240, 60)
    assert not bands.lasts
    assert bands.since is None
    assert bands.levels == (80.0, 82.0), "what lies between was not seen to hold"
    bands.push(inside(49.0, 80.5), 300, 60)
    assert bands.levels == (30.0, 82.0)


def test_twice_the_limit_is_not_a_chance() -> None:
    bands = BandHistory(2.0, NOISE)
    bands.push(BandCheck(4.0, 0.1, low=30.0, high=31.0, last=30.0), 0, 60)
    assert bands.lasts
    peak = BandHistory(2.0, NOISE)
    peak.push(BandCheck(4.0, 0.8, low=30.0, high=31.0, last=30.0), 0, 60)
    assert not peak.lasts


def test_a_twin_that_beats_nobody_is_not_trusted() -> None:
    """Of 80 in an hour each at most 5 %; those with half the errors are, all of them."""
    assert (
        sum(is_trusted for seed in range(4) for is_trusted in ever_trusted(seed)) <= 4
    )
    assert all(ever_trusted(0, better=0.5))


def test_a_horizon_is_trusted_if_the_documented_test_passes_at_that_very_verdict(
    simulated_outcomes: list[Outcome],
) -> None:
    verdicts = [v for outcome in simulated_outcomes for v in outcome.verdicts]
    documents = documents_of_verdicts(verdicts)
    check_trust(documents)
    assert documents[-1]["trusted"]
    trusted_without_reason = {**documents[0], "trusted": documents[-1]["trusted"]}
    with pytest.raises(AssertionError, match="sample"):
        check_trust([trusted_without_reason])


def test_the_level_of_an_exact_motor_changes_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its bands are missed for one window, after a step; it changed at every eighth verdict."""
    # What its first structure lacks is only words in a match's reason, and most of the time to find.
    monkeypatch.setattr("twinmatch.twin.matcher.lack_of", lambda *_: None)
    course_of_levels = levels(1, 900)
    assert [
        after for before, after in pairwise(course_of_levels) if before != after
    ] == ["trusted"]


def test_it_begins_undecided_and_counts() -> None:
    """With Jeffreys' half a case of either kind, nine right ones and one wrong come to 9.5 of 11."""
    confidence = LeaderConfidence(1.0)
    assert confidence.share == 0.5
    for _ in range(9):
        confidence.add(1.0, 1.0)
    confidence.add(1.2, 1.0)
    assert confidence.share == pytest.approx(9.5 / 11.0)


def test_within_three_per_cent_counts_as_right() -> None:
    right = LeaderConfidence(1.0)
    wrong = LeaderConfidence(1.0)
    right.add(1.029, 1.0)
    wrong.add(1.031, 1.0)
    assert right.share > 0.5 > wrong.share


def test_the_past_is_forgotten() -> None:
    confidence = LeaderConfidence(0.9)
    for error in (2.0,) * 50 + (1.0,) * 50:
        confidence.add(error, 1.0)
    assert confidence.share > 0.98
