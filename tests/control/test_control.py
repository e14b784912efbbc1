"""The set-point over time, and the loop tick by tick."""

from __future__ import annotations

import dataclasses
import itertools
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.control import ControlError, Loop, Profile
from twinmatch.dynamics import Controller, PidState
from twinmatch.plants import Peltier, TCLab, TCLabBoth


def profile_of(levels, holds, **options):
    """A profile within what the rig can bear."""
    low, high = Peltier.output.safe
    return Profile(
        levels, holds, **{"lowest": low, "highest": high, "unit": "°C"} | options
    )


STAIRS = profile_of((30.0, 50.0, 40.0), (10.0, 20.0, 30.0))

profiles = st.lists(
    st.tuples(st.floats(5.0, 90.0), st.floats(20.0, 500.0)), min_size=1, max_size=6
).flatmap(
    lambda rows: st.builds(
        profile_of,
        st.just(tuple(level for level, _ in rows)),
        st.just(tuple(hold for _, hold in rows)),
        repeat=st.booleans(),
        ramp=st.sampled_from([0.0, 5.0, 50.0]),
    )
)


@pytest.mark.parametrize(
    ("time", "reference"),
    [
        (-5, 30),
        (0, 30),
        (9.999, 30),
        (10, 50),
        (29.999, 50),
        (30, 40),
        (59.9, 40),
        (60, 40),
        (1e6, 40),
    ],
)
def test_levels_follow_each_other(time, reference):
    assert STAIRS.reference(time) == reference


def test_a_profile_ends_unless_it_repeats():
    assert STAIRS.duration == 60
    assert not STAIRS.ended(59.999)
    assert STAIRS.ended(60)
    repeating = profile_of(STAIRS.levels, STAIRS.holds, repeat=True)
    assert repeating.duration == math.inf
    assert not repeating.ended(1e9)
    assert [repeating.reference(t) for t in (60, 70, 90, 119, 120)] == [
        30,
        50,
        40,
        40,
        30,
    ]


def test_a_ramp_leads_from_level_to_level():
    ramped = profile_of((30.0, 50.0, 40.0), (10.0, 20.0, 30.0), ramp=2.0)
    assert [
        ramped.reference(t) for t in (0, 9, 10, 15, 20, 29, 30, 32, 35, 59)
    ] == pytest.approx([30, 30, 30, 40, 50, 50, 50, 46, 40, 40])


def test_a_repeated_ramp_comes_from_the_last_level():
    ramped = profile_of((30.0, 50.0), (20.0, 20.0), repeat=True, ramp=2.0)
    assert [ramped.reference(t) for t in (0, 5, 40, 45, 50)] == pytest.approx(
        [30, 30, 50, 40, 30]
    )


@given(profiles, st.floats(-10.0, 1e5))
def test_the_set_point_stays_between_the_levels(profile, time):
    assert min(profile.levels) <= profile.reference(time) <= max(profile.levels)


@given(profiles, st.floats(0.0, 1e4))
def test_a_repeating_profile_has_a_period(profile, time):
    repeating = dataclasses.replace(profile, repeat=True, ramp=0.0)
    round_ = sum(profile.holds)
    # Close to a step the rounding of the sum decides on which side of it the time is.
    edges = [
        abs(time % round_ - sum(profile.holds[:k]))
        for k in range(len(profile.holds) + 1)
    ]
    if min(edges) > 1e-6:
        assert repeating.reference(time + round_) == repeating.reference(time)


@given(profiles, st.floats(0.0, 1e4), st.floats(0.0, 1.0))
def test_a_ramp_is_no_steeper_than_asked(profile, time, step):
    if profile.ramp:
        change = abs(profile.reference(time + step) - profile.reference(time))
        assert change <= profile.ramp * step + 1e-6


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"levels": (), "holds": ()}, "at least one level"),
        (
            {"levels": (30.0,), "holds": (1.0, 2.0)},
            "1 levels and 2 times are given; give one time per level",
        ),
        (
            {"levels": (30.0, 150.0), "holds": (1.0, 1.0)},
            "level 2 is 150 °C; give one in the safe range, 0 to 100 °C",
        ),
        ({"levels": (math.nan,), "holds": (1.0,)}, "level 1 is nan °C"),
        (
            {"levels": (30.0,), "holds": (0.0,)},
            "the time of level 1 is 0 s; give a positive time",
        ),
        ({"levels": (30.0,), "holds": (math.inf,)}, "time of level 1 is inf s"),
        (
            {"levels": (30.0,), "holds": (1.0,), "lowest": 50.0, "highest": 40.0},
            "50 to 40 °C is empty",
        ),
        (
            {"levels": (30.0,), "holds": (1.0,), "ramp": -1.0},
            "the ramp is -1 °C/s; give a positive rate",
        ),
        (
            {"levels": (30.0, 50.0), "holds": (9.0, 9.0), "ramp": 2.0},
            "the ramp to level 2 takes 10 s, longer than its time of 9 s",
        ),
        (
            {
                "levels": (30.0, 40.0, 50.0),
                "holds": (9.0, 9.0, 9.0),
                "ramp": 2.0,
                "repeat": True,
            },
            "the ramp to level 1 takes 10 s",
        ),
    ],
)
def test_impossible_profiles_are_refused(arguments, message):
    with pytest.raises(ControlError, match=message):
        profile_of(**arguments)


def test_a_time_has_to_be_one():
    with pytest.raises(ControlError, match="the time is nan s"):
        STAIRS.reference(math.nan)


GAINS = Peltier.loop
SECOND = 1_000_000_000


def tick(loop, at, reference=30.0, temperature=None):
    """A tick at `at` seconds, after a temperature if one is given."""
    stamp = round(at * SECOND)
    if temperature is not None:
        loop.measure(temperature, stamp)
    return loop.tick(stamp, lambda _: reference)


@pytest.mark.parametrize("number", [5, 14, 27])
def test_recorded_control_is_reproduced(recorded_hour, number):
    window = recorded_hour(number)
    loop = Loop(Peltier, state=PidState())
    for k in range(len(window)):
        sample = tick(loop, k, float(window.reference[k]), float(window.output[k]))
        assert sample.input == pytest.approx(window.input[k], abs=1e-9)
        assert sample.index == k
    assert (loop.missed, loop.idle) == (0, 0)


@given(
    st.lists(st.tuples(st.floats(0, 100), st.floats(-20, 150)), min_size=1, max_size=50)
)
def test_each_tick_is_one_step_of_the_pid(signals):
    loop = Loop(Peltier, state=PidState())
    pid = Controller(GAINS)
    for k, (reference, temperature) in enumerate(signals):
        sample = tick(loop, k, reference, temperature)
        assert sample.input == loop.input == pid.step(reference, temperature)[0]
        assert (sample.reference, sample.output, sample.stamp) == (
            reference,
            temperature,
            k * SECOND,
        )


def test_the_first_output_is_zero_and_the_integral_carries_on():
    loop = Loop(Peltier)
    assert tick(loop, 0, 40.0, 25.0).input == 0
    # From here on the state is the one the two first samples fix.
    pid = Controller(GAINS)
    pid.follow(40.0, 25.0, 0.0)
    pid = Controller(GAINS, (-GAINS.proportional * 15.0 + GAINS.integral * 15.0, 15.0))
    assert tick(loop, 1, 40.0, 25.5).input == pytest.approx(
        pid.step(40.0, 25.5)[0], abs=1e-9
    )


def test_the_set_point_is_asked_for_at_times_of_the_grid():
    asked = []

    def profile(time):
        asked.append(time)
        return 30.0

    loop = Loop(Peltier, replace(GAINS, period=0.5))
    for arrival in (10.0, 10.7, 11.0, 13.1):
        loop.measure(25.0, round(arrival * SECOND))
        loop.tick(round(arrival * SECOND), profile)
    assert asked == [0.0, 0.5, 1.0, 3.0]


def test_nothing_is_made_before_temperature_and_set_point():
    loop = Loop(Peltier)
    assert tick(loop, 0) is None
    assert "no temperature yet" in loop.trouble
    loop.measure(25.0, SECOND)
    assert tick(loop, 1, None) is None
    assert loop.trouble == "no set-point yet"
    assert tick(loop, 2, math.nan) is None
    assert loop.trouble == "the set-point is nan, not a finite number"
    sample = tick(loop, 2.5)
    assert (sample.index, loop.running, loop.idle, loop.time) == (0, True, 0, 0.0)


def test_a_stale_temperature_switches_off_and_leaves_a_gap():
    loop = Loop(Peltier, max_age=2.0)
    for k in range(5):
        tick(loop, k, 30.0, 29.0)
    assert tick(loop, 5).index == 5  # 1 s old
    assert tick(loop, 6).index == 6  # 2 s old
    assert tick(loop, 7) is None
    assert tick(loop, 8) is None
    assert "the newest temperature is 4.0 s old" in loop.trouble
    assert (loop.input, loop.running, loop.idle) == (0.0, False, 2)
    restarted = tick(loop, 9, 30.0, 25.0)
    assert restarted.index == 9
    assert restarted.input == pytest.approx(0.0, abs=1e-9)
    assert loop.time == 9


def test_temperatures_that_are_not_numbers_age():
    loop = Loop(Peltier, max_age=1.0)
    tick(loop, 0, 30.0, 29.0)
    assert tick(loop, 1, 30.0, math.nan).output == 29.0
    assert tick(loop, 2, 30.0, math.inf) is None
    assert loop.refused == 2


def test_a_missed_tick_is_counted_and_the_output_continues():
    loop = Loop(Peltier)
    for k in range(10):
        before = tick(loop, k, 30.0, 29.5).input
    late = tick(loop, 12.2, 30.0, 28.0)
    assert (late.index, loop.missed) == (12, 2)
    assert loop.jitter == pytest.approx(0.2)
    assert late.input == pytest.approx(before, abs=1e-9)
    assert tick(loop, 13, 30.0, 28.0).index == 13
    assert loop.missed == 2


def test_while_the_drive_is_held_samples_have_no_input_and_then_the_controller_continues_from_there():
    """With a temperature that stands still the first input afterwards is that of rest."""
    loop = Loop(Peltier)
    driven = [tick(loop, k, 60.0, 25.0).input for k in range(20)]
    assert driven[-1] > 0
    loop.held = True
    assert [tick(loop, k, 60.0, 25.0).input for k in range(20, 25)] == [0.0] * 5
    loop.held = False
    assert tick(loop, 25, 60.0, 25.0).input == pytest.approx(0.0, abs=1e-9)
    assert tick(loop, 26, 60.0, 25.0).input > 0


def test_samples_of_a_limited_drive_have_what_passes_and_the_integral_does_not_wind_up():
    loop = Loop(Peltier)
    for k in range(20):
        tick(loop, k, 60.0, 25.0)
    loop.limits = [40.0]
    assert [tick(loop, k, 60.0, 25.0).input for k in range(20, 60)] == [40.0] * 40
    assert loop.input > 40.0  # what it asks for
    assert tick(loop, 60, 60.0, 62.0).input < 40.0
    loop.limits = [math.inf]
    assert tick(loop, 61, 60.0, 25.0).input > 40.0


def test_a_late_tick_is_not_a_missed_one():
    loop = Loop(Peltier)
    indices = [tick(loop, time, 30.0, 29.0).index for time in (0, 1.9, 2.0, 3.0)]
    assert indices == [0, 1, 2, 3]
    assert loop.missed == 0


def test_a_late_first_tick_does_not_shift_the_grid():
    loop = Loop(Peltier)
    assert [tick(loop, time, 30.0, 29.0).index for time in (0.4, 1, 2, 3.9)] == [
        0,
        1,
        2,
        3,
    ]
    assert loop.jitter == pytest.approx(0.9)


def test_a_clock_set_back_starts_over_behind_a_gap():
    loop = Loop(Peltier)
    for k in range(5):
        tick(loop, 100 + k, 30.0, 29.0)
    assert tick(loop, 50) is None, "the temperature is of a time that is to come"
    assert loop.input == 0
    assert tick(loop, 51, 30.0, 29.0).index == 7
    assert tick(loop, 52, 30.0, 29.0).index == 8


@given(
    st.lists(
        st.tuples(st.integers(1, 3), st.floats(0, 0.99), st.booleans()),
        min_size=1,
        max_size=60,
    ),
    st.floats(0, 0.99),
)
def test_an_index_is_a_place_on_the_grid(calls, late):
    """A timer calls at most once per period and never early; the grid is that of its least late call."""
    loop = Loop(Peltier, max_age=1.5)
    tick(loop, late, 30.0, 29.0)
    due = 0
    last = 0
    for skip, late_now, measured in calls:
        due += skip
        sample = tick(loop, due + late_now, 30.0, 29.0 if measured else None)
        if sample is None:
            assert loop.running or loop.input == 0
            continue
        assert last < sample.index <= due
        assert sample.index >= due + late_now - late - 1 - 1e-6
        assert abs(sample.input) <= 255
        last = sample.index


def test_the_grid_moves_to_the_least_late_tick():
    loop = Loop(Peltier)
    assert [tick(loop, time, 30.0, 29.0).index for time in (0.4, 1.0, 2.1, 4.2)] == [
        0,
        1,
        2,
        4,
    ]
    assert loop.missed == 1


def test_a_second_call_at_once_is_not_a_tick():
    loop = Loop(Peltier)
    tick(loop, 0, 30.0, 29.0)
    late = tick(loop, 2.1, 30.0, 28.0)
    assert (late.index, loop.missed) == (2, 1)
    assert tick(loop, 2.1, 30.0, 28.0) is None
    assert (loop.input, loop.running, loop.missed, loop.idle) == (
        late.input,
        True,
        1,
        0,
    )
    assert tick(loop, 3.0, 30.0, 28.0).index == 3


@given(st.floats(-255, 255), st.floats(0, 100), st.floats(0, 100))
def test_the_controller_continues_from_the_output_that_stands(
    pwm, reference, temperature
):
    loop = Loop(Peltier)
    tick(loop, 0, reference, temperature)
    loop.inputs = [pwm]
    assert tick(loop, 3, reference, temperature).input == pytest.approx(pwm, abs=1e-9)


@pytest.mark.parametrize("age", [0.0, -1.0, math.nan])
def test_an_age_has_to_be_positive(age):
    with pytest.raises(ControlError, match=r"max_age is .*; it must be positive"):
        Loop(Peltier, max_age=age)


def test_a_proportional_law_keeps_nothing_of_a_limit_or_a_stop():
    """Without integral action nothing would undo what back-calculation or a restart adds to the command."""
    gains = replace(
        Peltier.loop,
        proportional=10.0,
        integral=0.0,
        derivative=0.0,
        back_calculation=1.0,
    )
    loop = Loop(Peltier, gains)
    commands = {}
    for k in (0, 1, 2, 3, 9, 10):
        # the set-point is far at first; ticks 4 to 8 are missed
        loop.measure(20.0, k * 10**9)
        sample = loop.tick(k * 10**9, lambda t: 90.0 if t < 2 else 22.0)
        commands[k] = sample.input
    assert commands == {0: 255.0, 1: 255.0, 2: 20.0, 3: 20.0, 9: 20.0, 10: 20.0}


def test_two_loops_are_two_pids_on_one_grid():
    """Through a gap, a held and a limited drive."""
    both = Loop(TCLabBoth)
    alone = [Loop(TCLab), Loop(TCLab)]
    for k in (*range(30), *range(35, 60)):
        references = (50.0, 35.0 + k % 7)
        readings = (25.0 + 0.3 * k, 30.0 - 0.1 * k)
        both.held = alone[0].held = alone[1].held = 10 <= k < 13
        both.limits = [100.0, 12.0]
        alone[1].limits = [12.0]
        both.measure(readings, k * SECOND)
        sample = both.tick(k * SECOND, lambda _, r=references: r)
        for number, loop in enumerate(alone):
            sample_alone = tick(loop, k, references[number], readings[number])
            assert (sample_alone.input, sample_alone.output) == (
                sample.inputs[number],
                sample.outputs[number],
            )
    assert (both.missed, alone[0].missed) == (5, 5)
    both.measure((25.0,), 60 * SECOND)
    both.measure((25.0, math.nan), 60 * SECOND)
    assert both.refused == 2
    assert both.tick(63 * SECOND, lambda _: (50.0, 35.0)) is None
    assert (
        both.trouble
        == "the newest temperature and second_temperature is 4.0 s old; is the kit working?"
    )
    assert both.inputs == [0.0, 0.0]
    both.measure((25.0, 30.0), 64 * SECOND)
    assert both.tick(64 * SECOND, lambda _: 50.0) is None
    assert (
        both.trouble == "1 set-points are given for temperature and second_temperature"
    )
    assert both.tick(65 * SECOND, lambda _: (50.0, math.nan)) is None
    assert both.trouble == "the set-point is nan, not a finite number"


def test_a_plant_with_another_law_is_not_controlled():
    with pytest.raises(
        ControlError, match="give a PID for each of its 2 outputs and 2 drives"
    ):
        Loop(TCLabBoth, GAINS)


def test_a_law_takes_what_stands_in_for_a_reading_and_samples_keep_the_reading():
    """Loop 1 continues without a bump when its sensor is replaced, and when it is back."""
    loop = Loop(TCLabBoth)
    undisturbed = Loop(TCLabBoth)
    steps = []
    for k in range(60):
        lies = 20 <= k < 40
        for tested, first in ((loop, 45.0 if lies else 40.0), (undisturbed, 40.0)):
            replacement = (40.0, math.nan) if lies and tested is loop else ()
            tested.measure((first, 30.0), k * 10**9, taken=replacement)
        sample, expected = (
            tested.tick(k * 10**9, lambda _: (42.0, 33.0))
            for tested in (loop, undisturbed)
        )
        steps.append((sample, expected))
    assert [sample.outputs[0] for sample, _ in steps[20:40]] == [45.0] * 20
    assert max(abs(a.inputs[1] - b.inputs[1]) for a, b in steps) == 0.0
    # Where a controller continues, its integral is set for the command of the tick before: a tick of growth.
    growth = max(
        abs(b.inputs[0] - a.inputs[0])
        for (_, a), (_, b) in itertools.pairwise(steps[1:])
    )
    assert max(abs(a.inputs[0] - b.inputs[0]) for a, b in steps) <= 2.0 * growth


@pytest.mark.parametrize("replacement", [(40.0,), (math.inf, 30.0), (40.0, -math.inf)])
def test_what_stands_in_has_a_number_for_each_output(replacement):
    loop = Loop(TCLabBoth)
    loop.measure((40.0, 30.0), 0, taken=replacement)
    assert loop.refused == 1
    assert loop.tick(0, lambda _: (42.0, 33.0)) is None
