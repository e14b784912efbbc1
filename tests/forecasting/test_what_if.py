"""Questions about what comes, against the plant that was asked about."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.comparing import Candidate
from twinmatch.dynamics import begin, gains_of, simulate_closed_loop
from twinmatch.forecasting import NEAR, ForecastError, Moment, Outlook, Question, what_if
from twinmatch.plants import Peltier
from twinmatch.sessions import samples_of
from twinmatch.signals import FloatArray, Window
from twinmatch.twin import Forecaster

RIG = Peltier.model("sink with mass").parameters()
PAST = np.repeat([35.0, 50.0], 200)
SECONDS = 300


def run(reference: FloatArray) -> Window:
    """The plant without noise."""
    made = simulate_closed_loop(RIG, reference, states=begin(RIG, 22.85))
    return Window(reference, made.output, made.input)


def forecaster() -> Forecaster:
    """One candidate, the plant itself, after `PAST`."""
    made = Forecaster(gains_of(Peltier, 1.0))
    made.enter([Candidate("rig", 50.0, RIG, None)])
    for sample in samples_of(run(PAST)):
        made.push(sample)
    return made


@pytest.fixture(scope="module")
def outlook() -> Outlook:
    return forecaster().outlook()


def test_the_answer_is_what_the_plant_then_does(outlook: Outlook) -> None:
    """To 62 °C in a ramp of 40 s, and 70 s later back: output, control, arrival and largest control."""
    question = Question((40.0, 110.0, 110.5), (62.0, 62.0, 50.0), ramps=True, level=62.0, tolerance=0.5)
    ahead = np.arange(1.0, SECONDS + 1)
    reference = np.interp(ahead, [0.0, 40.0, 110.0, 110.5], [50.0, 62.0, 62.0, 50.0])
    came = run(np.concatenate([PAST, reference])).part(PAST.size, PAST.size + SECONDS - 1)
    answer = what_if(outlook, question)
    assert answer.forecast.sample == PAST.size - 1
    np.testing.assert_allclose(answer.forecast.reference, reference, atol=1e-12)
    # The observer has come within a hundredth of a degree of the states; the loop forgets the rest.
    np.testing.assert_allclose(answer.forecast.output.mean, came.output, atol=0.02)
    np.testing.assert_allclose(answer.forecast.input.mean, came.input, atol=1.0)
    there = ahead[np.abs(came.output - 62.0) <= 0.5]
    assert answer.reached.expected == pytest.approx(there[0], abs=1.0)
    assert answer.settled == Moment(None, None, None)
    assert answer.largest.expected == pytest.approx(np.abs(came.input).max(), abs=1.0)


def test_an_empty_question_asks_what_comes_if_nothing_is_changed(outlook: Outlook) -> None:
    answer = what_if(outlook, Question())
    assert set(answer.forecast.reference) == {50.0}
    assert answer.forecast.time[-1] == SECONDS
    assert (answer.level, answer.tolerance) == (50.0, NEAR * Peltier.output.noise)
    expected = outlook.forecast(np.full(SECONDS, 50.0))
    np.testing.assert_array_equal(answer.forecast.output.mean, expected.output.mean)
    np.testing.assert_array_equal(answer.forecast.input.high, expected.input.high)


def test_a_session_that_went_beyond_the_limits_can_be_asked_how_it_continues(outlook: Outlook) -> None:
    """Only what is asked for is checked, not the set-point that stands."""
    beyond = replace(outlook, sample=replace(outlook.sample, reference=150.0))
    assert set(what_if(beyond, Question()).forecast.reference) == {150.0}


LEVELS = st.lists(st.floats(20.0, 90.0), min_size=1, max_size=4)


@given(LEVELS, st.booleans(), st.integers(1, 400), st.floats(0.1, 5.0))
def test_answers_are_in_order(
    outlook: Outlook, levels: list[float], ramps: bool, horizon: int, tolerance: float
) -> None:
    """Earliest before expected before latest, reached before held, least below expected below most."""
    times = tuple(30.0 * k for k in range(1, len(levels) + 1))
    answer = what_if(outlook, Question(times, tuple(levels), ramps, float(horizon), tolerance=tolerance))
    assert answer.forecast.time.size == horizon
    assert answer.level == levels[-1]
    for moment in (answer.reached, answer.settled):
        given_times = [
            math.inf if t is None else t for t in (moment.earliest, moment.expected, moment.latest)
        ]
        assert given_times == sorted(given_times)
    if answer.settled.expected is not None:
        assert answer.reached.expected is not None
        assert answer.reached.expected <= answer.settled.expected
    assert answer.largest.least <= answer.largest.expected <= answer.largest.most
    assert any("further than 300 s" in note for note in answer.forecast.notes) == (horizon > 300)


@pytest.mark.parametrize(
    ("question", "said"),
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
def test_questions_without_an_answer(outlook: Outlook, question: dict[str, Any], said: str) -> None:
    with pytest.raises(ForecastError, match=said):
        what_if(outlook, Question(**question))


def test_a_snapshot_does_not_change_when_the_forecaster_continues() -> None:
    made = forecaster()
    snapshot = made.snapshot()
    before = what_if(snapshot.outlook(), Question((0.0,), (70.0,))).forecast
    for sample in samples_of(run(np.concatenate([PAST, np.repeat(80.0, 400)])))[PAST.size :]:
        made.push(sample)
    made.enter([Candidate("other", 50.0, Peltier.model().parameters(), None)])
    after = what_if(snapshot.outlook("rig"), Question((0.0,), (70.0,))).forecast
    for band in ("output", "input"):
        for edge in ("mean", "low", "high"):
            np.testing.assert_array_equal(
                getattr(getattr(after, band), edge), getattr(getattr(before, band), edge)
            )
    assert made.snapshot().leader == "other"


def test_who_is_not_there_cannot_be_asked() -> None:
    with pytest.raises(ForecastError, match="there is no candidate yet; the first comes with"):
        Forecaster(gains_of(Peltier, 1.0)).snapshot().outlook()
    with pytest.raises(ForecastError, match="no candidate 'nobody'; at this sample there are: rig"):
        forecaster().snapshot().outlook("nobody")
