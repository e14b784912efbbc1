"""Steps and trends between sessions, on rigs whose changes are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.lessons import (
    HOUR,
    KINDS,
    LivedRig,
    Told,
    lesson,
    lived_rig,
    told_of,
)
from twinmatch.memory import Lesson, ParameterChange, report_on, shared_structure
from twinmatch.memory.changes import histories_of
from twinmatch.plants import Peltier

HELD = Peltier.model("held sink")
RICH = Peltier.model("sink with mass, free ambient, switched drive")


def lessons(
    conductances: list[float], deviation: float = 0.01, days: float = 1.0
) -> list[Lesson]:
    """Lessons of the plate alone with these conductances, so many days apart."""
    covariance = np.diag([0.002, deviation, 1.0]) ** 2
    return [
        lesson(
            n,
            HELD.structure_name,
            began=round(n * days * 24 * HOUR),
            free=HELD.structure.free,
            covariance=tuple(map(tuple, covariance.tolist())),
            parameters={
                **HELD.parameters(),
                "seebeck": 0.06,
                "conductance": value,
                "heat_capacity": 30.0,
            },
        )
        for n, value in enumerate(conductances)
    ]


def test_what_has_changed_on_simulated_rigs_is_named_and_nothing_else():
    outcomes: dict[str, list[tuple[LivedRig, Told]]] = {}
    looks = false = 0
    for kind in KINDS:
        for seed in range(10):
            rig = lived_rig(seed, kind)
            rig_outcome = told_of(rig)
            outcomes.setdefault(kind, []).append((rig, rig_outcome))
            looks = looks + rig_outcome.looks
            false = false + rig_outcome.false
    assert false <= 0.02 * looks
    steps = [
        (rig, outcome) for rig, outcome in outcomes["step"] if outcome.first is not None
    ]
    assert sum(outcome.first - rig.since <= 2 for rig, outcome in steps) >= 8
    assert all(outcome.kind == "step" for _, outcome in steps)
    sizes = [abs(outcome.size) for _, outcome in steps]
    assert np.median(sizes) == pytest.approx(0.10, abs=0.015)
    drifts = [outcome for _, outcome in outcomes["drift"] if outcome.first is not None]
    assert len(drifts) >= 9
    assert np.median([outcome.first for outcome in drifts]) <= 6
    assert sum(outcome.kind == "trend" for outcome in drifts) >= 7


def test_a_step_is_said_with_its_session_size_and_values():
    (change,) = report_on(
        lessons([0.75, 0.76, 0.74, 0.75, 0.84, 0.83, 0.85]), HELD
    ).changes
    assert change.sentence == (
        "since run_4 the thermal conductance is 12 % higher (0.75 → 0.84 W/K); before and after it was steady"
    )
    assert change.size == pytest.approx(0.84 / 0.75 - 1.0, abs=0.01)


def test_a_trend_is_said_with_its_rate_and_when_it_leaves_the_range():
    values = (1.6 * 1.01 ** np.arange(12)).tolist()
    (change,) = report_on(lessons(values, 0.004), HELD).changes
    assert change.sentence.startswith(
        "the thermal conductance rises by 1 % a day: at this rate it leaves the range"
    )
    expected, low, high = change.leaves
    assert expected == pytest.approx(
        math.log(2.0 / values[-1]) / math.log(1.01), rel=0.1
    )  # bound of the plant file
    assert low < expected < high


def test_sessions_without_dates_drift_by_session():
    undated = lessons((0.9 * 0.99 ** np.arange(12)).tolist(), 0.004, days=0.0)
    (change,) = report_on(undated, HELD).changes
    assert "falls by 1 % a session" in change.sentence
    # its lower bound is zero, and never reached at a constant rate
    assert "90 %" not in change.sentence


def test_one_odd_session_changes_nothing():
    odd = lessons([0.75, 0.76, 0.74, 1.30, 0.75, 0.76, 0.74])
    report = report_on(odd, HELD)
    assert report.changes == []
    assert "between these 7 sessions nothing has changed" in report.sentence


def test_two_steps_are_two():
    report = report_on(
        lessons(
            [0.65, 0.66, 0.64, 0.65, 0.85, 0.84, 0.86, 0.85, 0.77, 0.76, 0.78, 0.77]
        ),
        HELD,
    )
    assert [(change.kind, change.since) for change in report.changes] == [
        ("step", "run_4"),
        ("step", "run_8"),
    ]


def test_what_only_a_ratio_shows_is_named_as_the_ratio():
    rng = np.random.default_rng(3)
    lessons = []
    for n in range(8):
        # α and C together: an hour does not tell them apart
        valley = math.exp(rng.normal(0.0, 0.3))
        values = {
            "seebeck": 0.06 * valley * (1.0 if n < 4 else 1.06),
            "heat_capacity": 30.0 * valley,
        }
        relative = np.array(
            [[0.09, 0.0, 0.09], [0.0, 1e-4, 0.0], [0.09, 0.0, 0.09 + 2.5e-5]]
        )
        scale = np.array([values["seebeck"], 0.75, values["heat_capacity"]])
        covariance = relative * np.outer(scale, scale)
        parameters = {
            **HELD.parameters(),
            **values,
            "conductance": 0.75 + rng.normal(0.0, 0.005),
        }
        lessons.append(
            lesson(n, HELD.structure_name, free=HELD.structure.free, parameters=parameters,
                   covariance=tuple(map(tuple, covariance.tolist())))
        )  # fmt: skip
    (change,) = report_on(lessons, HELD).changes
    assert change.name == "seebeck / heat_capacity"
    assert change.since == "run_4"
    assert change.size == pytest.approx(0.06, abs=0.01)
    assert (
        "ratio of Seebeck coefficient and heat capacity of the plate" in change.sentence
    )


def test_few_sessions_are_not_judged():
    report = report_on(lessons([0.75, 0.76, 0.95]), HELD)
    assert report.changes == []
    assert (
        report.sentence
        == "what changes shows from 4 sessions on, and only 3 can be compared"
    )


def test_the_room_is_another_one_every_session_and_is_not_named():
    report = report_on(lived_rig(5, "steady").lessons, RICH)
    assert report.restless == ["temperature of the room"]
    assert report.sentence.endswith(
        "another one in every session: the temperature of the room"
    )


def test_sessions_are_compared_in_the_structure_that_led():
    led = [lesson(n, "b", led=n > 0) for n in range(3)]
    assert (
        shared_structure(
            [*led, *(lesson(n, "a", led=False) for n in range(3)), lesson(0, "c")]
        )
        == "b"
    )
    assert shared_structure([]) == ""


@settings(max_examples=25, deadline=None)
@given(unit=st.floats(1e-3, 1e3), seed=st.integers(0, 1000))
def test_the_unit_of_a_parameter_changes_nothing(unit, seed):
    plain = np.random.default_rng(seed).normal(0.75, 0.02, 9)
    plain[5:] *= 1.1
    evidence = []
    for factor in (1.0, unit):
        history = next(
            h
            for h in histories_of(lessons(plain.tolist()), HELD)
            if h.name == "conductance"
        )
        scaled = history._replace(values=history.values * factor)
        evidence.append(np.diff(scaled.levels))
    assert evidence[0] == pytest.approx(evidence[1], abs=1e-9)


def test_a_long_memory_is_compared_as_far_as_the_newest_sessions():
    report = report_on(lessons([0.5] * 30 + [0.75] * 70), HELD)
    assert len(report.lessons) == 60
    assert report.changes == []


def test_a_change_of_a_temperature_has_its_unit():
    change = ParameterChange(
        "ambient", "temperature of the room", "K", "step", "b", "a", 290.0, 293.0, relative=False, size=3.0,
        error=0.1, evidence=9.0,
    )  # fmt: skip
    assert "is 3 K higher (290 → 293 K)" in change.sentence
