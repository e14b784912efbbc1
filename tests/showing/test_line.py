"""Verdicts as plain lines."""

from __future__ import annotations

import io
import math
import re
from dataclasses import replace

import pytest
from rich.console import Console

from tests.support.rig import rig
from twinmatch.comparing import CandidateScore, Criteria, ForecastScore, OrderScore, TrustLevel, Verdict
from twinmatch.offline.summary import SessionSummary
from twinmatch.showing.lines import Lines, header_text, line_text, redraws
from twinmatch.showing.summary import closing_lines, sentence

SCORE = Criteria(1000, 400, 600, 0.6, 1.5, 900.0, 40.0)
CANDIDATE = CandidateScore(
    name="50 °C",
    operating_point=50.0,
    parameters=rig(),
    first=0,
    last=299,
    orders=(OrderScore("22221", SCORE, SCORE, SCORE + SCORE),),
    chosen_order="22221",
    nu_gap_sum=0.25,
    newest=None,
    nu_gap_to_plant=0.125,
)
VERDICT = Verdict(
    sample=300,
    first=0,
    last=299,
    level=TrustLevel.TRUSTED,
    stands=False,
    nominal="50 °C",
    reason="candidate 50 °C matched on samples 0 to 299",
    decimals=2,
    candidates=(CANDIDATE,),
    order="22221",
    nu_gap=((0.0,),),
    driven_rms_y=0.5,
    closed_rms_u=7.0,
    decided=True,
    certainty="50 °C is the only candidate",
    structure="sink with mass",
    structure_parameters=rig(seebeck=0.063),
    leader="sink with mass",
    leader_confidence=0.84,
    forecasts=(ForecastScore("sink with mass", rig(), 0, 299, 9.25, (9.25,), 7.0),),
    miss_y=0.5,
    miss_u=0.7,
)
NONE_YET = replace(
    VERDICT,
    level=TrustLevel.UNKNOWN,
    stands=True,
    nominal=None,
    candidates=(),
    driven_rms_y=math.nan,
    closed_rms_u=math.nan,
    decided=False,
    leader=None,
    forecasts=(),
    miss_y=math.nan,
    miss_u=math.nan,
)


def cells(text: str) -> list[str]:
    """What stands below each name of the header, up to the next name."""
    header = header_text()
    names = [name for name in header.split("  ") if name.strip()]
    starts = [header.index(name.strip()) for name in names]
    return [text[a:b].strip() for a, b in zip(starts, [*starts[1:], None], strict=True)]


def test_every_figure_stands_below_its_name_and_unit() -> None:
    told = dict(zip(cells(header_text()), cells(line_text(VERDICT, 0.5)), strict=True))
    assert told == {
        "t / s": "150",
        "level": "trusted",
        "leader": "sink with mass",
        "nominal": "50 °C",
        "decided": "yes",
        "order": "22221",
        "gain / characters": "1200",
        "ν-gap sum": "0.250",
        "ν-gap to plant": "0.125",
        "miss y / half band": "0.50",
        "miss u / half band": "0.70",
        "why": VERDICT.reason,
    }


def test_what_is_not_known_is_a_dash() -> None:
    assert set(cells(line_text(NONE_YET))[2:-1]) == {"–"}


def test_a_fault_is_reported_by_name_and_a_line_stays_one_line() -> None:
    text = line_text(replace(VERDICT, fault="drive-lost", decided=False, reason="the plate\ndoes not obey"))
    assert text.endswith("drive-lost: the plate does not obey")
    assert cells(text)[3] == "no"


def test_a_long_name_does_not_run_into_the_next_column() -> None:
    name = "the paper's candidate for 50 °C"
    text = line_text(replace(VERDICT, nominal=name, candidates=(replace(CANDIDATE, name=name),)))
    assert f"{name}  22221" in text


def test_only_news_are_reported_and_without_wrapping_or_colours(capsys: pytest.CaptureFixture[str]) -> None:
    stream = io.StringIO()
    story = [NONE_YET, NONE_YET, VERDICT, replace(VERDICT, stands=True, sample=360)]
    for view in (Lines(), Lines(1.0, Console(file=stream, width=40))):
        view.open()
        for verdict in story:
            view.take_verdict(verdict)
            view.advance(verdict.sample)
        view.say("[twin] a [bold]word[/] of somebody else's that is longer than forty characters")
        view.close()
    printed = capsys.readouterr().out
    assert [line.split()[0] for line in printed.splitlines()] == ["t", "300", "300", "[twin]"]
    assert "\x1b" not in printed
    assert [line.rstrip() for line in stream.getvalue().splitlines()] == [
        line.rstrip() for line in printed.splitlines()
    ]


def test_the_end_is_notes_leader_nominal_structure_and_the_sentence() -> None:
    summary = SessionSummary("50 °C", TrustLevel.TRUSTED, None, 0.98, 0.9, 5, 2, {}, notes=("cut short",))
    lines = closing_lines(summary, VERDICT)
    assert lines[0] == "Note: cut short"
    assert (
        lines[1] == "The leader is the twin to ask what comes next, the nominal one the centre of the family."
    )
    assert lines[2] == "Certainty: 50 °C is the only candidate."
    assert lines[3].startswith("Structure: the samples justify sink with mass (α 63.0 mV/K, R 3.30 Ω, ")
    assert lines[3].endswith(", L 5.00 A).")
    assert lines[4] == sentence(summary)
    assert closing_lines(summary, None) == [lines[0], lines[4]]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("stream", "term", "drawn"),
    [
        (Terminal(), "xterm-256color", True),
        (Terminal(), "dumb", False),
        (io.StringIO(), "xterm-256color", False),
    ],
)
def test_a_view_is_redrawn_on_a_terminal_that_can(
    stream: io.StringIO, term: str, drawn: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TERM", term)
    assert redraws(stream) is drawn


def test_a_nominal_structure_has_no_order_and_no_gain() -> None:
    """It stands in the family without Box–Jenkins models."""
    sink = replace(CANDIDATE, name="sink with mass", orders=(), chosen_order="")
    told = line_text(replace(VERDICT, nominal=sink.name, candidates=(CANDIDATE, sink)))
    assert re.search(r"yes +sink with mass +– +– +0\.250", told)
