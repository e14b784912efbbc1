"""Times as people write them, and the command that takes them."""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path

import pytest

from tests.support.places import SHIPPED
from tests.support.processes import run_twinmatch
from twinmatch.offline.clock_times import ClockTimeError, clock_words, seconds_until


def stamp_of(text: str) -> int:
    return round(datetime.fromisoformat(text).timestamp() * 1e9)


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("07:00", 5400.0),
        ("7:00:30", 5430.0),
        ("05:00", 23.5 * 3600.0),
        ("2026-03-02T05:30", 86_400.0),
        ("+90", 90.0),
        ("+0.5", 0.5),
    ],
)
def test_a_time_of_day_is_the_next_one(text: str, seconds: float) -> None:
    """In the middle of a week without a change of clocks."""
    assert seconds_until(text, stamp_of("2026-03-01T05:30")) == pytest.approx(seconds)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seven", "is not a time"),
        ("25:00", "is not a time"),
        ("2026-02-01T00:00", "is not after the sample"),
        ("+", "is not a time"),
    ],
)
def test_what_is_not_a_time_ahead_is_refused(text: str, message: str) -> None:
    with pytest.raises(ClockTimeError, match=message):
        seconds_until(text, stamp_of("2026-03-01T05:30"))


def test_samples_without_a_date_take_seconds_alone() -> None:
    with pytest.raises(
        ClockTimeError, match=r"have no date, only seconds; give \+SECONDS"
    ):
        seconds_until("07:00", 12_000_000_000)
    assert seconds_until("+60", 12_000_000_000) == 60.0
    assert clock_words(12_000_000_000, 5.0) == ""
    assert clock_words(stamp_of("2026-03-01T05:30"), 90.0) == "05:31:30"


def test_the_command_says_when_and_when_to_begin(tmp_path: Path) -> None:
    out = tmp_path / "answer.json"
    answer = run_twinmatch(
        "forecast",
        SHIPPED,
        "--at",
        "1200",
        "--reach",
        "60",
        "--by",
        "+1200",
        "--json",
        out,
    )
    assert answer.returncode == 0, answer.stderr
    assert "60 °C: first after " in answer.stdout
    assert "to be there after 1200 s" in answer.stdout
    [document] = json.loads(out.read_text("utf-8"))
    assert document["move"] == 60.0
    moved = document["moved"]
    assert moved["earliest"] <= moved["expected"] <= moved["latest"]
    assert (
        1000.0
        < document["beginning"]["safe"]
        <= document["beginning"]["expected"]
        < 1200.0
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--by", "07:00"], "--by needs --reach"),
        ([], "give --at SAMPLE, or --reach LEVEL"),
        (["--reach", "60", "--horizon", "300"], "--reach takes --hold, --by"),
    ],
)
def test_what_does_not_belong_together_is_refused(
    words: list[str], message: str
) -> None:
    refused = run_twinmatch("forecast", SHIPPED, *words)
    assert refused.returncode == 2
    assert message in refused.stderr
