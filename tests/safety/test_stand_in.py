"""When an estimate may stand in for a sensor."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.safety import StandIn
from twinmatch.safety.stand_in import LASTING, PATIENCE


@pytest.fixture
def accused() -> StandIn:
    stand_in = StandIn("temperature", 85.0, "°C")
    stand_in.take(40.0, 0.5, 1.0, 9.5)
    stand_in.accuse(10.0)
    return stand_in


def test_a_sensor_that_is_believed_is_taken_whatever_is_estimated() -> None:
    stand_in = StandIn("temperature", 85.0, "°C")
    stand_in.take(40.0, 0.5, 1.0, 9.5)
    assert math.isnan(stand_in.look(10.0).value)
    assert stand_in.look(1e6).trouble == ""


def test_the_estimate_is_taken_once_the_accusation_has_lasted_until_the_sensor_is_given_back(
    accused: StandIn,
) -> None:
    lasted = 10.0 + LASTING
    accused.take(40.0, 0.6, 1.0, lasted - 0.1)
    value, trouble = accused.look(lasted - 0.1)
    assert math.isnan(value)
    assert trouble == ""
    accused.take(41.0, 0.6, 1.0, lasted)
    assert accused.look(lasted) == (41.0, "")
    accused.give_back()
    assert math.isnan(accused.look(lasted + 0.5).value)
    assert accused.look(1e6).trouble == ""


def test_silence_gives_nothing_back(accused: StandIn) -> None:
    value, trouble = accused.look(10.1 + PATIENCE)
    assert math.isnan(value)
    assert (
        trouble
        == "temperature is not believed, and there is no estimate; measure it and clear this"
    )


@pytest.mark.parametrize(
    ("value", "band"), [(math.nan, 0.5), (math.inf, 0.5), (40.0, 1.1), (40.0, math.nan)]
)
def test_an_estimate_that_is_useless_is_not_taken(
    accused: StandIn, value: float, band: float
) -> None:
    accused.take(value, band, 1.0, 13.0)
    assert math.isnan(accused.look(13.0).value)
    assert "wide" in accused.look(13.0).trouble


def test_the_limit_of_the_guard_holds_for_the_estimate(accused: StandIn) -> None:
    accused.take(85.1, 0.5, 1.0, 10.5)
    assert accused.look(10.5).trouble == "temperature is estimated at 85.1 °C"


def test_the_first_estimate_may_come_a_little_after_the_accusation() -> None:
    stand_in = StandIn("temperature", 85.0, "°C")
    stand_in.accuse(10.0)
    assert stand_in.look(10.0 + PATIENCE).trouble == ""
    assert stand_in.look(10.1 + PATIENCE).trouble
    stand_in.take(40.0, 0.5, 1.0, 10.1 + LASTING)
    assert stand_in.look(10.1 + LASTING) == (40.0, "")


@given(
    st.lists(
        st.tuples(st.floats(0.0, 1.5), st.floats(-50.0, 150.0), st.floats(0.0, 2.0)),
        max_size=8,
    ),
    st.floats(0.0, 30.0),
)
def test_what_is_taken_is_a_fresh_estimate_within_its_limits(
    estimates: list[tuple[float, float, float]], late: float
) -> None:
    """Whatever was estimated: the law never gets a value beyond the limit, too old, or of too wide a band."""
    stand_in = StandIn("temperature", 85.0, "°C")
    time = 10.0
    stand_in.accuse(time)
    for pause, value, band in estimates:
        time += LASTING * pause
        stand_in.take(value, band, 1.0, time)
    value, trouble = stand_in.look(time + late)
    if not math.isnan(value):
        assert time + late - 10.0 >= LASTING
        assert (value, trouble) == (estimates[-1][1], "")
        assert value <= 85.0
        assert estimates[-1][2] <= 1.0
        assert time + late - time <= PATIENCE + 1e-9
