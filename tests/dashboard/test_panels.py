"""Texts of the page: the same figures as the terminal's, and nothing of the graph taken for markup."""

from __future__ import annotations

import re
from dataclasses import replace
from html import unescape

import pytest

pytest.importorskip("bokeh", reason="bokeh is not installed; it is in the extra 'dashboard'")

from twinmatch.dashboard import DashboardState, Event, Lane, Mark, panels
from twinmatch.dashboard.state import Drive
from twinmatch.discrimination import TrustLevel
from twinmatch.judging.judgement import Judgement
from twinmatch.signals import Sample
from twinmatch.views import COLUMNS, row
from twinmatch.views.criteria import computed, criterion_rows


def words(html: str) -> list[str]:
    """What can be read, piece by piece."""
    return [unescape(piece).strip() for piece in re.split(r"<[^>]*>", html) if piece.strip()]


def test_the_figures_are_those_of_the_terminal(judged: Judgement) -> None:
    for verdict in judged.verdicts:
        told = words(panels.headline(verdict, 1.0))
        for name, cell in zip(COLUMNS, row(verdict, 1.0), strict=True):
            if name == "nominal" and verdict.nominal is None:
                assert "none yet" in told
            else:
                assert cell in told, name


@pytest.mark.parametrize("level", list(TrustLevel))
def test_the_level_is_a_word_and_a_sign(judged: Judgement, level: TrustLevel) -> None:
    told = words(panels.headline(replace(judged.verdicts[-1], level=level), 1.0))
    assert level.value in told
    assert panels.SIGNS[level] in told


def test_a_fault_a_doubt_and_a_structure_are_said(judged: Judgement) -> None:
    verdict = replace(
        judged.verdicts[-1], fault="fan failed", fault_since=300, certainty="hardly", structure="sink"
    )
    told = words(panels.headline(verdict, 1.0))
    assert "the plant shows fan failed since sample 300" in told
    assert "hardly" in told
    assert "structure of the plant in the twins: sink" in told


def test_the_family_is_that_of_the_report(judged: Judgement) -> None:
    last = judged.verdicts[-1]
    criteria = computed(last.modelled)
    chosen, every = panels.family_table(last, every=False), panels.family_table(last, every=True)
    for candidate in last.modelled:
        lines = [line for line in criterion_rows(candidate, criteria) if line.output == "total"]
        for line in lines:
            for cell in line.cells:
                assert cell.text in words(every)
        assert candidate.name in words(chosen)
        assert f"{candidate.chosen_order} ✓" in words(chosen)
    assert chosen.count("<tr") == 1 + len(last.modelled)
    assert every.count("<tr") == 1 + sum(len(c.orders) for c in last.modelled)
    assert every.count('class="best"') > 0
    assert words(chosen).count("nominal") == 1


def test_before_anything_came_it_says_so() -> None:
    state = DashboardState()
    assert "waiting for the first sample" in words(panels.status(state, 0.0))
    assert "no verdict has come yet" in words(panels.headline(None, 1.0))
    assert words(panels.family_table(None, every=False)) == [
        "There is no candidate yet: no match has been admitted."
    ]
    assert words(panels.events_table([], 1, 1.0)) == ["Nothing has happened yet."]
    assert words(panels.nodes(state.roster, 0.0)) == ["No node has reported yet."]
    assert panels.alarm(state) == ""


def test_silence_and_trouble_are_in_the_first_line() -> None:
    state = DashboardState()
    state.push_sample(Sample(12, 0, 50.0, 49.0, 3.0), 100.0)
    state.push_health("matcher: health", 0, "working", {}, 100.0)
    assert words(panels.status(state, 101.0)) == ["sample 12, 12 s", "1 node is well"]
    assert words(panels.status(state, 160.0)) == ["no sample for 60 s", "1 of 1 nodes need a look"]
    state.push_health("matcher: health", 2, "trouble", {}, 160.0)
    assert "1 of 1 nodes need a look" in words(panels.status(state, 160.0))
    assert words(panels.nodes(state.roster, 160.0)) == ["matcher", "error", "trouble"]


@pytest.mark.parametrize("evil", ["<script>alert(1)</script>", '"><img src=x onerror=alert(1)>', "a & b"])
def test_what_comes_from_the_graph_is_text(judged: Judgement, evil: str) -> None:
    state = DashboardState()
    state.push_drive(Drive(0.0, 0.0, f"stopped: {evil}"))
    state.push_health(f"{evil}: health", 2, evil, {"rate": "1", "paused": "no", "position": evil}, 0.0)
    state.tell(False, evil)
    last = judged.verdicts[-1]
    named = replace(last.candidates[0], name=evil)
    verdict = replace(last, reason=evil, nominal=evil, candidates=(named,), fault=evil, certainty=evil)
    pages = [
        panels.alarm(state),
        panels.nodes(state.roster, 0.0),
        panels.status(state, 0.0),
        panels.notice(state),
        panels.headline(verdict, 1.0),
        panels.family_table(verdict, every=True),
        panels.events_table([Event(1, 3, Lane.FAULT, Mark.BAD, evil, evil)], 1, 1.0),
    ]
    for page in pages:
        assert not re.search(r"<(script|img)", page)
        assert re.search(r"&(?!(amp|lt|gt|quot|#x27);)", page) is None
        assert evil in unescape(page)


def test_events_of_the_session_before_are_told_apart() -> None:
    events = [
        Event(2, 7, Lane.MATCH, Mark.GOOD, "new", "why"),
        Event(1, 900, Lane.MATCH, Mark.GOOD, "old", "why"),
    ]
    assert words(panels.events_table(events, 2, 0.5)) == [
        *("t", "s", "what and why"),
        *("4", "new", "why"),
        *("session 1: 450", "old", "why"),
    ]
