"""Paths to numbers in messages: found, refused with what there is instead, followed."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.sessions.sampling import (
    Channel,
    Field,
    SamplingError,
    check_path,
    fields_below,
    follow,
    parse_channel,
)
from twinmatch.sessions.sampling.channels import steps

TYPES: dict[str, dict[str, Field]] = {
    "std_msgs/msg/Float64": {"data": Field("double")},
    "std_msgs/msg/Header": {"stamp": Field("builtin_interfaces/msg/Time"), "frame_id": Field("string")},
    "sensor_msgs/msg/Temperature": {
        "header": Field("std_msgs/msg/Header"),
        "temperature": Field("double"),
        "variance": Field("double"),
    },
    "lab_msgs/msg/Reading": {"value": Field("float"), "name": Field("string"), "good": Field("boolean")},
    "lab_msgs/msg/Rack": {
        "readings": Field("lab_msgs/msg/Reading", array=True),
        "pose": Field("double", array=True, length=3),
        "first": Field("lab_msgs/msg/Reading"),
    },
    "lab_msgs/msg/Nothing": {"text": Field("string")},
}


def fields_of(kind: str) -> Mapping[str, Field]:
    return TYPES[kind]


@pytest.mark.parametrize(
    ("kind", "path", "found"),
    [
        ("std_msgs/msg/Float64", "data", "data"),
        ("std_msgs/msg/Float64", "", "data"),
        ("sensor_msgs/msg/Temperature", "temperature", "temperature"),
        ("lab_msgs/msg/Rack", "readings[2].value", "readings[2].value"),
        ("lab_msgs/msg/Rack", "readings[2].good", "readings[2].good"),
        ("lab_msgs/msg/Rack", "pose[2]", "pose[2]"),
        ("lab_msgs/msg/Rack", "first.value", "first.value"),
    ],
)
def test_a_path_to_a_number_is_found(kind: str, path: str, found: str) -> None:
    assert check_path(kind, path, fields_of) == found


@pytest.mark.parametrize(
    ("kind", "path", "words"),
    [
        ("sensor_msgs/msg/Temperature", "", "has several numbers; choose one: temperature, variance"),
        ("sensor_msgs/msg/Temperature", "data", "no field 'data'; its numbers: temperature, variance"),
        ("sensor_msgs/msg/Temperature", "temperature.x", "temperature has no field 'x'"),
        (
            "sensor_msgs/msg/Temperature",
            "header",
            "header is a message; choose a number in it: temperature, variance",
        ),
        ("lab_msgs/msg/Rack", "readings", "readings is a list; choose an element, such as readings.0."),
        ("lab_msgs/msg/Rack", "readings.value", "readings is a list; .* such as readings.0..value"),
        ("lab_msgs/msg/Rack", "readings[0].name", "is text; choose a number: readings.0..value"),
        ("lab_msgs/msg/Rack", "first[0]", "first is not a list; leave out .0."),
        ("lab_msgs/msg/Rack", "pose[3]", "pose has 3 values, counted from 0"),
        ("lab_msgs/msg/Rack", "first", "first is a message; choose a number in it: first.value, first.good"),
        ("lab_msgs/msg/Nothing", "", "has no numbers"),
        ("std_msgs/msg/Float64", "data..x", "is not a field path"),
        ("std_msgs/msg/Float64", "[0]", "is not a field path"),
        ("std_msgs/msg/Float64", "data[-1]", "is not a field path"),
    ],
)
def test_what_is_not_a_number_is_refused_with_what_there_is(kind: str, path: str, words: str) -> None:
    with pytest.raises(SamplingError, match=words):
        check_path(kind, path, fields_of)


def test_the_numbers_of_a_message_are_listed_without_its_header() -> None:
    assert list(fields_below("sensor_msgs/msg/Temperature", fields_of)) == ["temperature", "variance"]
    assert list(fields_below("lab_msgs/msg/Rack", fields_of)) == [
        "readings[0].value",
        "readings[0].good",
        "pose[0]",
        "first.value",
        "first.good",
    ]


@given(
    st.lists(
        st.one_of(st.from_regex(r"[a-z][a-z0-9_]{0,5}", fullmatch=True), st.integers(0, 3)),
        min_size=1,
        max_size=6,
    ).filter(lambda parts: isinstance(parts[0], str)),
    st.floats(allow_nan=False),
)
def test_following_a_path_finds_what_was_put_there(parts: list[str | int], value: float) -> None:
    message: object = value
    for part in reversed(parts):
        message = SimpleNamespace(**{part: message}) if isinstance(part, str) else [None] * part + [message]
    path = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts).lstrip(".")
    assert steps(path) == tuple(parts)
    assert follow(message, path) == value


def test_bytes_flags_and_short_lists_are_followed() -> None:
    message = SimpleNamespace(flag=True, byte=b"\x07", values=np.array([1.5, 2.5]), text="on")
    assert follow(message, "flag") == 1.0
    assert follow(message, "byte") == 7.0
    assert follow(message, "values[1]") == 2.5
    assert np.isnan(follow(message, "values[2]"))
    with pytest.raises(SamplingError, match="text is 'on', which is not a number"):
        follow(message, "text")


@pytest.mark.parametrize("text", ["/cmd:data", "/camera/temperature:temperature", "cmd", "t:readings[0].x"])
def test_a_channel_is_written_as_it_was_read(text: str) -> None:
    assert parse_channel(text).text == text


def test_blanks_around_a_channel_do_not_matter() -> None:
    assert parse_channel(" /cmd : data ") == Channel("/cmd", "data")


@pytest.mark.parametrize("text", ["", "/cmd:", ":data", "/a b:c", "/cmd/:data", "/cmd:da ta", "/cmd:1"])
def test_what_is_not_a_channel_is_refused(text: str) -> None:
    with pytest.raises(SamplingError):
        parse_channel(text)
