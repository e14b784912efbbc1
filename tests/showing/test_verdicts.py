"""What verdicts say: rows and lines, news, events, and trust over time."""

from __future__ import annotations

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from tests.support.rig import rig
from tests.support.verdicts import CANDIDATE, LED, NONE_YET, verdict
from twinmatch.comparing import ADMITTED, REFUSED, TrustLevel, Verdict
from twinmatch.fitting import Match, Status
from twinmatch.offline.summary import Tally
from twinmatch.showing.lines import Lines, header_text, line_text, redraws
from twinmatch.showing.verdicts import (
    COLUMNS,
    Event,
    EventKind,
    Mark,
    News,
    admitted,
    events,
    level_stretches,
    match_word,
    news,
    row,
)
from twinmatch.twin import MatchReport

UNKNOWN, TRUSTED, DOUBTFUL, FAULT = TrustLevel
STANDS = verdict(FAULT, 0, candidates=(), nu_gap=(), decided=True, fault="unexplained")


def cells(text: str) -> list[str]:
    """What stands below each name of the header, up to the next name."""
    header = header_text()
    names = [name for name in header.split("  ") if name.strip()]
    starts = [header.index(name.strip()) for name in names]
    return [text[a:b].strip() for a, b in zip(starts, [*starts[1:], None], strict=True)]


def test_every_figure_stands_below_its_name_and_the_reason_below_them() -> None:
    line, reason = line_text(LED, 0.5).splitlines()
    assert dict(zip(cells(header_text()), cells(line), strict=True)) == {
        "t / s": "150",
        "level": "trusted",
        "decided": "yes",
        "order": "22221",
        "gain": "1200",
        "ν-gap sum": "0.250",
        "to plant": "0.125",
        "miss y": "0.50",
        "miss u": "0.70",
        "nominal": "50 °C",
        "leader": "sink with mass",
    }
    assert reason == f"        {LED.reason}"
    longest = line_text(replace(LED, leader="sink with mass, free ambient")).splitlines()[0]
    assert len(header_text()) <= len(longest) <= 120


def test_what_is_not_known_is_a_dash() -> None:
    assert set(cells(line_text(NONE_YET).splitlines()[0])[2:]) == {"–"}
    known, unknown = row(verdict(TRUSTED, stands=False)), row(NONE_YET)
    assert len(known) == len(unknown) == len(COLUMNS)
    assert known[1:7] == ("trusted", "–", "50 °C", "22221", "1200", "0.250")
    assert set(unknown[2:10]) == {"–"}


def test_a_fault_is_reported_by_name_and_a_reason_stays_one_line() -> None:
    text = line_text(replace(LED, fault="drive-lost", decided=False, reason="the plate\ndoes not obey"))
    assert text.endswith("drive-lost: the plate does not obey")
    assert cells(text)[2] == "no"
    assert text.count("\n") == 1


def test_a_long_name_does_not_run_into_the_next_column() -> None:
    name = "the paper's candidate for 50 °C"
    assert f"{name}  sink with mass" in line_text(replace(LED, nominal=name))


def test_a_nominal_structure_has_no_order_and_no_gain() -> None:
    """It stands in the family without Box–Jenkins models."""
    sink = replace(CANDIDATE, name="sink with mass", orders=(), chosen_order="")
    told = line_text(replace(LED, nominal=sink.name, candidates=(CANDIDATE, sink)))
    assert re.search(r"yes +– +– +0\.250 .* sink with mass  sink with mass", told)


def test_only_news_are_reported_and_without_wrapping_or_colours(capsys: pytest.CaptureFixture[str]) -> None:
    stream = io.StringIO()
    story = [NONE_YET, NONE_YET, LED, replace(LED, stands=True, sample=360)]
    for view in (Lines(), Lines(1.0, Console(file=stream, width=40))):
        view.open()
        for told in story:
            view.take_verdict(told)
            view.advance(told.sample)
        view.say("[twin] a [bold]word[/] of somebody else's that is longer than forty characters")
        view.close()
    printed = capsys.readouterr().out
    header, line = printed.splitlines()[0], printed.splitlines()[3]
    assert header.index("level") == line.index("trusted")
    first = [line.split()[0] for line in printed.splitlines() if not line.startswith(" ")]
    assert first == ["t", "300", "300", "[twin]"]
    assert "\x1b" not in printed
    assert [line.rstrip() for line in stream.getvalue().splitlines()] == [
        line.rstrip() for line in printed.splitlines()
    ]


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


def test_news_are_what_was_identified_refused_or_changed() -> None:
    """A refused match too: otherwise a first match that is refused would leave no trace in the lines."""
    lost = replace(STANDS, fault="drive-lost")
    cool = replace(STANDS, fault="", decided=False)
    trusted = replace(cool, nominal="70 °C", level=TRUSTED)
    for story, new in (
        ([NONE_YET, NONE_YET, verdict(TRUSTED, stands=False), verdict(TRUSTED)], [0, 2]),
        ([verdict(TRUSTED, stands=False), verdict(TRUSTED, stands=False), verdict(FAULT)], [0, 1, 2]),
        ([verdict(FAULT), verdict(FAULT)], [0]),
        ([STANDS, STANDS, lost, lost, replace(lost, decided=False), cool], [0, 2, 4, 5]),
        ([cool, replace(cool, nominal="70 °C"), trusted, replace(trusted, stands=False)], [0, 1, 2, 3]),
        ([STANDS, STANDS, replace(STANDS, match=REFUSED, reason="match refused"), STANDS], [0, 2]),
    ):
        told = [replace(v, sample=place) for place, v in enumerate(story)]
        assert [v.sample for v in news(told)] == new
    assert News().is_new(verdict(TRUSTED))


def test_the_summary_tells_the_last_refusal() -> None:
    told = [replace(STANDS, match=REFUSED, reason=f"match refused: {k}") for k in range(2)]
    tally = Tally([*told, replace(STANDS, match=ADMITTED, reason="admitted"), STANDS])
    assert tally.refusal == "match refused: 1"
    assert Tally([STANDS]).refusal == ""


def test_a_new_leader_is_reported() -> None:
    story = [verdict(UNKNOWN, 60, nominal=None), verdict(TRUSTED, 120)]
    story += [verdict(TRUSTED, 180, leader=name) for name in ("a", "a", "b")]
    found = [e for e in events(story) if e.kind is EventKind.LEADER]
    assert [(e.title, e.why) for e in found] == [
        ("a leads", "the first with forecasts"),
        ("b leads", "its forecasts are better than those of a"),
    ]


def test_events_come_in_order_with_their_kind_and_reason() -> None:
    lost = {"nominal": "70 °C", "fault": "drive-lost"}
    refused = {"match": REFUSED, "reason": "match refused: on its bound", "miss_y": 3.0, "miss_u": 0.5}
    found = events(
        [
            verdict(UNKNOWN, 60, nominal=None),
            verdict(TRUSTED, 120, match=ADMITTED, reason="matched on these samples"),
            verdict(TRUSTED, 180),
            verdict(DOUBTFUL, 240, nominal="70 °C", **refused),
            verdict(FAULT, 260, reason="why it is so", fault_since=255, **lost),
            verdict(FAULT, 300, fault_since=295, dismissed=("50 °C",), **lost),
        ]
    )
    assert [(e.sample, e.kind) for e in found] == [
        (120, EventKind.ADMITTED),
        (120, EventKind.NOMINAL),
        (120, EventKind.LEVEL),
        (240, EventKind.REFUSED),
        (240, EventKind.NOMINAL),
        (240, EventKind.LEVEL),
        (260, EventKind.FAULT),
        (300, EventKind.DISMISSED),
    ]
    assert (found[0].title, found[0].why) == ("match admitted", "matched on these samples")
    assert (found[3].title, found[3].why) == ("match refused", "on its bound")
    assert found[7].title == "50 °C dismissed"
    assert "output 3.0 and control 0.5 half band widths from the forecast" in found[5].why
    assert found[6] == Event(
        260, EventKind.FAULT, "fault: drive-lost", "why it is so (since sample 255)", Mark.BAD
    )


def report(sample: int, status: Status) -> MatchReport:
    unknown = np.full((1, 1), np.nan)
    match = Match(
        parameters=rig(),
        free=("seebeck",),
        starts={},
        covariance=unknown,
        fisher=unknown,
        eigenvalues=unknown[0],
        condition=1.0,
        bounds_hit=(),
        fit=(0.9, 0.9),  # type: ignore[arg-type]
        held_back=(0.9, 0.9),  # type: ignore[arg-type]
        chi2=1.0,
        samples=(0, sample),
        status=status,
        reason="so it is",
    )
    return MatchReport(sample, 50.0, match)


def test_the_fate_of_a_match_is_the_verdicts_word() -> None:
    """Whatever the gate said: the discriminator may refuse what the gate accepted."""
    told = verdict(TRUSTED, 200, match=REFUSED, reason="no models identified for candidate 50 °C")
    assert match_word(report(200, Status.ACCEPTED), [told]) == "refused"
    assert match_word(report(200, Status.BOUNDS_HIT), [told]) == "refused: a parameter reached its bound"
    assert match_word(report(200, Status.ACCEPTED), []) == ""
    joined = replace(told, match=ADMITTED)
    assert match_word(report(200, Status.ACCEPTED), [joined]) == "admitted"
    assert admitted([told]) == frozenset()
    assert admitted([joined]) == {200}


LOSSES = {"fault": "losses-changed", "fault_since": 410}
LOST = {"fault": "drive-lost"}


@pytest.mark.parametrize(
    ("story", "spans"),
    [
        ([], []),
        # A level is that of the samples since the verdict before.
        (
            [verdict(UNKNOWN, 59), verdict(TRUSTED, 119), verdict(TRUSTED, 179), verdict(FAULT, 239)],
            [(10, 59, UNKNOWN), (60, 179, TRUSTED), (180, 239, FAULT)],
        ),
        # A fault lasts from where it shows, though a verdict came before it was known, to the one without it.
        (
            [
                verdict(TRUSTED, 424),
                verdict(DOUBTFUL, 425, **LOSSES),
                *(verdict(TRUSTED, k) for k in (449, 509)),
            ],
            [(10, 409, TRUSTED), (410, 448, DOUBTFUL), (449, 509, TRUSTED)],
        ),
        (
            [verdict(TRUSTED, 119), *(verdict(FAULT, k, fault_since=k - 5, **LOST) for k in (145, 179))],
            [(10, 139, TRUSTED), (140, 179, FAULT)],
        ),
    ],
    ids=["none", "levels", "past fault", "fault"],
)
def test_trust_over_time(story: list[Verdict], spans: list[tuple[int, int, TrustLevel]]) -> None:
    assert [(s.first, s.last, s.level) for s in level_stretches(story, first=10)] == spans
