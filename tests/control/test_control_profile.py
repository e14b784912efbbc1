"""Set-points over time."""

from __future__ import annotations

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.control import ControlError, Profile
from twinmatch.plants import Peltier


def made(levels, holds, **rest):
    """A profile within what the rig can bear."""
    low, high = Peltier.output.safe
    return Profile(levels, holds, **{"lowest": low, "highest": high, "unit": "°C"} | rest)


STAIRS = made((30.0, 50.0, 40.0), (10.0, 20.0, 30.0))

profiles = st.lists(st.tuples(st.floats(5.0, 90.0), st.floats(20.0, 500.0)), min_size=1, max_size=6).flatmap(
    lambda rows: st.builds(
        made,
        st.just(tuple(level for level, _ in rows)),
        st.just(tuple(hold for _, hold in rows)),
        repeat=st.booleans(),
        ramp=st.sampled_from([0.0, 5.0, 50.0]),
    )
)


@pytest.mark.parametrize(
    ("time", "reference"),
    [(-5, 30), (0, 30), (9.999, 30), (10, 50), (29.999, 50), (30, 40), (59.9, 40), (60, 40), (1e6, 40)],
)
def test_levels_follow_each_other(time, reference):
    assert STAIRS.reference(time) == reference


def test_a_profile_ends_unless_it_repeats():
    assert STAIRS.duration == 60
    assert not STAIRS.ended(59.999)
    assert STAIRS.ended(60)
    again = made(STAIRS.levels, STAIRS.holds, repeat=True)
    assert again.duration == math.inf
    assert not again.ended(1e9)
    assert [again.reference(t) for t in (60, 70, 90, 119, 120)] == [30, 50, 40, 40, 30]


def test_a_ramp_leads_from_level_to_level():
    ramped = made((30.0, 50.0, 40.0), (10.0, 20.0, 30.0), ramp=2.0)
    assert [ramped.reference(t) for t in (0, 9, 10, 15, 20, 29, 30, 32, 35, 59)] == pytest.approx(
        [30, 30, 30, 40, 50, 50, 50, 46, 40, 40]
    )


def test_a_repeated_ramp_comes_from_the_last_level():
    ramped = made((30.0, 50.0), (20.0, 20.0), repeat=True, ramp=2.0)
    assert [ramped.reference(t) for t in (0, 5, 40, 45, 50)] == pytest.approx([30, 30, 50, 40, 30])


@given(profiles, st.floats(-10.0, 1e5))
def test_the_set_point_stays_between_the_levels(profile, time):
    assert min(profile.levels) <= profile.reference(time) <= max(profile.levels)


@given(profiles, st.floats(0.0, 1e4))
def test_a_repeating_profile_has_a_period(profile, time):
    again = dataclasses.replace(profile, repeat=True, ramp=0.0)
    round_ = sum(profile.holds)
    # Close to a step the rounding of the sum decides on which side of it the time is.
    edges = [abs(time % round_ - sum(profile.holds[:k])) for k in range(len(profile.holds) + 1)]
    if min(edges) > 1e-6:
        assert again.reference(time + round_) == again.reference(time)


@given(profiles, st.floats(0.0, 1e4), st.floats(0.0, 1.0))
def test_a_ramp_is_no_steeper_than_asked(profile, time, step):
    if profile.ramp:
        change = abs(profile.reference(time + step) - profile.reference(time))
        assert change <= profile.ramp * step + 1e-6


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"levels": (), "holds": ()}, "at least one level"),
        ({"levels": (30.0,), "holds": (1.0, 2.0)}, "1 levels and 2 times are given; give one time per level"),
        (
            {"levels": (30.0, 150.0), "holds": (1.0, 1.0)},
            "level 2 is 150 °C; give one in the safe range, 0 to 100 °C",
        ),
        ({"levels": (math.nan,), "holds": (1.0,)}, "level 1 is nan °C"),
        ({"levels": (30.0,), "holds": (0.0,)}, "the time of level 1 is 0 s; give a positive time"),
        ({"levels": (30.0,), "holds": (math.inf,)}, "time of level 1 is inf s"),
        ({"levels": (30.0,), "holds": (1.0,), "lowest": 50.0, "highest": 40.0}, "50 to 40 °C is empty"),
        ({"levels": (30.0,), "holds": (1.0,), "ramp": -1.0}, "the ramp is -1 °C/s; give a positive rate"),
        (
            {"levels": (30.0, 50.0), "holds": (9.0, 9.0), "ramp": 2.0},
            "the ramp to level 2 takes 10 s, longer than its time of 9 s",
        ),
        (
            {"levels": (30.0, 40.0, 50.0), "holds": (9.0, 9.0, 9.0), "ramp": 2.0, "repeat": True},
            "the ramp to level 1 takes 10 s",
        ),
    ],
)
def test_impossible_profiles_are_refused(arguments, message):
    with pytest.raises(ControlError, match=message):
        made(**arguments)


def test_a_time_has_to_be_one():
    with pytest.raises(ControlError, match="the time is nan s"):
        STAIRS.reference(math.nan)
