"""Texts of the page: the same figures as the terminal's, and nothing of the graph taken for markup."""

from __future__ import annotations

import re
from dataclasses import replace
from html import unescape

import pytest

pytest.importorskip(
    "bokeh", reason="bokeh is not installed; it is in the extra 'dashboard'"
)

from tests.support.places import PROJECT
from twinmatch.comparing import CandidateScore, TrustLevel
from twinmatch.offline.judging import Judgement
from twinmatch.showing.family import computed, criterion_rows
from twinmatch.showing.page import panels
from twinmatch.showing.page.panels import first_screen, what_to_do
from twinmatch.showing.page.state import DashboardState, DriveReport
from twinmatch.showing.verdicts import Event, EventKind, Mark, row
from twinmatch.signals import Sample


def words(html: str) -> list[str]:
    """What can be read, piece by piece."""
    return [
        unescape(piece).strip() for piece in re.split(r"<[^>]*>", html) if piece.strip()
    ]


def test_the_figures_are_those_of_the_terminal(judged: Judgement) -> None:
    for verdict in judged.verdicts:
        state = DashboardState()
        state.push_verdict(verdict)
        shown_words = [
            *words(panels.reasons(verdict, 1.0)),
            *words(first_screen(state)),
        ]
        for name, cell in row(verdict, 1.0).items():
            if name == "decided":
                continue
            if name == "nominal" and verdict.nominal is None:
                assert "none yet" in shown_words
            else:
                assert cell in shown_words, name


def test_a_fault_a_doubt_and_a_structure_are_said(judged: Judgement) -> None:
    verdict = replace(
        judged.verdicts[-1],
        fault="fan failed",
        fault_since=300,
        certainty="hardly",
        structure="sink",
    )
    shown_words = words(panels.reasons(verdict, 1.0))
    assert "the plant shows fan failed since 300 s" in shown_words
    assert "hardly" in shown_words
    assert "structure that the samples justify: sink" in shown_words


def test_the_family_is_that_of_the_report(judged: Judgement) -> None:
    last = judged.verdicts[-1]
    criteria = computed(last.modelled)
    chosen = panels.family_table(last, all_orders=False)
    all_orders = panels.family_table(last, all_orders=True)
    for candidate in last.modelled:
        lines = [
            line
            for line in criterion_rows(candidate, criteria)
            if line.output == "total"
        ]
        assert {cell.text for line in lines for cell in line.cells} <= set(
            words(all_orders)
        )
        assert candidate.name in words(chosen)
        assert f"{candidate.chosen_order} ✓" in words(chosen)
    assert chosen.count("<tr") == 1 + len(last.modelled)
    assert all_orders.count("<tr") == 1 + sum(len(c.orders) for c in last.modelled)
    assert all_orders.count('class="best"') > 0
    assert words(chosen).count("nominal") == 1
    driven = replace(last, candidates=tuple(_without_input(c) for c in last.modelled))
    assert panels.family_table(driven, all_orders=True).count(
        "<tr"
    ) == all_orders.count("<tr")


def _without_input(candidate: CandidateScore) -> CandidateScore:
    """The candidate as it is scored in open loop, on its output alone."""
    return replace(
        candidate, orders=tuple(replace(o, u=None, total=o.y) for o in candidate.orders)
    )


def test_before_anything_came_it_says_so() -> None:
    state = DashboardState()
    assert "waiting for the first sample" in words(panels.status(state, 0.0))
    assert "no verdict yet" in words(panels.reasons(None, 1.0))
    assert words(panels.family_table(None, all_orders=False)) == [
        "There is no candidate yet: no match has been admitted."
    ]
    assert words(panels.events_table([], 1, 1.0)) == ["Nothing has happened yet."]
    assert words(panels.nodes(state.nodes, 0.0)) == ["No node has reported yet."]
    assert panels.alarm(state) == ""


def test_silence_and_trouble_are_in_the_first_line() -> None:
    state = DashboardState()
    state.push_sample(Sample(12, 0, 50.0, 49.0, 3.0), 100.0)
    state.push_health("matcher: health", 0, "working", {}, 100.0)
    assert words(panels.status(state, 101.0)) == ["sample 12, 12 s", "1 node is OK"]
    assert words(panels.status(state, 160.0)) == [
        "no sample for 60 s after sample 12, 12 s",
        "1 of 1 nodes need attention",
    ]
    state.push_health("matcher: health", 2, "trouble", {}, 160.0)
    assert "1 of 1 nodes need attention" in words(panels.status(state, 160.0))
    assert words(panels.nodes(state.nodes, 160.0)) == ["matcher", "error", "trouble"]


@pytest.mark.parametrize(
    "evil", ["<script>alert(1)</script>", '"><img src=x onerror=alert(1)>', "a & b"]
)
def test_what_comes_from_the_graph_is_text(judged: Judgement, evil: str) -> None:
    state = DashboardState()
    state.push_drive(DriveReport(0.0, 0.0, f"stopped: {evil}"))
    state.push_health(
        f"{evil}: health", 2, evil, {"rate": "1", "paused": "no", "position": evil}, 0.0
    )
    state.notify(evil, done=False)
    last = judged.verdicts[-1]
    named = replace(last.candidates[0], name=evil)
    verdict = replace(
        last, reason=evil, nominal=evil, candidates=(named,), fault=evil, certainty=evil
    )
    pages = [
        panels.alarm(state),
        panels.nodes(state.nodes, 0.0),
        panels.status(state, 0.0),
    ]
    pages += [
        panels.notice(state),
        panels.reasons(verdict, 1.0),
        panels.family_table(verdict, all_orders=True),
    ]
    pages.append(
        panels.events_table([Event(3, EventKind.FAULT, evil, evil, Mark.BAD)], 1, 1.0)
    )
    for page in pages:
        assert not re.search(r"<(script|img)", page)
        assert re.search(r"&(?!(amp|lt|gt|quot|#x27);)", page) is None
        assert evil in unescape(page)


def test_events_of_the_session_before_are_distinguished() -> None:
    events = [
        Event(7, EventKind.ADMITTED, "new", "why", Mark.GOOD, session=2),
        Event(900, EventKind.ADMITTED, "old", "why", Mark.GOOD, session=1),
    ]
    assert words(panels.events_table(events, 2, 0.5)) == [
        "t",
        "s",
        "what and why",
        "3.5",
        "●",
        "new",
        "why",
        "session 1: 450.0",
        "●",
        "old",
        "why",
    ]


def test_the_first_screen_says_what_to_do(judged: Judgement) -> None:
    state = DashboardState()
    assert "play a recorded session" in what_to_do(state)
    for sample in judged.samples:
        state.push_sample(sample, 100.0)
    assert "hold it for some minutes" in what_to_do(state)
    last = judged.verdicts[-1]
    reason = "the drive does nothing: look at drive, wires and supply"
    for level, advice in (
        (TrustLevel.TRUSTED, "Nothing. Ask the leader"),
        (TrustLevel.DOUBTFUL, "Do not rely on forecasts"),
        (TrustLevel.FAULT, "Look at drive, wires and supply. Do not rely"),
        (TrustLevel.UNKNOWN, "hold it for some minutes"),
    ):
        fault = "drive-lost" if level is TrustLevel.FAULT else ""
        state.push_verdict(replace(last, level=level, fault=fault, reason=reason))
        assert {level.value, panels.SIGNS[level]} <= set(words(first_screen(state)))
        assert what_to_do(state).startswith(advice) or advice in what_to_do(state), (
            level
        )
    assert "no fault found" in " ".join(words(first_screen(state)))
    state.push_verdict(replace(last, level=TrustLevel.FAULT, reason=reason))
    assert what_to_do(state).startswith("Look at drive, sensor and cables. Do not rely")
    state.push_verdict(
        replace(last, level=TrustLevel.FAULT, fault="drive-lost", fault_since=600)
    )
    assert "✕ drive lost" in words(first_screen(state))
    state.push_drive(DriveReport(0.0, 0.0, "board: gone"))
    assert "clear the fault" in what_to_do(state)
    assert "Output held at zero: board" in panels.alarm(state)
    state.push_drive(DriveReport(40.0, 0.0, "limited: hotter"))
    assert "The drive is limited. Measure" in what_to_do(state)
    assert "Output limited</b><br>hotter" in panels.alarm(state)


def test_at_the_end_of_a_replay_nobody_is_blamed() -> None:
    state = DashboardState()
    state.push_sample(Sample(0, 0, 1.0, 2.0, 3.0), 100.0)
    state.push_sample(Sample(12, 12 * 10**9, 1.0, 2.0, 3.0), 100.0)
    player = {"rate": "50", "paused": "False", "position": "13.0 s of 13.0 s"}
    state.push_health("matcher", 0, "working", {}, 100.0)
    state.push_health("player", 0, "playing", {**player, "ended": "False"}, 100.0)
    assert any(
        "playing: 13.0 s of 13.0 s" in w for w in words(panels.status(state, 101.0))
    )
    state.push_health(
        "player",
        0,
        "ended: all 13 messages were taken",
        {**player, "ended": "True"},
        101.0,
    )
    state.push_health("matcher", 1, "no sample for 6 s", {}, 106.0)
    for time in (107.0, 400.0):
        state.nodes.expire(time)
        assert words(panels.status(state, time)) == [
            "sample 12, 12 s",
            "the replay has ended: 13.0 s of 13.0 s",
        ]
        shown_text = " ".join(words(panels.nodes(state.nodes, time)))
        assert shown_text.count("has ended with the replay") == 2
        assert "no sample" not in shown_text
        assert "the replay has ended" in what_to_do(state)
    # an error is its own all the same
    state.push_health("matcher", 2, "trouble", {}, 401.0)
    assert "1 of 2 nodes need attention" in words(panels.status(state, 401.0))
    state.push_sample(Sample(0, 0, 1.0, 2.0, 3.0), 500.0)
    assert not any("ended" in w for w in words(panels.status(state, 500.0)))


def test_a_page_that_is_behind_takes_the_last_samples_of_a_replay_that_has_ended() -> (
    None
):
    state = DashboardState()
    values = {
        "rate": "0",
        "paused": "False",
        "position": "40.0 s of 40.0 s",
        "ended": "True",
    }
    state.push_sample(Sample(0, 0, 1.0, 2.0, 3.0), 100.0)
    state.push_health(
        "player", 0, "ended: all 40 messages were delivered", values, 100.0
    )
    for k in range(1, 11):
        state.push_sample(Sample(k, k * 10**9, 1.0, 2.0, 3.0), 100.0 + 2.0 * k)
    assert state.nodes.ended is not None
    state.push_sample(Sample(11, 11 * 10**9, 1.0, 2.0, 3.0), 130.0)
    assert state.nodes.ended is None


def test_a_player_whose_last_word_was_lost_has_ended_at_the_end_only() -> None:
    for position, ended in (("13.0 s of 13.0 s", True), ("5.0 s of 13.0 s", False)):
        state = DashboardState()
        values = {
            "rate": "50",
            "paused": "False",
            "position": position,
            "ended": "False",
        }
        state.push_health("player", 0, "playing", values, 100.0)
        state.nodes.expire(110.0)
        assert state.nodes.player is None
        assert (state.nodes.ended is not None) is ended


def test_the_help_of_the_page_and_its_document_are_the_same() -> None:
    document = (PROJECT / "docs" / "dashboard.md").read_text("utf-8")
    page = (PROJECT / "src" / "twinmatch" / "showing" / "page" / "page.html").read_text(
        "utf-8"
    )
    help_ = page[page.index('<details class="help"') : page.index("</details>")]
    rows = re.findall(
        r'<th scope="row">(.*?)</th><td>(.*?)</td>\s*<td>(.*?)</td>', help_
    )
    assert len(rows) == 12
    for part, meaning, to_do in rows:
        assert f"| {part} | {meaning} | {to_do} |" in document, part
