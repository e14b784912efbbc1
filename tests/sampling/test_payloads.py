"""Payloads of MQTT as numbers: JSON, words, times, and neither."""

from __future__ import annotations

import json
import math
import random
from datetime import datetime, timezone
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.sampling.channels import Channel, SamplingError
from twinmatch.sampling.payloads import (
    absence,
    document_of,
    numbers_in,
    parse_place,
    stamp_at,
    value_at,
)
from twinmatch.sampling.written_numbers import written_number

KEYS = st.text(
    st.characters(categories=["L", "Nd"], include_characters=" -_"), min_size=1
).filter(lambda key: key == key.strip() and key[0].isascii() and key[0].isalpha())
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
DOCUMENTS = st.recursive(
    NUMBERS,
    lambda inner: (
        st.dictionaries(KEYS, inner, min_size=1) | st.lists(inner, min_size=1)
    ),
    max_leaves=8,
)


def number_at(document: Any, path: str) -> float:
    """The number at a path, as a signal has it."""
    value = value_at(document, path)
    if value is None:
        raise SamplingError(absence(document, path))
    return written_number(value).value if isinstance(value, str) else value


def leaves(document: Any) -> list[float]:
    if isinstance(document, dict | list):
        below = document.values() if isinstance(document, dict) else document
        return [leaf for child in below for leaf in leaves(child)]
    return [document]


@given(DOCUMENTS)
def test_every_number_that_is_listed_is_found_at_its_path(document: Any) -> None:
    sent = document_of(json.dumps(document).encode())
    listed = list(numbers_in(sent))
    for path, value in listed:
        assert number_at(sent, path) == value
    if len(listed) == 1:
        assert number_at(sent, "") == listed[0][1]
    if json.dumps(document).count("{") + json.dumps(document).count("[") < 8:
        # the depth that is listed
        assert [value for _, value in listed] == leaves(document)


@pytest.mark.parametrize(
    ("payload", "path", "number"),
    [
        (b"21.5", "", 21.5),
        (b" 21.5\n", "", 21.5),
        (b'"21.5"', "", 21.5),
        (b"ON", "", 1.0),
        (b"off", "", 0.0),
        (b"true", "", 1.0),
        (b'{"state": "heating"}', "state", 1.0),
        (b'{"temperature": 21.5, "battery": 100}', "temperature", 21.5),
        (b'{"DS18B20": {"Temperature": 21.5}}', "DS18B20.Temperature", 21.5),
        (b'{"Living room": {"t": [20, 21.5]}}', "[Living room].t[1]", 21.5),
        (b"[20, 21.5]", "[1]", 21.5),
    ],
)
def test_what_home_automation_sends_is_a_number(
    payload: bytes, path: str, number: float
) -> None:
    assert number_at(document_of(payload), path) == number


@pytest.mark.parametrize(
    ("payload", "path", "words"),
    [
        (b"unavailable", "", "'unavailable' is not a number"),
        (b"", "", "'' is not a number"),
        (b"null", "", "its numbers: none, it is 'None'"),
        (b'{"a": 1, "b": 2}', "", "choose one: a, b"),
        (b'{"a": 1, "b": {"c": 2}}', "t", "no 't'; its numbers: a, b.c"),
        (b"21.5", "t", "no 't'; its numbers: none, it is '21.5'"),
        (b'{"a": [1]}', "a[3]", "no 'a[3]'"),
        (b'{"a": {"b": 1, "c": 2}}', "a", "choose one"),
        (b"\xff\xfe", "", "is not a number"),
    ],
)
def test_what_lacks_a_number_is_refused_with_those_there_are(
    payload: bytes, path: str, words: str
) -> None:
    with pytest.raises(SamplingError) as caught:
        number_at(document_of(payload), path)
    assert words in str(caught.value)


def number_or_refusal(payload: bytes, path: str) -> str:
    """The number in a payload, or why there is none."""
    try:
        return str(number_at(document_of(payload), path))
    except SamplingError as error:
        return str(error)


def test_ten_thousand_malformed_payloads_are_errors_of_one_kind() -> None:
    random_bytes = random.Random(3)
    good = b'{"room": {"temperature": 21.5, "at": [1, 2, {"x": "y"}]}}'
    for k in range(10_000):
        mangled = bytearray(good * random_bytes.randint(0, 2))
        for _ in range(random_bytes.randint(1, 5)):
            where = random_bytes.randint(0, len(mangled))
            mangled[where : where + random_bytes.randint(0, 9)] = (
                random_bytes.randbytes(k % 7)
            )
        assert number_or_refusal(bytes(mangled), "room.temperature").isprintable(), (
            mangled
        )


@pytest.mark.parametrize(
    "payload", [b"[" * 100_000, b"9" * 10_000, b'{"a":' * 5000, b"0" * 2_000_000]
)
def test_payloads_that_are_long_or_deep_do_no_harm(payload: bytes) -> None:
    assert 0 < len(number_or_refusal(payload, "")) < 200


@pytest.mark.parametrize(
    ("time", "seconds"),
    [
        (1_700_000_000, 1_700_000_000.0),
        (1_700_000_000.25, 1_700_000_000.25),
        (1_700_000_000_250, 1_700_000_000.25),
        ("2023-11-14T22:13:20Z", 1_700_000_000.0),
        ("2023-11-14T23:13:20.500+01:00", 1_700_000_000.5),
        (
            datetime.fromtimestamp(1_700_000_000, timezone.utc)
            .astimezone()
            .replace(tzinfo=None)
            .isoformat(),
            1.7e9,
        ),
    ],
)
def test_times_of_many_forms_are_the_same_moment(time: Any, seconds: float) -> None:
    assert stamp_at({"sent": {"at": time}}, "sent.at") == round(seconds * 1e9)


@pytest.mark.parametrize("time", ["yesterday", None, [1], math.inf])
def test_what_lacks_a_time_is_refused(time: Any) -> None:
    with pytest.raises(SamplingError, match="no time at 'at'"):
        stamp_at({"at": time}, "at")


def test_places_are_topics_with_paths() -> None:
    assert parse_place("home/room/t") == Channel("home/room/t", "")
    assert parse_place(" home/Living room : a.b[0] ") == Channel(
        "home/Living room", "a.b[0]"
    )
    for text in ("", ":a", "home/#", "home/+/t", "a:b c"):
        with pytest.raises(SamplingError):
            parse_place(text)
