"""What verdicts say: rows and lines, news, events, and trust over time."""

from __future__ import annotations

import io
import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.plants import Tank
from tests.support.rig import rig
from tests.support.verdicts import CANDIDATE, LED, NONE_YET, verdict
from twinmatch.comparing import ADMITTED, REFUSED, TrustLevel, TrustStatement, Verdict
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import Match, Status
from twinmatch.offline.summary import (
    LevelStretch,
    SessionSummary,
    Tally,
    TrustRange,
    held_levels,
    summarise,
)
from twinmatch.plants import Peltier
from twinmatch.showing.console import Console
from twinmatch.showing.figures.session import draw_verdict
from twinmatch.showing.lines import Lines, header_text, line_text
from twinmatch.showing.summary import closing_lines, document, sentence
from twinmatch.showing.verdicts import (
    Event,
    EventKind,
    Mark,
    News,
    admitted,
    events,
    match_word,
    row,
)
from twinmatch.signals import Sample, stretches
from twinmatch.twin import MatchReport, TwinSettings

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
        "t / s": "150.0",
        "level": "trusted",
        "decided": "yes",
        "order": "22221",
        "gain": "1200",
        "Σ ν-gap": "0.250",
        "ν-gap now": "0.125",
        "miss y": "0.50",
        "miss u": "0.70",
        "nominal": "50 °C",
        "leader": "sink with mass",
    }
    assert reason == f"        {LED.reason}"
    longest = line_text(
        replace(LED, leader="sink with mass, free ambient")
    ).splitlines()[0]
    assert len(header_text()) <= len(longest) <= 120


def test_what_is_not_known_is_a_dash() -> None:
    assert set(cells(line_text(NONE_YET).splitlines()[0])[2:]) == {"–"}
    known_row = row(verdict(TRUSTED, stands=False))
    unknown_row = row(NONE_YET)
    assert list(known_row) == list(unknown_row)
    assert list(known_row.values())[1:6] == ["trusted", "–", "22221", "1200", "0.250"]
    assert set(list(unknown_row.values())[2:11]) == {"–"}


def test_a_fault_is_reported_by_name_and_a_reason_stays_one_line() -> None:
    text = line_text(
        replace(
            LED, fault="drive-lost", decided=False, reason="the plate\ndoes not obey"
        )
    )
    assert text.endswith("drive-lost: the plate does not obey")
    assert cells(text)[2] == "no"
    assert text.count("\n") == 1


def test_of_a_slow_fault_a_line_says_what_was_found_and_not_only_its_name() -> None:
    doubtful = replace(
        LED,
        level=TrustLevel.DOUBTFUL,
        level_reason="the plant shows sensor-drift",
        reason="the readings of T1 are off by about +5 °C",
    )
    faulty = replace(doubtful, fault="sensor-drift")
    assert line_text(faulty).endswith(f"sensor-drift: {doubtful.reason}")
    assert line_text(doubtful).endswith(doubtful.level_reason)


def test_a_long_name_does_not_run_into_the_next_column() -> None:
    name = "the paper's candidate for 50 °C"
    assert f"{name}  sink with mass" in line_text(replace(LED, nominal=name))


def test_a_nominal_structure_has_no_order_and_no_gain() -> None:
    """It stands in the family without Box–Jenkins models."""
    sink = replace(CANDIDATE, name="sink with mass", orders=(), chosen_order="")
    line = line_text(replace(LED, nominal=sink.name, candidates=(CANDIDATE, sink)))
    assert re.search(r"yes +– +– +0\.250 .* sink with mass  sink with mass", line)


def test_only_news_are_reported_and_without_wrapping_or_colours(
    capsys: pytest.CaptureFixture[str],
) -> None:
    stream = io.StringIO()
    story = [NONE_YET, NONE_YET, LED, replace(LED, stands=True, sample=360)]
    for view in (Lines(), Lines(1.0, Console(file=stream, width=40))):
        view.open()
        for news in story:
            view.take_verdict(news)
            view.advance(news.sample)
        view.say(
            "[twin] a [bold]word[/] of somebody else's that is longer than forty characters"
        )
        view.close()
    printed = capsys.readouterr().out
    header = printed.splitlines()[0]
    line = printed.splitlines()[3]
    assert header.index("level") == line.index("trusted")
    first = [
        line.split()[0] for line in printed.splitlines() if not line.startswith(" ")
    ]
    assert first == ["t", "300", "300", "[twin]"]
    assert "\x1b" not in printed
    assert [line.rstrip() for line in stream.getvalue().splitlines()] == [
        line.rstrip() for line in printed.splitlines()
    ]


def test_news_are_what_was_identified_refused_or_changed() -> None:
    """A refused match too: otherwise a first match that is refused would leave no trace in the lines."""
    lost = replace(STANDS, fault="drive-lost")
    cool = replace(STANDS, fault="", decided=False)
    trusted = replace(cool, nominal="70 °C", level=TRUSTED)
    for story, new in (
        (
            [NONE_YET, NONE_YET, verdict(TRUSTED, stands=False), verdict(TRUSTED)],
            [0, 2],
        ),
        (
            [
                verdict(TRUSTED, stands=False),
                verdict(TRUSTED, stands=False),
                verdict(FAULT),
            ],
            [0, 1, 2],
        ),
        ([verdict(FAULT), verdict(FAULT)], [0]),
        (
            [STANDS, STANDS, lost, lost, replace(lost, decided=False), cool],
            [0, 2, 4, 5],
        ),
        (
            [
                cool,
                replace(cool, nominal="70 °C"),
                trusted,
                replace(trusted, stands=False),
            ],
            [0, 1, 2, 3],
        ),
        (
            [
                STANDS,
                STANDS,
                replace(STANDS, match=REFUSED, reason="match refused"),
                STANDS,
            ],
            [0, 2],
        ),
    ):
        verdicts = [replace(v, sample=place) for place, v in enumerate(story)]
        so_far = News()
        assert [v.sample for v in verdicts if so_far.is_new(v)] == new
    assert News().is_new(verdict(TRUSTED))


def test_the_summary_tells_the_last_refusal() -> None:
    refused = [
        replace(STANDS, match=REFUSED, reason=f"match refused: {k}") for k in range(2)
    ]
    tally = Tally(
        [*refused, replace(STANDS, match=ADMITTED, reason="admitted"), STANDS]
    )
    assert tally.refusal == "match refused: 1"
    assert Tally([STANDS]).refusal == ""


def test_a_new_leader_is_reported() -> None:
    story = [verdict(UNKNOWN, 60, nominal=None), verdict(TRUSTED, 120)]
    story += [verdict(TRUSTED, 180, leader=name) for name in ("a", "a", "b")]
    reasons = {e.title: e.why for e in events(story) if e.kind is EventKind.LEADER}
    better = "its forecasts are better than those of a"
    assert reasons == {"a leads": "the first with forecasts", "b leads": better}


def test_events_come_in_order_with_their_kind_and_reason() -> None:
    lost = {"nominal": "70 °C", "fault": "drive-lost"}
    refused = {
        "match": REFUSED,
        "reason": "match refused: on its bound",
        "miss_y": 3.0,
        "miss_u": 0.5,
        "miss_since": 181,
    }
    reported = events(
        [
            verdict(UNKNOWN, 60, nominal=None),
            verdict(TRUSTED, 120, match=ADMITTED, reason="matched on these samples"),
            verdict(TRUSTED, 180),
            verdict(DOUBTFUL, 240, nominal="70 °C", **refused),
            verdict(FAULT, 260, reason="why it is so", fault_since=255, **lost),
            verdict(FAULT, 300, fault_since=295, dismissed=("50 °C",), **lost),
        ]
    )
    assert [(e.sample, e.kind) for e in reported] == [
        (120, EventKind.ADMITTED),
        (120, EventKind.NOMINAL),
        (120, EventKind.LEVEL),
        (240, EventKind.REFUSED),
        (240, EventKind.NOMINAL),
        (240, EventKind.LEVEL),
        (260, EventKind.FAULT),
        (300, EventKind.DISMISSED),
    ]
    assert (reported[0].title, reported[0].why) == (
        "match admitted",
        "matched on these samples",
    )
    assert (reported[3].title, reported[3].why) == ("match refused", "on its bound")
    assert reported[7].title == "50 °C dismissed"
    assert (
        "output 3.0 and control 0.5 half band widths from the forecast"
        in reported[5].why
    )
    assert reported[6] == Event(
        260,
        EventKind.FAULT,
        "fault: drive-lost",
        "why it is so (since sample 255)",
        Mark.BAD,
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
    refusing = verdict(
        TRUSTED, 200, match=REFUSED, reason="no models identified for candidate 50 °C"
    )
    assert match_word(report(200, Status.ACCEPTED), [refusing]) == "refused"
    assert (
        match_word(report(200, Status.BOUNDS_HIT), [refusing])
        == "refused: a parameter reached its bound"
    )
    assert match_word(report(200, Status.ACCEPTED), []) == ""
    joined = replace(refusing, match=ADMITTED)
    assert match_word(report(200, Status.ACCEPTED), [joined]) == "admitted"
    assert admitted([refusing]) == frozenset()
    assert admitted([joined]) == {200}


LOSSES = {"fault": "losses-changed", "fault_since": 410}
DRIVE = {"fault": "drive-lost"}


@pytest.mark.parametrize(
    ("story", "spans"),
    [
        ([], []),
        # A level is that of the samples since the verdict before.
        (
            [
                verdict(UNKNOWN, 59),
                verdict(TRUSTED, 119),
                verdict(TRUSTED, 179),
                verdict(FAULT, 239),
            ],
            [(10, 59, UNKNOWN), (60, 179, TRUSTED), (180, 239, FAULT)],
        ),
        # The level of a fault lasts from the verdict that names it to the one without it.
        (
            [
                verdict(TRUSTED, 424),
                verdict(DOUBTFUL, 425, **LOSSES),
                *(verdict(TRUSTED, k) for k in (449, 509)),
            ],
            [(10, 424, TRUSTED), (425, 448, DOUBTFUL), (449, 509, TRUSTED)],
        ),
        (
            [
                verdict(TRUSTED, 119),
                *(verdict(FAULT, k, fault_since=k - 5, **DRIVE) for k in (145, 179)),
            ],
            [(10, 144, TRUSTED), (145, 179, FAULT)],
        ),
    ],
    ids=["none", "levels", "past fault", "fault"],
)
def test_stretches_of_trust_and_faults_begin_and_end_with_their_samples(
    story: list[Verdict], spans: list[tuple[int, int, TrustLevel]]
) -> None:
    assert [(s.first, s.last, s.level) for s in Tally(story, 10).stretches] == spans


# What a session comes down to: one line, the last lines, where forecasts held, JSON, a picture.


SINK = Peltier.model("sink with mass").parameters()
TRUST = TrustStatement(TrustLevel.TRUSTED, "", (10.0, 60.0, 300.0))
SUMMARY = SessionSummary(
    leader="50 °C",
    nominal="70 °C",
    trust=TRUST,
    parameters=rig(),
    fit_y=0.9881,
    fit_u=0.9,
    verdicts=5,
    identified=2,
    matches={},
    order="22221",
    range=TrustRange(((24.3, 92.7),), "°C"),
)


FIT = "temperature fit 98.8 %"
HELD = "10, 60 and 300 s ahead between 25 and 92 °C"
ARX = "10 s ahead its forecasts are worse than saying that nothing changes, with 1.10 times the error"
UNTOLD = TRUST._replace(level=UNKNOWN)
NONE = {"leader": None, "nominal": None, "trust": UNTOLD}
LOST_NOW = TRUST._replace(level=FAULT, reason="the plant shows drive-lost")
NO_MATCH = "No twin to trust yet: 5 verdicts, but no valid match."
LOST = LevelStretch(310, 400, FAULT, "drive-lost")
SINCE = {"trust": LOST_NOW, "stretches": (LOST, LOST)}
OVER = {"stretches": (LOST, LevelStretch(401, 500, TRUSTED))}


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({}, f"Leader: match at 50 °C; trust it {HELD}; {FIT}."),
        (
            {"leader": SINK.model.structure_name, "parameters": SINK},
            f"Leader: sink with mass; trust it {HELD}; {FIT}.",
        ),
        ({"closed": False}, f"Leader: match near 50 °C; trust it {HELD}; {FIT}."),
        ({"leader": None}, f"Nominal: match at 70 °C; trust it {HELD}; {FIT}."),
        (
            {"trust": TRUST._replace(horizons=(60.0, 300.0), doubts=ARX)},
            f"Leader: match at 50 °C; trust it 60 and 300 s ahead between 25 and 92 °C, but {ARX}; {FIT}.",
        ),
        (
            {
                "trust": TRUST._replace(
                    level=DOUBTFUL,
                    reason="no match explains the newest window",
                    doubts=ARX,
                )
            },
            "Leader: match at 50 °C; doubtful now: no match explains the newest window "
            f"(its forecasts held {HELD}); {FIT}.",
        ),
        (
            {**SINCE, "period": 0.5},
            "Leader: match at 50 °C; do not trust it now: the plant shows drive-lost "
            f"(its forecasts held {HELD}). Faults: drive-lost from 155.0 to 200.0 s; drive-lost since 155.0 s.",
        ),
        (
            {**SINCE, "range": None, "stretches": ()},
            "Leader: match at 50 °C; do not trust it now: the plant shows drive-lost.",
        ),
        (
            OVER,
            f"Leader: match at 50 °C; trust it {HELD}; {FIT}. Faults: drive-lost from 310 to 400 s.",
        ),
        (
            {"fit_y": -1.003},
            f"Leader: match at 50 °C; trust it {HELD}; left without readings it drifts off "
            "(temperature fit −100.3 %).",
        ),
        (
            {"range": None},
            f"Leader: match at 50 °C; how far to trust it is not known yet; {FIT}.",
        ),
        (
            {"trust": TRUST._replace(horizons=())},
            f"Leader: match at 50 °C; how far to trust it is not known yet; {FIT}.",
        ),
        (
            {"trust": UNTOLD._replace(reason="its input acts late")},
            f"Leader: match at 50 °C; how far to trust it is not known yet: its input acts late; {FIT}.",
        ),
        (
            NONE,
            f"{NO_MATCH} The loop needs set-point steps far above the noise, some minutes apart.",
        ),
        (
            {**NONE, "closed": False},
            f"{NO_MATCH} The input has to move far above its noise, for some minutes in total.",
        ),
        (
            {**NONE, "trust": UNTOLD._replace(reason="its input acts late")},
            f"{NO_MATCH} Its input acts late.",
        ),
        (
            {**NONE, "refusal": "match refused: C ended on 5 J/K", **OVER},
            f"{NO_MATCH} Match refused: C ended on 5 J/K. Faults: drive-lost from 310 to 400 s.",
        ),
        (
            {**NONE, "trust": LOST_NOW},
            "No twin to trust yet: the plant shows drive-lost. Look at the plant first.",
        ),
    ],
)
def test_one_sentence_says_what_to_trust_how_far_and_which_faults_there_were(
    changes: dict[str, object], text: str
) -> None:
    assert sentence(replace(SUMMARY, **changes)) == text  # type: ignore[arg-type]


def test_the_end_is_notes_structure_the_sentence_and_below_it_the_family() -> None:
    summary = replace(SUMMARY, nominal="50 °C", notes=("cut short",))
    lines = closing_lines(summary, LED)
    assert lines[0] == "Note: cut short"
    assert lines[1].startswith(
        "Structure: the samples justify sink with mass (α 63.0 mV/K, R 3.30 Ω, "
    )
    assert lines[1].endswith(", L 5.00 A).")
    assert lines[2:] == [
        sentence(summary),
        "Nominal, the centre of the family: match at 50 °C (orders 22221).",
        "Certainty: 50 °C is the only candidate.",
    ]
    assert closing_lines(summary, None) == [lines[0], *lines[2:4]]
    of_structure = replace(summary, nominal="sink with mass", order="")
    assert (
        closing_lines(of_structure, None)[-1]
        == "Nominal, the centre of the family: sink with mass."
    )
    assert closing_lines(replace(summary, nominal=None, order=None), None)[
        -1
    ] == sentence(summary)


def test_the_sentence_names_the_newest_faults() -> None:
    lost = {"fault": "drive-lost", "fault_since": 310}
    verdicts = [
        verdict(TrustLevel.TRUSTED),
        verdict(TrustLevel.FAULT, 320, **lost),
        verdict(TrustLevel.FAULT, 360, **lost),
        verdict(TrustLevel.UNKNOWN, 400),
        verdict(TrustLevel.DOUBTFUL, 500, fault="room-changed", fault_since=470),
    ]
    stretches = tuple(Tally(verdicts).stretches)
    assert [s for s in stretches if s.fault] == [
        LevelStretch(320, 399, FAULT, "drive-lost", 310),
        LevelStretch(500, 500, DOUBTFUL, "room-changed", 470),
    ]
    often = sentence(replace(SUMMARY, stretches=stretches * 4))
    assert (
        " Faults: 3 before; room-changed from 470 to 500 s; drive-lost from 310 to 399 s; "
        in often
    )
    assert often.endswith("; room-changed since 470 s.")


def test_a_level_is_drawn_from_where_it_was_stated_not_from_where_the_fault_began() -> (
    None
):
    lies = {"fault": "sensor-drift", "fault_since": 546}
    verdicts = [
        verdict(TrustLevel.TRUSTED, 900),
        verdict(TrustLevel.DOUBTFUL, 1022, **lies),
        verdict(TrustLevel.DOUBTFUL, 1100, **lies),
    ]
    trusted, doubtful = Tally(verdicts, 0).stretches
    assert (trusted.times(1.0), doubtful.times(1.0)) == (
        "0 to 1021 s",
        "1022 to 1100 s",
    )
    assert doubtful.fault_times(1.0) == "546 to 1100 s"
    at_once = Tally(verdicts[1:], 0).stretches
    assert [(s.level, s.first) for s in at_once] == [(UNKNOWN, 0), (DOUBTFUL, 1022)]


def test_without_a_leader_there_is_nothing_to_doubt() -> None:
    behind = replace(
        LED.forecasts[0], persistence_skill=(-0.5,), persistence_skill_high=(-0.4,)
    )
    doubtful = replace(LED, horizons=(10.0,), forecasts=(behind,))
    assert doubtful.doubts.endswith(
        "than saying that nothing changes, with 1.50 times the error"
    )
    assert replace(doubtful, leader=None).doubts == ""


def test_where_forecasts_held_is_rounded_to_the_inside_and_to_the_plants_places() -> (
    None
):
    held_range = held_levels(Peltier, [(22.3, 89.7)])
    assert held_range == TrustRange(((22.3, 89.7),), "°C")
    assert str(held_range) == "between 23 and 89 °C"
    # Readings of the tank have a noise of 0.005 l/s; in whole litres there would be no range at all.
    assert str(held_levels(Tank, [(0.612, 0.977)])) == "between 0.62 and 0.97 l/s"
    # nothing is left to round away
    assert str(TrustRange(((0.302, 0.309),), "l/s", 2)) == "between 0.30 and 0.31 l/s"
    assert held_levels(Peltier, []) is None


def test_all_levels_at_which_forecasts_held_are_named_or_the_widest() -> None:
    """A verdict knows the range around the newest reading: being at 30 °C takes nothing away from 90."""
    ranges = [
        (81.5, 85.0),
        (80.5, 92.7),
        (math.nan, math.nan),
        (24.3, 30.0),
        (24.3, 33.0),
    ]
    tally = Tally(replace(LED, held_low=low, held_high=high) for low, high in ranges)
    assert tally.held == [(24.3, 33.0), (80.5, 92.7)]
    assert (
        str(held_levels(Peltier, tally.held))
        == "between 25 and 33 °C and between 81 and 92 °C"
    )
    many = TrustRange(
        ((10.0, 10.5), (20.0, 23.0), (30.0, 31.0), (40.0, 46.0), (50.0, 55.0)), "°C"
    )
    assert (
        str(many)
        == "between 20 and 23 °C, between 40 and 46 °C and between 50 and 55 °C"
    )


MATCHED = [verdict(TrustLevel.TRUSTED, stands=False)]
GAINS = TwinSettings().law


def samples(count: int = 400) -> list[Sample]:
    return [
        Sample(k, k * 10**9, 50.0 + (k > 200) * 10, 50.0 + 0.01 * k, 90.0 + k % 3)
        for k in range(count)
    ]


def test_the_document_is_strict_json() -> None:
    verdicts = [NONE_YET, *MATCHED]
    entry = document(
        "s", verdicts, summarise(stretches(samples(), 1.0), verdicts, GAINS)
    )
    back = json.loads(json.dumps(entry, allow_nan=False))
    assert (
        back["verdicts"][0]["driven_rms_y"],
        back["verdicts"][0]["closed_rms_u"],
    ) == (None, None)
    assert back["verdicts"][1]["candidates"][0]["parameters"]["seebeck"] == 0.06
    assert back["verdicts"][1]["candidates"][0]["orders"][0]["total"]["gain"] == 1200


def test_the_figure_is_drawn_of_a_session_with_gaps_too(tmp_path: Path) -> None:
    broken = samples()[:100] + samples()[150:]
    path = tmp_path / "verdict.pdf"
    draw_verdict(broken, MATCHED, TwinSettings(), stretches(broken, 1.0), path)
    assert path.stat().st_size > 5000
    summary = summarise(stretches(broken, 1.0), MATCHED, GAINS)
    assert math.isfinite(summary.fit_y)
    assert "samples 150 to 399, the longest of 2 unbroken stretches" in summary.notes[0]


def test_a_figure_that_cannot_be_written_is_one_message(tmp_path: Path) -> None:
    with pytest.raises(TwinmatchError, match="cannot be written"):
        draw_verdict(samples(), [], TwinSettings(), [], tmp_path / "verdict.docx")
