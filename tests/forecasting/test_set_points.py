"""The set-points a forecast is made for."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.plants import Motor
from twinmatch.forecasting import ForecastError, SetPoints
from twinmatch.plants import Peltier

PLATE = Peltier.output
levels = st.floats(0.0, 100.0)


def test_a_held_set_point_stays() -> None:
    np.testing.assert_array_equal(SetPoints.constant(45, PLATE).ahead(1.0, 5), 45.0)


def test_steps_act_from_their_time_on() -> None:
    plan = SetPoints.planned([(0, 40), (3, 55.5), (4, 50)], before=30.0, signal=PLATE)
    assert plan.reference(0.0) == 40.0
    np.testing.assert_array_equal(plan.ahead(1.0, 6), [40.0, 40.0, 55.5, 50.0, 50.0, 50.0])
    later = SetPoints.planned([(2.5, 55)], before=30.0)
    np.testing.assert_array_equal(later.ahead(1.0, 4), [30.0, 30.0, 55.0, 55.0])


def test_a_step_is_not_missed_for_a_rounding() -> None:
    """3·0.1 is above 0.3, and 7·0.1 below 0.7 as 0.7000000000000001: both are their rows' sample."""
    for samples in range(1, 200):
        plan = SetPoints.planned([(samples / 10, 1.0)], before=0.0)
        assert np.flatnonzero(plan.ahead(0.1, 250))[0] == samples - 1


def test_ramps_go_in_straight_lines_from_now_on() -> None:
    plan = SetPoints.planned([(4, 50), (6, 40)], before=30.0, ramps=True, signal=PLATE)
    np.testing.assert_allclose(plan.ahead(1.0, 8), [35.0, 40.0, 45.0, 50.0, 45.0, 40.0, 40.0, 40.0])


def test_it_is_read_from_a_csv() -> None:
    """With header, comments and empty lines; as numpy reads the same numbers."""
    lines = ["time,set-point", "# warm up", "", "10, 40", "20.5,55", "30,50"]
    plan = SetPoints.planned(lines, before=30.0, signal=PLATE)
    table = np.loadtxt(lines[2:], delimiter=",")
    np.testing.assert_array_equal(np.stack([plan.times, plan.levels], axis=1), table)
    assert SetPoints.planned(list(csv.reader(lines)), before=30.0, signal=PLATE) == plan
    assert SetPoints.planned(["10; 40", "20.5\t55", "30,50"], before=30.0, signal=PLATE) == plan


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
def test_a_faulty_profile_is_one_clear_line(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ForecastError) as caught:
        make()
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unusual_set_point_is_noted() -> None:
    assert SetPoints.constant(45.0, PLATE).notes == ()
    assert SetPoints.planned([(5, 95)], 45.0, signal=PLATE).notes == (
        "A set-point of 95 °C is outside the usual range of 20 to 90 °C.",
    )


@given(reference=st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=40), period=st.floats(0.01, 100.0))
def test_recorded_set_points_come_back(reference: list[float], period: float) -> None:
    """Also those that no plan could hold: what was recorded was."""
    found = SetPoints.recorded(reference, period).ahead(period, len(reference) - 1)
    np.testing.assert_array_equal(found, reference[1:])


@given(
    rows=st.lists(st.tuples(st.floats(0.0, 50.0), levels), min_size=1, max_size=8, unique_by=lambda r: r[0]),
    before=levels,
    ramps=st.booleans(),
)
def test_it_stays_between_its_set_points_and_ends_at_the_last(
    rows: list[tuple[float, float]], before: float, ramps: bool
) -> None:
    rows = sorted(rows)
    plan = SetPoints.planned(rows, before, ramps=ramps, signal=PLATE)
    found = plan.ahead(0.5, 120)
    named = [before, *(level for _, level in rows)]
    assert min(named) - 1e-9 <= found.min()
    assert found.max() <= max(named) + 1e-9
    np.testing.assert_array_equal(found[100:], rows[-1][1])
    if not ramps:
        assert set(found.tolist()) <= set(named)
