"""When will it be there, and when must one begin: against the plant that was asked about."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.support.plants import Lag
from twinmatch.comparing import Candidate
from twinmatch.dynamics import begin, law_of, simulate_closed_loop, simulate_driven
from twinmatch.forecasting import ArrivalQuestion, ForecastError, Outlook, arrival
from twinmatch.plants import Peltier
from twinmatch.sessions import samples_of
from twinmatch.signals import FloatArray, Window
from twinmatch.twin import Forecaster

RIG = Peltier.model("sink with mass").parameters()
PAST = np.repeat([35.0, 50.0], 200)
LAG = Lag.model().parameters(gain=2.0, lag=50.0)
STOOD = np.repeat([0.0, 1.0], [50, 200])


def run(reference: FloatArray) -> FloatArray:
    """Output of the rig under set-points, without noise."""
    return simulate_closed_loop(RIG, reference, states=begin(RIG, 22.85)).output


@pytest.fixture(scope="module")
def closed() -> Outlook:
    """The rig itself, held at 50 °C."""
    simulated = simulate_closed_loop(RIG, PAST, states=begin(RIG, 22.85))
    forecaster = Forecaster(law_of(Peltier, 1.0))
    forecaster.enter([Candidate("rig", 50.0, RIG, None)])
    for sample in samples_of(Window(PAST, simulated.output, simulated.input)):
        forecaster.push(sample)
    return forecaster.outlook()


@pytest.fixture(scope="module")
def driven() -> Outlook:
    """A lag of 50 s with a gain of 2, driven by 1 V: it stands at nearly 2 m."""
    response = simulate_driven(LAG, STOOD, states=begin(LAG, 0.0))
    forecaster = Forecaster(None)
    forecaster.enter([Candidate("lag", 2.0, LAG, None)])
    for sample in samples_of(Window(response.output, response.output, STOOD)):
        forecaster.push(sample)
    return forecaster.outlook()


def test_a_known_loop_is_there_when_the_plant_is_and_not_before(
    closed: Outlook,
) -> None:
    """To 62 °C within 300 s: with the latest set-point the plant comes in time, 10 s later it does not."""
    answer = arrival(closed, ArrivalQuestion(62.0, by=300.0, tolerance=0.5))
    assert answer.held.expected is None
    assert answer.move == 62.0
    came = run(np.concatenate([PAST, np.full(300, 62.0)]))[PAST.size :]
    first = 1.0 + int(np.argmax(came >= 61.5))
    assert answer.moved.expected == pytest.approx(first, abs=1.0)
    assert answer.beginning is not None
    assert answer.beginning.expected is not None
    assert answer.beginning.safe is not None
    assert answer.beginning.safe <= answer.beginning.expected
    for late, is_there in ((0, True), (10, False)):
        delay = round(answer.beginning.expected) - 1 + late
        ahead = np.concatenate([np.full(delay, 50.0), np.full(300 - delay, 62.0)])
        assert (run(np.concatenate([PAST, ahead]))[-1] >= 61.5) == is_there


def test_an_unknown_loop_is_asked_with_the_input_held_and_with_the_drive_at_its_end(
    driven: Outlook,
) -> None:
    """2 m are never 8 m under 1 V; under 10 V, 20 m are far, so it takes lag · ln(18 / 12.1)."""
    answer = arrival(driven, ArrivalQuestion(8.0, by=120.0, tolerance=0.1))
    assert answer.standing == 1.0
    assert answer.held.expected is None
    assert answer.move == 10.0
    now = driven.sample.output
    expected = 50.0 * np.log((20.0 - now) / (20.0 - 7.9))
    assert answer.moved.expected == pytest.approx(expected, abs=1.5)
    assert answer.beginning is not None
    assert answer.beginning.expected == pytest.approx(120.0 - expected, abs=2.0)
    down = arrival(driven, ArrivalQuestion(-3.0, tolerance=0.1))
    assert down.move == -10.0
    given = arrival(driven, ArrivalQuestion(8.0, move=5.0, tolerance=0.1))
    assert given.moved.expected is not None
    assert answer.moved.expected is not None
    assert given.moved.expected > answer.moved.expected


def test_what_cannot_be_reached_in_time_says_so(driven: Outlook) -> None:
    answer = arrival(driven, ArrivalQuestion(8.0, by=10.0))
    assert answer.beginning is not None
    assert answer.beginning.expected is None
    assert answer.beginning.safe is None


def test_an_output_that_only_passes_the_level_is_not_there(closed: Outlook) -> None:
    """From 50 °C, with 45 °C asked for and a set-point of 35 °C that passes it on its way."""
    falling = dataclasses.replace(
        closed, sample=dataclasses.replace(closed.sample, references=(35.0,))
    )
    answer = arrival(falling, ArrivalQuestion(45.0, by=600.0))
    assert answer.held.expected is not None
    assert answer.held.expected < 60.0
    assert answer.beginning is not None
    assert answer.beginning.expected is not None
    assert answer.beginning.expected > 500.0


@pytest.mark.parametrize("by", [0.0, -5.0, 1e9, float("nan")])
def test_a_time_that_is_not_ahead_is_refused(driven: Outlook, by: float) -> None:
    with pytest.raises(
        ForecastError, match=r"the time is .* ahead; give one of 1 to 3600 s"
    ):
        arrival(driven, ArrivalQuestion(8.0, by=by))


def test_a_level_that_is_not_a_number_is_refused(driven: Outlook) -> None:
    with pytest.raises(ForecastError, match="the level is nan"):
        arrival(driven, ArrivalQuestion(float("nan")))
