"""A level that is to be reached: on the page, as metrics and over MQTT, and asked of a twin."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

pytest.importorskip(
    "bokeh", reason="bokeh is not installed; it is in the extra 'dashboard'"
)
pytest.importorskip(
    "paho", reason="paho is not installed; it is in the extra 'outlets'"
)
pytest.importorskip("prometheus_client", reason="it is in the extra 'outlets'")

from tests.showing.page.test_metrics import number_key, numbers
from tests.support.plants import Lag
from twinmatch.comparing import Candidate
from twinmatch.dynamics import begin, simulate_driven
from twinmatch.forecasting import MAX_SAMPLES, Moment, Outlook
from twinmatch.launching.shown import RunShown
from twinmatch.offline.clock_times import ClockTimeError, seconds_until
from twinmatch.plants import Peltier
from twinmatch.plants.records import description_of
from twinmatch.sessions import samples_of
from twinmatch.showing.page import panels
from twinmatch.showing.page.goal import Goal, GoalAnswer, answer_of, soonest
from twinmatch.showing.page.mqtt_outlet import messages_of
from twinmatch.showing.page.state import DashboardState
from twinmatch.signals import Window
from twinmatch.twin import Forecaster, TwinSettings

LAG = Lag.model().parameters(gain=2.0, lag=50.0)
STOOD = np.repeat([0.0, 1.0], [50, 200])
NEVER = Moment(None, None, None)
SOON = Moment(600.0, 540.0, 700.0)
MORNING = 1_772_343_000 * 10**9
"""A stamp with a date, ns."""


def forecaster() -> Forecaster:
    """A lag of 50 s with a gain of 2, driven by 1 V, with the loop not known."""
    response = simulate_driven(LAG, STOOD, states=begin(LAG, 0.0))
    taught = Forecaster(None)
    taught.enter([Candidate("lag", 2.0, LAG, None)])
    for sample in samples_of(Window(response.output, response.output, STOOD)):
        taught.push(sample)
    return taught


@pytest.fixture(scope="module")
def outlook() -> Outlook:
    return forecaster().outlook()


def test_a_twin_is_asked_under_what_stands_and_under_both_ends_of_the_drive(
    outlook: Outlook,
) -> None:
    answer = answer_of(Goal(8.0), outlook)
    assert answer.held == NEVER
    assert answer.move == 10.0
    now = outlook.sample.output
    # From there to 7.9 m, a tolerance of ten times the noise, on the way to 20 m.
    assert answer.moved.expected == pytest.approx(
        50.0 * np.log((20.0 - now) / 12.1), abs=1.5
    )
    assert math.isnan(answer.begin)
    assert answer_of(Goal(-3.0), outlook).move == -10.0


def test_one_begins_as_much_before_as_the_latest_edge_of_the_band_takes() -> None:
    goal = Goal(60.0, "23:59")
    answer = soonest(goal, NEVER, {0.0: NEVER, 100.0: SOON}, MORNING)
    assert answer.move == 100.0
    assert answer.begin == pytest.approx(seconds_until("23:59", MORNING) - 700.0)
    assert math.isnan(GoalAnswer(goal, NEVER, 100.0, NEVER, MORNING).begin)
    # samples without a date
    assert math.isnan(GoalAnswer(goal, NEVER, 100.0, SOON, 5).begin)


@pytest.mark.parametrize(
    ("level", "by", "message"),
    [
        (math.nan, "", "finite level"),
        (60.0, "soon", "is not a time"),
        (60.0, "+60", "a time of day"),
    ],
)
def test_what_is_not_a_goal_is_refused(level: float, by: str, message: str) -> None:
    with pytest.raises(ClockTimeError, match=message):
        Goal(level, by)


def test_moments_of_a_fast_plant_have_the_decimals_of_its_period() -> None:
    moved = Moment(0.123, 0.118, 0.131)
    answer = GoalAnswer(Goal(8.0), NEVER, 10.0, moved, MORNING)
    assert answer.lines("rad/s", 0.005) == (
        f"8 rad/s: not within {MAX_SAMPLES} samples if nothing is changed",
        "8 rad/s: in 0.123 s (0.118 to 0.131) with 10 from now on",
    )
    assert "in 0.1 s (0.1 to 0.1)" in answer.lines("rad/s", 0.1)[1]


def test_it_is_on_the_page_a_metric_and_an_entity() -> None:
    state = DashboardState(described=description_of(Peltier))
    assert panels.goal(state) == ""
    assert number_key("reach_seconds", "60", "moved", "latest") not in numbers(state)
    before = messages_of(state, "rig", "Rig")
    assert not any("reached" in topic for topic in before)
    state.push_goal(
        GoalAnswer(Goal(60.0, "23:59"), Moment(None, 900.0, None), 60.0, SOON, MORNING)
    )
    shown = panels.goal(state)
    assert "60 °C: in 600 s (540 to 700) with 60 from now on" in shown
    assert "to be there by 23:59: begin in " in shown
    found = numbers(state)
    assert found[number_key("reach_seconds", "60", "held", "earliest")] == 900.0
    assert number_key("reach_seconds", "60", "held", "expected") not in found
    assert found[number_key("reach_seconds", "60", "moved", "latest")] == 700.0
    assert found[number_key("begin_seconds", "60", "23:59")] > 0.0
    messages = messages_of(state, "rig", "Rig")
    document = json.loads(messages["twinmatch/rig/state"])
    assert document["reach"] == 60.0
    assert document["reached_if_moved"] == {
        "expected": 600.0,
        "earliest": 540.0,
        "latest": 700.0,
    }
    assert document["begin"] > 0
    config = json.loads(
        messages["homeassistant/sensor/twinmatch_rig_reached_if_moved/config"]
    )
    assert config["name"] == "60 °C if begun now in"
    assert config["unit_of_measurement"] == "s"
    assert config["value_template"] == "{{ value_json.reached_if_moved.expected }}"
    assert "homeassistant/sensor/twinmatch_rig_begin/config" in messages


def test_a_run_in_one_process_asks_its_leader() -> None:
    """Before there is one nothing is shown; then the answer is."""
    shown = RunShown(TwinSettings.of(Lag, period=1.0, law=None), None, None, Goal(8.0))
    shown.tell()
    assert shown.state.goal is None
    shown = RunShown(TwinSettings.of(Lag, period=1.0, law=None), None, None, Goal(8.0))
    shown.ask_from(forecaster().snapshot())
    shown.tell()
    assert shown.state.goal is not None
    assert shown.state.goal.move == 10.0
