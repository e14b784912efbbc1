"""Texts of devices as numbers: words, units, commas; and what must not become a number."""

from __future__ import annotations

import pytest

from twinmatch.sampling.channels import UnreadableError
from twinmatch.sampling.sources import parse_source
from twinmatch.sampling.written_numbers import written_number
from twinmatch.sessions.files import RecordingError


@pytest.mark.parametrize(
    ("text", "value", "unit"),
    [
        ("heat", 1.0, ""),
        ("Heating", 1.0, ""),
        ("preheating", 1.0, ""),
        ("idle", 0.0, ""),
        ("fan", 0.0, ""),
        ("fan_only", 0.0, ""),
        ("cool", -1.0, ""),
        ("cooling", -1.0, ""),
        ("17.99 °C", 17.99, "°C"),
        ("20.6 ℃", 20.6, "℃"),
        ("0%", 0.0, "%"),
        ("21,5", 21.5, ""),
        ("-3,25 kW", -3.25, "kW"),
        ("−4.5 °C", -4.5, "°C"),
        ("0,125", 0.125, ""),
        ("1e3", 1000.0, ""),
        ("12 m³/h", 12.0, "m³/h"),
        ("12 m3/h", 12.0, "m3/h"),
        ("3 /min", 3.0, "/min"),
    ],
)
def test_what_devices_write_is_a_number_with_its_unit(
    text: str, value: float, unit: str
) -> None:
    assert written_number(text) == (value, unit)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "blah",
        "unavailable",
        "drying",
        "defrosting",
        "1.2.3",
        "1_000",
        "12:30",
        "1,234",
    ],
)
def test_what_is_not_a_number_or_may_be_two_is_refused_with_its_text(text: str) -> None:
    with pytest.raises(UnreadableError) as caught:
        written_number(text)
    assert repr(text) in str(caught.value)


def test_a_map_gives_numbers_to_words_and_to_none_but_these() -> None:
    source = parse_source(
        "here",
        "zigbee2mqtt/bath:running_state; scale=80; Drying=0.5; cooling=0; unavailable=0",
    )
    assert source.words == {"drying": 0.5, "cooling": 0.0, "unavailable": 0.0}
    assert [source.number(text, "%") for text in ("drying", "cooling", "heat")] == [
        0.5,
        0.0,
        1.0,
    ]
    assert parse_source("here", source.text) == source
    with pytest.raises(UnreadableError):
        source.number("defrosting", "%")


@pytest.mark.parametrize(
    "setting", ["scael=0.1", "units=K", "factor=2", "offest=1", "Scale=2"]
)
def test_a_misspelt_setting_is_not_taken_for_a_word(setting: str) -> None:
    with pytest.raises(RecordingError):
        parse_source("here", f"T; {setting}")


def test_a_unit_in_a_value_is_converted_to_that_of_the_signal() -> None:
    plain = parse_source("here", "room/t")
    assert plain.number("68 °F", "°C") == pytest.approx(20.0)
    assert plain.number("50%", "1") == pytest.approx(0.5)
    assert parse_source("here", "room/t; unit=K").number(
        "20 °C", "°C"
    ) == pytest.approx(293.15)
    # the map says what it means
    assert parse_source("here", "room/t; scale=2").number("20 V", "°C") == 20.0
    for text in ("20 V", "20 wibble"):
        with pytest.raises(UnreadableError, match="is not in °C"):
            plain.number(text, "°C")


def test_numbers_that_mean_no_value_are_refused() -> None:
    source = parse_source("here", "holding/4; scale=0.1; missing=-32768 32767")
    assert source.number(-32767.0, "°C") == -32767.0
    for mark in (-32768.0, 32767.0):
        with pytest.raises(UnreadableError, match="means that there is no value"):
            source.number(mark, "°C")
    assert parse_source("here", source.text) == source
