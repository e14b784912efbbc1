"""Samples of a loop from values and times: exactly its ticks, and no sample that is not whole."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.importing.resampling import resample
from twinmatch.sampling.channels import (
    Channel,
    Field,
    Followed,
    SamplingError,
    by_name,
    check_path,
    fields_below,
    parse_channel,
    steps,
    usual_unit,
)
from twinmatch.sampling.names import LoopNames
from twinmatch.sampling.sampler import Grid, Limits, Rate, Sampler, SignalBuffer
from twinmatch.signals import Sample

SECOND = 1_000_000_000
SIGNALS = {
    "reference": Limits(),
    "output": Limits(2.0),
    "input": Limits(2.0, -255.0, 255.0),
}


def ns(seconds: float) -> int:
    return round(seconds * SECOND)


def follow(message: object, path: str) -> float | None:
    return Followed(Channel("/t", path)).number(message)


def run(
    sampler: Sampler, entries: list[tuple[float, str, float]], until: float
) -> list[Sample]:
    """What the sampler makes of values by time, name and value, looked for every 10 ms."""
    samples = []
    waiting = sorted(entries, key=lambda entry: entry[0])
    for time in np.arange(0.0, until, 0.01):
        while waiting and waiting[0][0] <= time:
            arrival, name, value = waiting.pop(0)
            if name == "timer":
                sampler.tick(ns(arrival))
            else:
                sampler.take(name, value, ns(arrival), ns(arrival))
            samples += sampler.collect(ns(arrival))
        samples += sampler.collect(ns(time))
    return samples


def loop(
    ticks: int, pause: tuple[float, float] = (0.0, 0.0)
) -> list[tuple[float, str, float]]:
    """A foreign loop: a reading, 20 ms later the command; the set-point is sent once, at the beginning."""
    entries = [(0.0, "reference", 40.0)]
    for k in range(ticks):
        time = k + (pause[1] if k >= pause[0] and pause[1] else 0.0)
        entries += [(time, "output", 20.0 + k), (time + 0.02, "input", 100.0 - k)]
    return entries


@pytest.mark.parametrize("paced_by", ["input", "output"])
def test_each_tick_of_the_loop_is_a_sample_with_what_belongs_to_it(
    paced_by: str,
) -> None:
    samples = run(Sampler(SIGNALS, 1.0, paced_by), loop(30), 35.0)
    if paced_by == "input":
        assert [(s.index, s.output, s.input) for s in samples] == [
            (k, 20.0 + k, 100.0 - k) for k in range(30)
        ]
        assert [s.stamp for s in samples] == [ns(k + 0.02) for k in range(30)]
    else:
        # the first reading has no command yet; from the others on, the one before stands for 20 ms more
        assert [(s.index, s.output) for s in samples] == [
            (k - 1, 20.0 + k) for k in range(1, 30)
        ]
        expected = [100.0 - k + 0.02 for k in range(1, 30)]
        assert [s.input for s in samples] == pytest.approx(expected)
    assert {s.reference for s in samples} == {40.0}


def test_what_is_sent_behind_the_tick_belongs_to_it() -> None:
    """A program that publishes its command before the reading it was made from."""
    entries = [(0.0, "reference", 40.0)]
    for k in range(10):
        entries += [(k, "input", 100.0 - k), (k + 0.03, "output", 20.0 + k)]
    samples = run(Sampler(SIGNALS, 1.0, "input", settle=0.1), entries, 12.0)
    assert [(s.output, s.input) for s in samples] == [
        (20.0 + k, 100.0 - k) for k in range(10)
    ]
    late = run(Sampler(SIGNALS, 1.0, "input", settle=0.0), entries, 12.0)
    # without waiting it is that of the tick before
    assert (late[1].output, late[1].input) == (21.0, 98.0)


def test_a_pause_of_the_loop_is_a_gap_in_the_indices() -> None:
    samples = run(Sampler(SIGNALS, 1.0), loop(30, pause=(10, 5.0)), 40.0)
    assert [s.index for s in samples] == [*range(10), *range(15, 35)]


def test_a_timer_continues_while_a_value_grows_old_and_says_so() -> None:
    entries = [
        entry for entry in loop(40) if not (entry[1] == "output" and 10 < entry[0] < 18)
    ]
    entries += [(k + 0.5, "timer", 0.0) for k in range(40)]
    sampler = Sampler(SIGNALS, 1.0, "timer")
    samples = run(sampler, entries, 12.8)
    assert samples[-1].index == 11
    assert not sampler.troubles
    samples += run(sampler, [e for e in entries if e[0] > 12.8], 14.8)
    assert "the newest output is 3.5 s old" in sampler.troubles["output"]
    samples += run(sampler, [e for e in entries if e[0] > 14.8], 30.0)
    assert sampler.counts["output"].late == sampler.idle == 6
    assert [s.index for s in samples][:20] == [*range(12), *range(18, 26)]


def test_without_a_reference_it_is_one_that_says_nothing() -> None:
    signals = {name: limits for name, limits in SIGNALS.items() if name != "reference"}
    samples = run(
        Sampler(signals, 1.0), [e for e in loop(10) if e[1] != "reference"], 12.0
    )
    assert {s.reference for s in samples} == {20.0}


LOOPS = LoopNames(("r1", "r2"), ("y1", "y2"), ("u1", "u2"))
ALL = ("r1", "r2", "y1", "y2", "u1", "u2")


def two_loops(ticks: int, late: float) -> list[tuple[float, str, float]]:
    """Two readings, and 20 ms later the commands, the second of which is so much later than the first."""
    entries = [(0.0, "r1", 40.0), (0.0, "r2", 50.0)]
    for k in range(ticks):
        entries += [(k, "y2", 60.0 - k), (k, "y1", 20.0 + k)]
        entries += [(k + 0.02, "u1", 100.0 - k), (k + 0.02 + late, "u2", 10.0 + k)]
    return entries


@pytest.mark.parametrize("late", [0.05, -0.01])
@pytest.mark.parametrize("paced_by", ["u1", "u2", "y2"])
def test_a_tick_of_two_loops_is_one_sample_with_both_of_each(
    paced_by: str, late: float
) -> None:
    sampler = Sampler(
        dict.fromkeys(ALL, Limits(2.0)) | {"r1": Limits(), "r2": Limits()},
        1.0,
        paced_by,
        loop=LOOPS,
    )
    samples = run(sampler, two_loops(20, late), 25.0)
    if paced_by in LOOPS.inputs:
        assert [s.inputs for s in samples] == [(100.0 - k, 10.0 + k) for k in range(20)]
        assert [s.outputs for s in samples] == [(20.0 + k, 60.0 - k) for k in range(20)]
    else:
        # means up to the next reading, at the beginning of which the commands before still stand
        expected = [(100.0 - k + 0.02, 10.0 + k - 0.02 - late) for k in range(1, 20)]
        assert np.array([s.inputs for s in samples]) == pytest.approx(
            np.array(expected)
        )
        assert [s.outputs for s in samples] == [
            (20.0 + k, 60.0 - k) for k in range(1, 20)
        ]
    assert {s.references for s in samples} == {(40.0, 50.0)}


def test_a_tick_without_one_of_two_readings_has_no_sample() -> None:
    entries = [
        e
        for e in two_loops(20, 0.0)
        if e[1] in ALL[2:] and not (e[1] == "y2" and 5 <= e[0] < 15)
    ]
    unmapped = {name: Limits(2.0) for name in ALL if not name.startswith("r")}
    sampler = Sampler(unmapped, 1.0, "u1", loop=LOOPS)
    samples = run(sampler, entries, 25.0)
    # at tick 6 it is older than 2 s
    assert [s.index for s in samples] == [*range(6), *range(15, 20)]
    assert sampler.counts["y2"].late == sampler.idle == 9
    assert {s.references for s in samples} == {(20.0, 60.0)}
    with pytest.raises(SamplingError, match="u2 is not mapped; every sample needs it"):
        Sampler({name: Limits() for name in ALL[:-1]}, 1.0, "u1", loop=LOOPS)


def test_disturbances_are_in_the_plants_order_and_unmapped_ones_have_their_default() -> (
    None
):
    signals = {**SIGNALS, "room": Limits(), "load": Limits()}
    sampler = Sampler(
        signals, 1.0, disturbances={"load": 0.0, "sun": 7.0, "room": 20.0}
    )
    samples = run(sampler, [(0.0, "room", 19.0), (0.0, "load", 3.0), *loop(5)], 6.0)
    assert {s.disturbances for s in samples} == {(3.0, 7.0, 19.0)}


def test_a_value_beyond_what_the_plant_can_be_given_makes_no_sample() -> None:
    sampler = Sampler({**SIGNALS, "input": Limits(2.0, 0.0, 97.5)}, 1.0)
    samples = run(sampler, loop(8), 10.0)
    assert [s.input for s in samples] == [97.0, 96.0, 95.0, 94.0, 93.0]
    assert sampler.counts["input"].beyond == 3
    run(sampler, [(20.0, "output", 20.0), (20.0, "input", 101.0)], 22.0)
    assert sampler.troubles["input"] == "input is 101, outside 0 to 97.5"


def test_a_reading_beyond_the_span_is_another_unit_at_first_and_a_failed_sensor_later() -> (
    None
):
    signals = {**SIGNALS, "output": Limits(2.0, -20.0, 25.0, lenient=True)}
    kelvin = [
        (time, name, value + 273.15 * (name == "output"))
        for time, name, value in loop(10)
    ]
    sampler = Sampler(signals, 1.0)
    assert not run(sampler, kelvin, 12.0)
    assert "outside -20 to 25" in sampler.troubles["output"]
    assert len(run(Sampler(signals, 1.0), loop(10), 12.0)) == 10  # up to 29


def test_no_sample_is_made_with_a_wrong_period() -> None:
    sampler = Sampler(SIGNALS, 0.9)
    samples = run(sampler, loop(30), 32.0)
    assert len(samples) <= 5
    assert (
        "input arrives every 1 s, but the period is 0.9 s" in sampler.troubles["pace"]
    )


def test_ticks_that_come_at_once_with_their_own_times_are_not_mixed() -> None:
    """This machine slept: messages of several ticks wait, each stamped with its own time."""
    sampler = Sampler(SIGNALS, 1.0)
    samples = run(sampler, loop(5), 5.5)
    for k in range(5, 9):
        sampler.take("output", 20.0 + k, ns(k), ns(8.6))
        sampler.take("input", 100.0 - k, ns(k + 0.02), ns(8.6))
        samples += sampler.collect(ns(8.6))
    samples += sampler.collect(ns(8.8))
    assert [(s.index, s.output, s.input) for s in samples[-2:]] == [
        (4, 24.0, 96.0),
        (8, 28.0, 92.0),
    ]


def test_a_clock_that_was_set_back_leaves_no_value_of_the_time_to_come() -> None:
    sampler = Sampler(SIGNALS, 1.0)
    run(sampler, [(100.0 + time, name, value) for time, name, value in loop(5)], 106.0)
    run(sampler, [(10.0, "input", 50.0)], 12.0)
    assert "after the tick" in sampler.troubles["output"]


def test_values_that_are_not_numbers_are_only_counted() -> None:
    sampler = Sampler(SIGNALS, 1.0)
    invalid = [(k + 0.01, "output", np.nan) for k in range(10)] + [
        (3.02, "input", np.inf)
    ]
    samples = run(sampler, sorted(invalid + loop(10)), 12.0)
    assert len(samples) == 10
    assert (sampler.refused("output"), sampler.refused("input")) == (10, 1)


@given(
    st.lists(
        st.tuples(st.floats(0.0, 0.9), st.floats(-100.0, 100.0)), min_size=1, max_size=8
    ),
    st.floats(-100.0, 100.0),
)
def test_the_mean_of_an_input_is_that_of_an_imported_recording(
    steps: list[tuple[float, float]], before: float
) -> None:
    """`resample` puts rows of a table on a clock in its own way, by differences of a running sum."""
    rows = {-1.0: before, 0.95: before}
    rows.update({round(time, 3): value for time, value in steps})
    buffer = SignalBuffer()
    for time, value in sorted(rows.items()):
        buffer.push(value, ns(time))
    times = np.array(sorted(rows))
    table = resample(
        times, {"u": [rows[time] for time in times]}, {"u": "held"}, 1.0, longest=10.0
    )
    time = int(np.flatnonzero(np.abs(table.time) < 1e-9)[0])
    mean = buffer.mean(0, ns(1.0))
    assert mean == pytest.approx(table.columns["u"][time], abs=1e-6)


def test_what_always_stands_is_its_own_mean_to_the_last_digit() -> None:
    buffer = SignalBuffer()
    for k in range(100):
        buffer.push(0.1, ns(0.037 * k))
    assert buffer.mean(ns(0.5), ns(1.7)) == 0.1
    assert SignalBuffer().mean(0, 1) is None


@pytest.mark.parametrize(
    ("rules", "words"),
    [
        ({"signals": {"output": Limits()}}, "input is not mapped"),
        (
            {"paced_by": "clock"},
            "paced_by is 'clock'; choose one of reference, output, input, timer",
        ),
        ({"settle": 0.6}, "settle is 0.6"),
        ({"period": 0.0}, "period is 0 s"),
    ],
)
def test_rules_by_which_nothing_can_be_sampled_are_refused(
    rules: dict, words: str
) -> None:
    with pytest.raises(SamplingError, match=words):
        Sampler(**{"signals": SIGNALS, "period": 1.0, **rules})


# Paths to numbers in messages: found, refused with what there is instead, followed.

TYPES: dict[str, dict[str, Field]] = {
    "std_msgs/msg/Float64": {"data": Field("double")},
    "std_msgs/msg/Header": {
        "stamp": Field("builtin_interfaces/msg/Time"),
        "frame_id": Field("string"),
    },
    "sensor_msgs/msg/Temperature": {
        "header": Field("std_msgs/msg/Header"),
        "temperature": Field("double"),
        "variance": Field("double"),
    },
    "lab_msgs/msg/Reading": {
        "value": Field("float"),
        "name": Field("string"),
        "good": Field("boolean"),
    },
    "lab_msgs/msg/Rack": {
        "readings": Field("lab_msgs/msg/Reading", array=True),
        "pose": Field("double", array=True, length=3),
        "first": Field("lab_msgs/msg/Reading"),
    },
    "lab_msgs/msg/Nothing": {"text": Field("string")},
    "sensor_msgs/msg/JointState": {
        "name": Field("string", array=True),
        "position": Field("double", array=True),
    },
}


def fields_of(kind: str) -> Mapping[str, Field]:
    return TYPES[kind]


@pytest.mark.parametrize(
    ("kind", "path", "canonical"),
    [
        ("std_msgs/msg/Float64", "data", "data"),
        ("std_msgs/msg/Float64", "", "data"),
        ("sensor_msgs/msg/Temperature", "temperature", "temperature"),
        ("lab_msgs/msg/Rack", "readings[2].value", "readings[2].value"),
        ("lab_msgs/msg/Rack", "readings[2].good", "readings[2].good"),
        ("lab_msgs/msg/Rack", "pose[2]", "pose[2]"),
        ("lab_msgs/msg/Rack", "first.value", "first.value"),
        (
            "sensor_msgs/msg/JointState",
            "position[left/elbow_1]",
            "position[left/elbow_1]",
        ),
    ],
)
def test_a_path_to_a_number_is_found(kind: str, path: str, canonical: str) -> None:
    assert check_path(kind, path, fields_of) == canonical


@pytest.mark.parametrize(
    ("kind", "path", "words"),
    [
        (
            "sensor_msgs/msg/Temperature",
            "",
            "has several numbers; choose one: temperature, variance",
        ),
        (
            "sensor_msgs/msg/Temperature",
            "data",
            "no field 'data'; its numbers: temperature, variance",
        ),
        (
            "sensor_msgs/msg/Temperature",
            "temperature.x",
            "temperature has no field 'x'",
        ),
        (
            "sensor_msgs/msg/Temperature",
            "header",
            "header is a message; choose a number in it: temperature, variance",
        ),
        (
            "lab_msgs/msg/Rack",
            "readings",
            "readings is a list; choose an element, such as readings.0.",
        ),
        (
            "lab_msgs/msg/Rack",
            "readings.value",
            "readings is a list; .* such as readings.0..value",
        ),
        (
            "lab_msgs/msg/Rack",
            "readings[0].name",
            "is text; choose a number: readings.0..value",
        ),
        ("lab_msgs/msg/Rack", "first[0]", "first is not a list; leave out .0."),
        ("lab_msgs/msg/Rack", "pose[3]", "pose has 3 values, counted from 0"),
        (
            "lab_msgs/msg/Rack",
            "first",
            "first is a message; choose a number in it: first.value, first.good",
        ),
        (
            "lab_msgs/msg/Rack",
            "pose[elbow]",
            "the elements of pose have no names; choose one by number",
        ),
        ("sensor_msgs/msg/JointState", "name[elbow]", "is text"),
        ("lab_msgs/msg/Nothing", "", "has no numbers"),
        ("std_msgs/msg/Float64", "data..x", "is not a field path"),
        ("std_msgs/msg/Float64", "[0]", "is not a field path"),
        ("std_msgs/msg/Float64", "data[-1]", "is not a field path"),
    ],
)
def test_what_is_not_a_number_is_refused_with_what_there_is(
    kind: str, path: str, words: str
) -> None:
    with pytest.raises(SamplingError, match=words):
        check_path(kind, path, fields_of)


def test_the_numbers_of_a_message_are_listed_without_its_header() -> None:
    assert list(fields_below("sensor_msgs/msg/Temperature", fields_of)) == [
        "temperature",
        "variance",
    ]
    assert list(fields_below("lab_msgs/msg/Rack", fields_of)) == [
        "readings[0].value",
        "readings[0].good",
        "pose[0]",
        "first.value",
        "first.good",
    ]


@pytest.mark.parametrize(
    ("names", "path", "listed"),
    [
        (["elbow", "l/wrist"], "position[0]", ["position[elbow]", "position[l/wrist]"]),
        (["elbow", "l/wrist"], "stiff", ["stiff"]),
        (["elbow", "l/wrist"], "empty[0]", []),
        (["elbow"], "position[0]", ["position[0]"]),
        (["1", "2"], "position[0]", ["position[0]"]),
        ([], "position[0]", ["position[0]"]),
        (["elbow", "wrist"], "of[0].value", ["of[elbow].value", "of[wrist].value"]),
    ],
)
def test_elements_are_listed_by_the_names_that_a_message_gives_them(
    names: list[str], path: str, listed: list[str]
) -> None:
    parts = [SimpleNamespace(value=1.0), SimpleNamespace(value=2.0)]
    message = SimpleNamespace(
        name=names, position=[1.0, 2.0], stiff=3.0, empty=[], of=parts
    )
    assert by_name(message, path) == listed


@given(
    st.lists(
        st.one_of(
            st.from_regex(r"[a-z][a-z0-9_]{0,5}", fullmatch=True), st.integers(0, 3)
        ),
        min_size=1,
        max_size=6,
    ).filter(lambda parts: isinstance(parts[0], str)),
    st.floats(allow_nan=False),
)
def test_following_a_path_finds_what_was_put_there(
    parts: list[str | int], value: float
) -> None:
    message: object = value
    for part in reversed(parts):
        message = (
            SimpleNamespace(**{part: message})
            if isinstance(part, str)
            else [None] * part + [message]
        )
    path = "".join(
        f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts
    ).lstrip(".")
    assert steps(path) == tuple(parts)
    assert follow(message, path) == value


def test_bytes_flags_and_short_lists_are_followed() -> None:
    message = SimpleNamespace(
        flag=True, byte=b"\x07", values=np.array([1.5, 2.5]), text="on"
    )
    assert follow(message, "flag") == 1.0
    assert follow(message, "byte") == 7.0
    assert follow(message, "values[1]") == 2.5
    assert np.isnan(follow(message, "values[2]") or 0.0)
    with pytest.raises(SamplingError, match="text is 'on', which is not a number"):
        follow(message, "text")


def joints(**positions: float) -> SimpleNamespace:
    return SimpleNamespace(
        name=list(positions), position=np.array(list(positions.values()))
    )


def test_a_joint_is_found_by_its_name_in_any_order_and_in_no_message_of_others() -> (
    None
):
    elbow = Followed(Channel("/joint_states", "position[elbow]"))
    messages = (
        joints(elbow=1.0, wrist=2.0),
        joints(wrist=2.5, elbow=1.5),
        joints(gripper=0.1),
    )
    assert [elbow.number(message) for message in messages] == [1.0, 1.5, None]


@pytest.mark.parametrize("message", [joints(wrist=2.5, elbow=1.5), joints(gripper=0.1)])
def test_an_index_that_means_another_joint_than_before_is_refused(
    message: SimpleNamespace,
) -> None:
    first = Followed(Channel("/joint_states", "position[0]"))
    assert [
        first.number(joints(elbow=1.0, wrist=2.0)),
        first.number(joints(elbow=1.2)),
    ] == [1.0, 1.2]
    words = rf"elbow in one message and {message.name[0]} in another; choose it by name: .*:position\[elbow\]"
    with pytest.raises(SamplingError, match=words):
        first.number(message)


@pytest.mark.parametrize(
    ("wanted", "unit"),
    [("deg", "rad"), ("rad", "rad"), ("mm", "m"), ("°C", ""), ("%", ""), ("steps", "")],
)
def test_the_position_of_a_joint_is_an_angle_or_a_length_as_the_plant_says(
    wanted: str, unit: str
) -> None:
    assert usual_unit("sensor_msgs/msg/JointState", "position[elbow]", wanted) == unit


def test_a_channel_is_written_as_it_was_read_and_what_is_none_is_refused() -> None:
    for text in (
        "/cmd:data",
        "/camera/temperature:temperature",
        "cmd",
        "t:readings[0].x",
    ):
        assert parse_channel(text).text == text
    assert parse_channel(" /cmd : data ") == Channel("/cmd", "data")
    for text in ("", "/cmd:", ":data", "/a b:c", "/cmd/:data", "/cmd:da ta", "/cmd:1"):
        with pytest.raises(SamplingError):
            parse_channel(text)


# Numbers of ticks: one after the other however they jitter and drift, and a gap where ticks are missing.


def numbers(times: np.ndarray, period: float = 1.0) -> list[int | None]:
    grid = Grid(round(period * SECOND))
    return [grid.place(round(time * SECOND)) for time in times]


@given(
    st.floats(0.02, 30.0),
    st.floats(-0.01, 0.01),
    st.lists(st.floats(0.0, 0.4), min_size=2, max_size=400),
)
def test_no_tick_is_missed_that_is_late_or_drifts(
    period: float, drift: float, late: list[float]
) -> None:
    """A loop whose second is 1 % wrong and whose messages come up to 0.4 periods late: lateness on the grid
    stays below 0.4 + 0.01/0.1 + what the leak moved it, and so below one period."""
    times = period * (np.arange(len(late)) * (1 + drift) + np.array(late))
    assert numbers(times, period) == list(range(len(late)))


@given(st.integers(1, 50), st.integers(2, 1000), st.floats(0.0, 0.9))
def test_a_gap_in_time_is_a_gap_in_the_numbers(
    before: int, gap: int, phase: float
) -> None:
    """Behind it ticks may come at any moment of the period: a loop was restarted."""
    times = np.concatenate(
        [np.arange(before), before - 1 + gap + phase + np.arange(50)]
    )
    expected = [*range(before), *range(before - 1 + gap, before + 49 + gap)]
    assert numbers(times) == expected


@pytest.mark.parametrize(
    ("times", "expected"),
    [
        # a burst is one tick
        ([0.0, 1.0, 4.2, 4.21, 4.22, 5.0, 6.0], [0, 1, 4, None, None, 5, 6]),
        # a clock that is set back starts over behind a gap
        ([100.0, 101.0, 5.0, 6.0], [0, 1, 3, 4]),
        # a message a little before the last is not a tick
        ([0.0, 1.0, 0.9, 2.0], [0, 1, None, 2]),
    ],
)
def test_ticks_are_numbered_through_bursts_set_back_clocks_and_early_messages(
    times: list[float], expected: list[int | None]
) -> None:
    assert numbers(np.array(times)) == expected


def rate_of(times: np.ndarray) -> Rate:
    rate = Rate()
    for time in times:
        rate.push(round(time * SECOND))
    return rate


@given(st.integers(6, 300), st.floats(0.0, 0.3), st.integers(0, 2**31))
def test_a_rate_is_never_doubted_for_its_jitter(
    size: int, jitter: float, seed: int
) -> None:
    """Lateness of single ticks, uniform, up to a third of a period."""
    late = np.random.default_rng(seed).uniform(0.0, jitter, size)
    assert not rate_of(np.arange(size) + late).differs_from(1.0)


@given(st.sampled_from([0.5, 0.9, 1.03, 1.5, 2.0, 10.0]), st.integers(0, 2**31))
def test_another_rate_is_reported_with_its_period(true: float, seed: int) -> None:
    late = np.random.default_rng(seed).uniform(0.0, 0.02 * true, 40)
    rate = rate_of(true * np.arange(40) + late)
    assert rate.differs_from(1.0)
    assert abs(rate.period - true) < 0.01 * true


def test_a_rate_is_not_doubted_because_a_device_is_busy_three_times_of_ten() -> None:
    """Each time it is asked again a tenth of a period later."""
    for seed in range(20):
        late = 0.1 * (np.random.default_rng(seed).geometric(0.7, 60) - 1)
        rate = Rate()
        for number, lateness in enumerate(late):
            rate.push(round((number + lateness) * SECOND))
            assert not rate.differs_from(1.0), (seed, number)


def test_gaps_and_bursts_do_not_count_for_the_rate() -> None:
    rate = rate_of(np.concatenate([np.arange(20), [24.5, 24.51], 25.0 + np.arange(20)]))
    assert not rate.differs_from(1.0)
    assert rate_of(np.arange(3.0)).period is None
