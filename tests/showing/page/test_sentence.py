"""What the page says of a session is what the terminal says of it."""

from __future__ import annotations

import pytest

from twinmatch.offline.judging import Judgement
from twinmatch.showing.page.state import DashboardState, update_sentence
from twinmatch.showing.summary import sentence
from twinmatch.twin import TwinSettings


def filled(judged: Judgement, leave_out: range = range(0)) -> DashboardState:
    state = DashboardState()
    for sample in judged.samples:
        if sample.index not in leave_out:
            state.push_sample(sample, 0.0)
    for verdict in judged.verdicts:
        state.push_verdict(verdict)
    return state


def test_at_the_end_it_is_the_terminals(judged: Judgement) -> None:
    settings = TwinSettings()
    state = filled(judged)
    update_sentence(state, settings.gains)
    assert state.sentence == sentence(judged.summary)
    assert judged.summary.leader in state.sentence
    assert judged.summary.nominal in state.sentence


def test_missing_samples_do_not_disturb_it(judged: Judgement) -> None:
    settings = TwinSettings()
    state = filled(judged, leave_out=range(5, 9))
    update_sentence(state, settings.gains)
    assert state.sentence.startswith("Leader")
    assert judged.summary.leader in state.sentence


@pytest.mark.parametrize("verdicts", [0, 1])
def test_without_candidates_nothing_is_said(judged: Judgement, verdicts: int) -> None:
    settings = TwinSettings()
    state = DashboardState()
    for sample in judged.samples[:50]:
        state.push_sample(sample, 0.0)
    for verdict in judged.verdicts[:verdicts]:
        assert verdict.leader is verdict.nominal is None
        state.push_verdict(verdict)
    update_sentence(state, settings.gains)
    assert state.sentence == ""
