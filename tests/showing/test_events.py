"""What happened, as a time line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.support.rig import rig
from twinmatch.comparing import ADMITTED, REFUSED, CandidateScore, TrustLevel, Verdict
from twinmatch.fitting import Match, Status
from twinmatch.showing.verdicts import Event, EventKind, Mark, admitted, events, level_stretches, match_word
from twinmatch.twin import MatchReport

CANDIDATE = CandidateScore("50 °C", 50.0, rig(), 0, 99, (), "22221", 0.0, None, None)


def verdict(sample: int, level: TrustLevel, *, nominal: str | None = "50 °C", fault: str = "") -> Verdict:
    candidates = (replace(CANDIDATE, name=nominal),) if nominal else ()
    return Verdict(
        sample=sample,
        first=0,
        last=sample,
        level=level,
        stands=True,
        nominal=nominal,
        reason="why it is so",
        decimals=2,
        candidates=candidates,
        order="22221",
        nu_gap=((0.0,),),
        driven_rms_y=8.0,
        closed_rms_u=60.0,
        fault=fault,
        fault_since=sample - 5 if fault else None,
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


def test_a_new_leader_is_reported() -> None:
    story = [verdict(60, TrustLevel.UNKNOWN, nominal=None), verdict(120, TrustLevel.TRUSTED)]
    story += [replace(story[1], sample=180, leader=name) for name in ("a", "a", "b")]
    found = [e for e in events(story) if e.kind is EventKind.LEADER]
    assert [(e.title, e.why) for e in found] == [
        ("a leads", "the first with forecasts"),
        ("b leads", "its forecasts are better than those of a"),
    ]


def test_events_come_in_order_with_their_kind_and_reason() -> None:
    story = [
        verdict(60, TrustLevel.UNKNOWN, nominal=None),
        verdict(120, TrustLevel.TRUSTED),
        verdict(180, TrustLevel.TRUSTED),
        verdict(240, TrustLevel.DOUBTFUL, nominal="70 °C"),
        verdict(260, TrustLevel.FAULT, nominal="70 °C", fault="drive-lost"),
        verdict(300, TrustLevel.FAULT, nominal="70 °C", fault="drive-lost"),
    ]
    story[1] = replace(story[1], match=ADMITTED, reason="matched on these samples")
    story[3] = replace(story[3], match=REFUSED, reason="match refused: on its bound", miss_y=3.0, miss_u=0.5)
    story[5] = replace(story[5], dismissed=("50 °C",))
    found = events(story)
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


def test_the_fate_of_a_match_is_the_verdicts_word() -> None:
    """Whatever the gate said: the discriminator may refuse what the gate accepted."""
    told = replace(
        verdict(200, TrustLevel.TRUSTED), match=REFUSED, reason="no models identified for candidate 50 °C"
    )
    assert match_word(report(200, Status.ACCEPTED), [told]) == "refused"
    assert match_word(report(200, Status.BOUNDS_HIT), [told]) == "refused: a parameter reached its bound"
    assert match_word(report(200, Status.ACCEPTED), []) == ""
    joined = replace(told, match=ADMITTED)
    assert match_word(report(200, Status.ACCEPTED), [joined]) == "admitted"
    assert admitted([told]) == frozenset()
    assert admitted([joined]) == {200}


def test_a_level_is_that_of_the_samples_since_the_verdict_before() -> None:
    story = [
        verdict(59, TrustLevel.UNKNOWN, nominal=None),
        verdict(119, TrustLevel.TRUSTED),
        verdict(179, TrustLevel.TRUSTED),
        verdict(239, TrustLevel.FAULT),
    ]
    found = level_stretches(story, first=10)
    assert [(s.first, s.last, s.level) for s in found] == [
        (10, 59, TrustLevel.UNKNOWN),
        (60, 179, TrustLevel.TRUSTED),
        (180, 239, TrustLevel.FAULT),
    ]
    assert level_stretches([]) == []


def test_a_fault_lasts_from_where_it_shows_to_the_verdict_without_it() -> None:
    """A verdict came between its beginning and its detection, and the next says that it is over."""
    story = [
        verdict(424, TrustLevel.TRUSTED),
        replace(verdict(425, TrustLevel.DOUBTFUL, fault="losses-changed"), fault_since=410),
        verdict(449, TrustLevel.TRUSTED),
        verdict(509, TrustLevel.TRUSTED),
    ]
    assert [(s.first, s.last, s.level) for s in level_stretches(story)] == [
        (0, 409, TrustLevel.TRUSTED),
        (410, 448, TrustLevel.DOUBTFUL),
        (449, 509, TrustLevel.TRUSTED),
    ]


def test_a_fault_begins_where_it_shows() -> None:
    story = [verdict(119, TrustLevel.TRUSTED), verdict(145, TrustLevel.FAULT, fault="drive-lost")]
    found = level_stretches([*story, verdict(179, TrustLevel.FAULT, fault="drive-lost")])
    assert [(s.first, s.last, s.level) for s in found] == [
        (0, 139, TrustLevel.TRUSTED),
        (140, 179, TrustLevel.FAULT),
    ]
