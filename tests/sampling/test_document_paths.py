"""Paths in documents: each that can be printed can be pasted, and means the same place."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.sampling.channels import Channel, SamplingError
from twinmatch.sampling.document_paths import by_name
from twinmatch.sampling.heard import Heard
from twinmatch.sampling.payloads import (
    document_of,
    numbers_in,
    parse_place,
    place_text,
    value_at,
)
from twinmatch.sampling.sources import parse_map

TEXTS = st.text(max_size=6) | st.sampled_from(
    [
        "light:0",
        "a b",
        "a;b",
        "a,b",
        "a=b",
        '"',
        "\\",
        "[x]",
        "0",
        "007",
        "é",
        "a.b",
        " a",
        "\x07",
        "n",
        "id",
    ]
)
DOCUMENTS = st.recursive(
    st.floats(allow_nan=False, allow_infinity=False),
    lambda inner: (
        st.dictionaries(TEXTS, inner, min_size=1, max_size=3)
        | st.lists(inner, min_size=1, max_size=3)
        | st.lists(
            st.fixed_dictionaries({"n": TEXTS, "v": inner}), min_size=1, max_size=3
        )
    ),
    max_leaves=8,
)
TOPICS = st.lists(
    st.text(
        st.characters(exclude_categories=["Cs"], exclude_characters="\0#+"),
        min_size=1,
        max_size=8,
    )
    | st.sampled_from(
        ["light:0", "aa:bb:cc:dd:ee:ff", "a;b", 'say "x"', "a, b", "rpc:params.x"]
    ),
    min_size=1,
    max_size=3,
).map("/".join)


@given(TOPICS, DOCUMENTS)
def test_every_place_that_is_printed_can_be_pasted(topic: str, document: Any) -> None:
    sent = document_of(json.dumps(document).encode())
    for path, value in numbers_in(sent):
        text = place_text(Channel(topic, path))
        assert text.isprintable()
        source = parse_map([f"output={text}; scale=2"]).sources["output"]
        [channel] = source.channels("output", parse_place)
        assert channel.topic == topic
        assert value_at(sent, channel.path) == value


@pytest.mark.parametrize(
    ("text", "topic", "path"),
    [
        (
            "shelly/events/rpc:params.light:0.brightness",
            "shelly/events/rpc",
            "params.light:0.brightness",
        ),
        ("shelly/status/light:0:brightness", "shelly/status/light:0", "brightness"),
        ("shelly/status/temperature:100", "shelly/status/temperature:100", ""),
        ("home/a4:c1:38:00:11:22", "home/a4:c1:38:00:11:22", ""),
        ("a4:c1:38:00:11:22/t:value", "a4:c1:38:00:11:22/t", "value"),
        ('"a:b":value', "a:b", "value"),
        ("senml/tank:[n=temp].v", "senml/tank", "[n=temp].v"),
    ],
)
def test_topics_and_keys_may_have_colons(text: str, topic: str, path: str) -> None:
    assert parse_place(text) == Channel(topic, path)


def test_a_key_with_a_colon_needs_no_brackets() -> None:
    document = {"params": {"light:0": {"brightness": 60}}}
    assert value_at(document, "params.light:0.brightness") == 60.0
    assert value_at(document, "params.[light:0].brightness") == 60.0


TANK = [{"bn": "tank/", "n": "temp", "v": 21.5}, {"n": "duty", "v": 60}]


@pytest.mark.parametrize("order", [1, -1])
def test_an_element_is_chosen_by_its_name_wherever_it_stands(order: int) -> None:
    assert value_at(TANK[::order], "[n=temp].v") == 21.5
    assert value_at(TANK[::order], "[n=duty].v") == 60.0
    assert value_at(TANK[::order], "[n=level].v") is None
    assert [path for path, _ in numbers_in(TANK)] == ["[n=temp].v", "[n=duty].v"]


def test_an_index_into_elements_with_names_is_known_by_these() -> None:
    assert by_name(TANK, "[1].v") == "[n=duty].v"
    assert by_name([{"v": 1}, {"v": 2}], "[1].v") == "[1].v"


def test_a_name_that_two_elements_have_is_refused() -> None:
    with pytest.raises(SamplingError, match="2 elements of a list have n=a"):
        value_at([{"n": "a", "v": 1}, {"n": "a", "v": 2}], "[n=a].v")


def test_of_messages_with_parts_all_parts_are_listed() -> None:
    heard = Heard()
    heard.take("shelly/rpc", b'{"params": {"temperature:100": {"tC": 21.5}}}')
    heard.take("shelly/rpc", b'{"params": {"light:0": {"brightness": 60}}}')
    heard.take("esp/climate", b"cooling")
    heard.take("unit/t", "20.6 ℃".encode())
    heard.take("probe", b"-127")
    assert list(heard.lines()) == [
        "esp/climate  'cooling' = -1",
        "probe  -127  (no sensor? then write '; missing=-127')",
        "shelly/rpc:params[temperature:100].tC  21.5",
        "shelly/rpc:params[light:0].brightness  60",
        "unit/t  '20.6 ℃' = 20.6 ℃",
    ]


def test_binary_payloads_and_names_reach_no_terminal_as_they_are() -> None:
    heard = Heard()
    heard.take("spBv1.0/plant/DDATA/node", b"\x08\xd0\x0f\x1b[2J")
    heard.take("blob", b"\x00\x1b[2J\xff")
    heard.take("bell\x07", b"21.5")
    lines = list(heard.lines())
    assert all(line.isprintable() for line in lines)
    assert "Sparkplug B, which is binary and not read here" in lines[2]
    assert "binary bytes" in lines[1]
    with pytest.raises(SamplingError, match="Sparkplug B"):
        parse_place("spBv1.0/plant/DDATA/node:x")
