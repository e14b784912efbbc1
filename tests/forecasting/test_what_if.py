"""Questions about what comes, against the plant that was asked about."""

from __future__ import annotations

import csv
import dataclasses
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.plants import Motor
from twinmatch.comparing import Candidate
from twinmatch.dynamics import begin, law_of, simulate_closed_loop
from twinmatch.forecasting import (
    CONFIDENCE,
    NEAR,
    Band,
    Forecast,
    ForecastError,
    Moment,
    Outlook,
    Question,
    SetPoints,
    largest_input,
    settling_time,
    time_to_reach,
    what_if,
)
from twinmatch.plants import Peltier
from twinmatch.sessions import samples_of
from twinmatch.signals import FloatArray, Window
from twinmatch.twin import Forecaster

RIG = Peltier.model("sink with mass").parameters()
PAST = np.repeat([35.0, 50.0], 200)
SECONDS = 300


def run(reference: FloatArray) -> Window:
    """The plant without noise."""
    simulated = simulate_closed_loop(RIG, reference, states=begin(RIG, 22.85))
    return Window(reference, simulated.output, simulated.input)


def forecaster() -> Forecaster:
    """One candidate, the plant itself, after `PAST`."""
    taught = Forecaster(law_of(Peltier, 1.0))
    taught.enter([Candidate("rig", 50.0, RIG, None)])
    for sample in samples_of(run(PAST)):
        taught.push(sample)
    return taught


@pytest.fixture(scope="module")
def outlook() -> Outlook:
    return forecaster().outlook()


def test_the_answer_is_what_the_plant_then_does(outlook: Outlook) -> None:
    """To 62 °C in a ramp of 40 s, and 70 s later back: output, control, arrival and largest control."""
    question = Question(
        (40.0, 110.0, 110.5), (62.0, 62.0, 50.0), ramps=True, level=62.0, tolerance=0.5
    )
    ahead = np.arange(1.0, SECONDS + 1)
    reference = np.interp(ahead, [0.0, 40.0, 110.0, 110.5], [50.0, 62.0, 62.0, 50.0])
    came = run(np.concatenate([PAST, reference])).part(
        PAST.size, PAST.size + SECONDS - 1
    )
    answer = what_if(outlook, question)
    assert answer.forecast.sample == PAST.size - 1
    np.testing.assert_allclose(answer.forecast.reference, reference, atol=1e-12)
    # The observer has come within a hundredth of a degree of the states; the loop forgets the rest.
    np.testing.assert_allclose(answer.forecast.output.mean, came.output, atol=0.02)
    np.testing.assert_allclose(answer.forecast.input.mean, came.input, atol=1.0)
    arrivals = ahead[np.abs(came.output - 62.0) <= 0.5]
    assert answer.reached.expected == pytest.approx(arrivals[0], abs=1.0)
    assert answer.settled == Moment(None, None, None)
    assert answer.largest.expected == pytest.approx(np.abs(came.input).max(), abs=1.0)


def test_an_empty_question_asks_what_comes_if_nothing_is_changed(
    outlook: Outlook,
) -> None:
    answer = what_if(outlook, Question())
    assert set(answer.forecast.reference) == {50.0}
    assert answer.forecast.time[-1] == SECONDS
    assert (answer.level, answer.tolerance) == (50.0, NEAR * Peltier.output.noise)
    expected = outlook.forecast(np.full(SECONDS, 50.0))
    np.testing.assert_array_equal(answer.forecast.output.mean, expected.output.mean)
    np.testing.assert_array_equal(answer.forecast.input.high, expected.input.high)


def test_a_session_that_went_beyond_the_limits_can_be_asked_how_it_continues(
    outlook: Outlook,
) -> None:
    """Only what is asked for is checked, not the set-point that stands."""
    beyond = replace(outlook, sample=replace(outlook.sample, references=150.0))
    assert set(what_if(beyond, Question()).forecast.reference) == {150.0}


LEVELS = st.lists(st.floats(20.0, 90.0), min_size=1, max_size=4)


@given(LEVELS, st.booleans(), st.integers(1, 400), st.floats(0.1, 5.0))
def test_answers_are_in_order(
    outlook: Outlook, levels: list[float], ramps: bool, horizon: int, tolerance: float
) -> None:
    """Earliest before expected before latest, reached before held, least below expected below most."""
    times = tuple(30.0 * k for k in range(1, len(levels) + 1))
    answer = what_if(
        outlook,
        Question(times, tuple(levels), ramps, float(horizon), tolerance=tolerance),
    )
    assert answer.forecast.time.size == horizon
    assert answer.level == levels[-1]
    for moment in (answer.reached, answer.settled):
        given_times = [
            math.inf if t is None else t
            for t in (moment.earliest, moment.expected, moment.latest)
        ]
        assert given_times == sorted(given_times)
    if answer.settled.expected is not None:
        assert answer.reached.expected is not None
        assert answer.reached.expected <= answer.settled.expected
    assert answer.largest.least <= answer.largest.expected <= answer.largest.most
    assert any("further than 300 s" in note for note in answer.forecast.notes) == (
        horizon > 300
    )


@pytest.mark.parametrize(
    ("question", "message"),
    [
        ({"horizon": 0.0}, "the horizon is 0 s; give a positive time"),
        ({"horizon": math.inf}, "the horizon is inf s; give a positive time"),
        ({"horizon": 3601.0}, "the horizon is 3601 s; give at most 3600 s"),
        ({"times": (1.0,), "levels": (101.0,)}, "101 °C; give one from 0 to 100 °C"),
        ({"times": (-1.0,), "levels": (50.0,)}, "-1 s lies in the past"),
        ({"levels": (50.0,)}, "0 times and 1 set-points are given"),
        ({"level": math.inf}, "the level is inf; give a finite one"),
        ({"tolerance": 0.0}, "the tolerance is 0; give a positive one"),
    ],
)
def test_questions_without_an_answer_are_refused(
    outlook: Outlook, question: dict[str, Any], message: str
) -> None:
    with pytest.raises(ForecastError, match=message):
        what_if(outlook, Question(**question))


def test_a_snapshot_does_not_change_when_the_forecaster_continues() -> None:
    running = forecaster()
    snapshot = running.snapshot()
    before = what_if(snapshot.outlook(), Question((0.0,), (70.0,))).forecast
    for sample in samples_of(run(np.concatenate([PAST, np.repeat(80.0, 400)])))[
        PAST.size :
    ]:
        running.push(sample)
    running.enter([Candidate("other", 50.0, Peltier.model().parameters(), None)])
    after = what_if(snapshot.outlook("rig"), Question((0.0,), (70.0,))).forecast
    for band in ("output", "input"):
        for edge in ("mean", "low", "high"):
            np.testing.assert_array_equal(
                getattr(getattr(after, band), edge),
                getattr(getattr(before, band), edge),
            )
    assert running.snapshot().leader == "other"


def test_who_is_not_there_cannot_be_asked() -> None:
    with pytest.raises(
        ForecastError, match="there is no candidate yet; the first comes with"
    ):
        Forecaster(law_of(Peltier, 1.0)).snapshot().outlook()
    with pytest.raises(
        ForecastError, match="no candidate 'nobody'; at this sample there are: rig"
    ):
        forecaster().snapshot().outlook("nobody")


# What is read from a forecast, against closed solutions and runs of the plant.


def forecast(
    output: FloatArray, input: FloatArray, width: float = 0.0, period: float = 1.0
) -> Forecast:
    """A forecast whose bands reach `width` to both sides."""
    size = np.size(output)
    return Forecast(
        sample=100,
        candidate="twin_1",
        structure="held sink",
        confidence=CONFIDENCE,
        time=period * np.arange(1, size + 1),
        references=np.zeros(size),
        outputs=(Band(output, output - width, output + width),),
        inputs=(Band(input, input - width, input + width),),
    )


def test_a_lag_reaches_its_level_when_its_solution_does() -> None:
    """y = 40 + 20·(1 − e^(−t/10)); the band is 2 wide to both sides, the tolerance 0.5."""
    time = 0.1 * np.arange(1, 1201)
    lag_forecast = forecast(
        40 + 20 * (1 - np.exp(-time / 10)), np.zeros(time.size), 2.0, 0.1
    )

    def when(distance: float) -> float:
        return 10 * math.log(20 / distance)

    reached = time_to_reach(lag_forecast, 55.0, 0.5)
    assert reached.expected == pytest.approx(when(5.5), abs=0.11)
    assert reached.earliest == pytest.approx(when(7.5), abs=0.11)
    assert reached.latest == pytest.approx(when(3.5), abs=0.11)
    settled = settling_time(lag_forecast, 60.0, 1.0)
    assert settled.expected == pytest.approx(when(1.0), abs=0.11)
    assert settled.earliest == pytest.approx(when(3.0), abs=0.11)
    assert settled.latest is None  # a band of ±2 never fits into ±1
    assert time_to_reach(lag_forecast, 65.0, 0.5) == Moment(None, None, None)
    assert time_to_reach(lag_forecast, 61.5, 0.5).earliest is not None


def test_a_level_that_is_passed_between_two_samples_is_reached() -> None:
    falling = forecast(np.array([60.0, 55.0, 45.0, 30.0, 45.0]), np.zeros(5))
    assert time_to_reach(falling, 50.0, 0.1).expected == 3.0
    assert settling_time(falling, 50.0, 0.1).expected is None
    assert time_to_reach(falling, 60.0, 0.1) == Moment(1.0, 1.0, 1.0)


def test_an_overshoot_holds_only_behind_it() -> None:
    """The rig with too much integral gain: reached on the way up, held when it is back."""
    rig = Peltier.model().parameters()
    law = dataclasses.replace(law_of(Peltier, 1.0), integral=15.0)
    run = simulate_closed_loop(
        rig, np.full(200, 60.0), states=begin(rig, 40.0), law=law
    )
    overshooting = forecast(run.output, run.input)
    reached = time_to_reach(overshooting, 60.0, 0.2).expected
    settled = settling_time(overshooting, 60.0, 0.2).expected
    assert reached is not None
    assert settled is not None
    within = np.abs(run.output - 60.0) <= 0.2
    assert within[int(settled) - 1 :].all()
    assert not within[int(settled) - 2]
    assert run.output[: int(reached) - 1].max() < 59.8
    assert run.output.max() > 60.2
    assert settled > reached
    peak = largest_input(overshooting)
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
    band_forecast = forecast(mean, mean, width)
    inside = mean + width * rng.uniform(-1.0, 1.0, 60)
    inside[0] = mean[0]  # on the same side of the level
    for ask in (time_to_reach, settling_time):
        moment = ask(band_forecast, level, tolerance)
        own_time = ask(forecast(inside, inside), level, tolerance).expected
        for sooner, later in (
            (moment.earliest, moment.expected),
            (moment.expected, moment.latest),
        ):
            assert (sooner or math.inf) <= (later or math.inf)
        assert (moment.earliest or math.inf) <= (own_time or math.inf)
        if ask is settling_time or abs(mean[0] - level) > tolerance:
            assert (own_time or math.inf) <= (moment.latest or math.inf)
    peak = largest_input(band_forecast)
    assert peak.least <= peak.expected <= peak.most
    assert peak.least <= np.abs(inside).max() <= peak.most


def test_a_question_without_meaning_is_refused() -> None:
    flat = forecast(np.zeros(3), np.zeros(3))
    with pytest.raises(
        ForecastError, match="forecast of twin_1: the level is nan; give a finite one"
    ):
        time_to_reach(flat, math.nan, 0.1)
    for ask in (time_to_reach, settling_time):
        with pytest.raises(
            ForecastError, match="the tolerance is 0; give a positive one"
        ):
            ask(flat, 1.0, 0.0)


# The set-points a forecast is made for.

PLATE = Peltier.output
levels = st.floats(0.0, 100.0)


def test_a_held_set_point_stays() -> None:
    np.testing.assert_array_equal(SetPoints.constant(45, PLATE).ahead(1.0, 5), 45.0)


def test_steps_act_from_their_time_on() -> None:
    plan = SetPoints.planned([(0, 40), (3, 55.5), (4, 50)], before=30.0, signal=PLATE)
    np.testing.assert_array_equal(
        plan.ahead(1.0, 6), [40.0, 40.0, 55.5, 50.0, 50.0, 50.0]
    )
    later = SetPoints.planned([(2.5, 55)], before=30.0)
    np.testing.assert_array_equal(later.ahead(1.0, 4), [30.0, 30.0, 55.0, 55.0])


def test_a_step_is_not_missed_for_a_rounding() -> None:
    """3·0.1 is above 0.3, and 7·0.1 below 0.7 as 0.7000000000000001: both are their rows' sample."""
    for samples in range(1, 200):
        plan = SetPoints.planned([(samples / 10, 1.0)], before=0.0)
        assert np.flatnonzero(plan.ahead(0.1, 250))[0] == samples - 1


def test_ramps_go_in_straight_lines_from_now_on() -> None:
    plan = SetPoints.planned([(4, 50), (6, 40)], before=30.0, ramps=True, signal=PLATE)
    np.testing.assert_allclose(
        plan.ahead(1.0, 8), [35.0, 40.0, 45.0, 50.0, 45.0, 40.0, 40.0, 40.0]
    )


def test_it_is_read_from_a_csv() -> None:
    """With header, comments and empty lines; as numpy reads the same numbers."""
    lines = ["time,set-point", "# warm up", "", "10, 40", "20.5,55", "30,50"]
    plan = SetPoints.planned(lines, before=30.0, signal=PLATE)
    table = np.loadtxt(lines[2:], delimiter=",")
    np.testing.assert_array_equal(np.stack([plan.times, plan.levels], axis=1), table)
    assert SetPoints.planned(list(csv.reader(lines)), before=30.0, signal=PLATE) == plan
    assert (
        SetPoints.planned(["10; 40", "20.5\t55", "30,50"], before=30.0, signal=PLATE)
        == plan
    )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SetPoints.planned([], 30.0), "it has no row; give at least one"),
        (lambda: SetPoints.planned(["time,level"], 30.0), "it has no row"),
        (lambda: SetPoints.planned(["1,2,3"], 30.0), "line 1: '1, 2, 3' is not a pair of numbers"),
        (lambda: SetPoints.planned(["1,2", "", "soon,3"], 30.0), "line 3: 'soon, 3' is not a pair"),
        (lambda: SetPoints.planned([(-1, 40)], 30.0), "row 1: -1 s lies in the past; give seconds"),
        (lambda: SetPoints.planned([(5, 40), (5, 41)], 30.0), "row 2: its time 5 s is not after"),
        (lambda: SetPoints.planned([(math.inf, 40)], 30.0), "row 1: the time is inf s; give a finite time"),
        (lambda: SetPoints.planned([(1, math.nan)], 30.0), "row 1: the set-point is nan; give a finite"),
        (
            lambda: SetPoints.planned([(1, 40), (2, 120)], 30.0, signal=PLATE),
            "row 2: the set-point is 120 °C; give one from 0 to 100 °C, the range of the plant's set-points",
        ),
        (lambda: SetPoints.constant(-5.0, PLATE), "the set-point now is -5 °C; give one from 0 to 100 °C"),
        (lambda: SetPoints.constant(900.0, Motor.output), "is 900 rad/s; give one from -500 to 500 rad/s"),
        (lambda: SetPoints(30.0, (1.0,), ()), "1 times and 0 set-points are given; give one"),
        (lambda: SetPoints.constant(30.0).ahead(0.0, 5), "5 samples every 0 s requested; give positive"),
        (lambda: SetPoints.recorded([], 1.0), "there is no set-point; give at least that of the newest"),
    ],
)  # fmt: skip
def test_a_faulty_profile_is_one_clear_line(
    make: Callable[[], object], message: str
) -> None:
    with pytest.raises(ForecastError) as caught:
        make()
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unusual_set_point_is_noted() -> None:
    assert SetPoints.constant(45.0, PLATE).notes == ()
    assert SetPoints.planned([(5, 95)], 45.0, signal=PLATE).notes == (
        "A set-point of 95 °C is outside the usual range of 20 to 90 °C.",
    )


@given(
    reference=st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=40),
    period=st.floats(0.01, 100.0),
)
def test_recorded_set_points_come_back(reference: list[float], period: float) -> None:
    """Also those that no plan could hold: what was recorded was."""
    levels = SetPoints.recorded(reference, period).ahead(period, len(reference) - 1)
    np.testing.assert_array_equal(levels, reference[1:])


@given(
    rows=st.lists(
        st.tuples(st.floats(0.0, 50.0), levels),
        min_size=1,
        max_size=8,
        unique_by=lambda r: r[0],
    ),
    before=levels,
    ramps=st.booleans(),
)
def test_it_stays_between_its_set_points_and_ends_at_the_last(
    rows: list[tuple[float, float]], before: float, ramps: bool
) -> None:
    rows = sorted(rows)
    plan = SetPoints.planned(rows, before, ramps=ramps, signal=PLATE)
    planned_levels = plan.ahead(0.5, 120)
    named = [before, *(level for _, level in rows)]
    assert min(named) - 1e-9 <= planned_levels.min()
    assert planned_levels.max() <= max(named) + 1e-9
    np.testing.assert_array_equal(planned_levels[100:], rows[-1][1])
    if not ramps:
        assert set(planned_levels.tolist()) <= set(named)
