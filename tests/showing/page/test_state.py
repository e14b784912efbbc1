"""What the page knows: bounded, and restarted with every session. No ROS, no browser."""

from __future__ import annotations

import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from twinmatch.comparing import ADMITTED, TrustLevel
from twinmatch.offline.judging import Judgement
from twinmatch.showing.page.state import CAPACITY, EVENTS, STRETCHES, DashboardState, DriveReport, TwinRow
from twinmatch.showing.verdicts import EventKind, Mark, events, level_stretches
from twinmatch.signals import Sample

SECOND = 1_000_000_000


def sample(index: int, period: float = 1.0, temperature: float = 40.0) -> Sample:
    return Sample(index, 10**18 + round(index * period * SECOND), 50.0, temperature, 20.0)


def twin_row(value: float) -> TwinRow:
    return TwinRow(*[value] * len(TwinRow._fields))


@pytest.mark.parametrize("period", [0.1, 0.25, 1.0, 2.5])
def test_the_period_is_found_from_the_stamps_however_they_jitter(period: float) -> None:
    state, random = DashboardState(), np.random.default_rng(3)
    for k in range(100):
        late = int(random.uniform(0, 0.01 * period) * SECOND)
        shaken = sample(k, period)
        state.push_sample(replace(shaken, stamp=shaken.stamp + late), 0.0)
    assert state.period == period


def test_a_gap_does_not_spoil_the_period() -> None:
    state = DashboardState()
    for k in (0, 1, 2, 60, 61, 62):
        state.push_sample(sample(k, 0.5), 0.0)
    assert state.period == 0.5
    assert state.session == 1


def test_indices_that_start_over_are_a_new_session(judged: Judgement) -> None:
    state = DashboardState()
    for k in range(100):
        state.push_sample(sample(k), 0.0)
        state.push_twin(k, twin_row(1.0))
    state.push_verdict(judged.verdicts[-1])
    state.push_sample(sample(0), 0.0)
    assert (state.session, state.sample, state.plant.count, state.twin.count) == (2, 0, 1, 0)
    assert state.verdict is None
    assert not state.trust
    newest = state.events[-1]
    assert newest.title == "a new session began"
    assert newest.session == 2
    assert {e.session for e in list(state.events)[:-1]} == {1}


def test_the_twins_rows_may_come_before_the_sample_of_a_new_session() -> None:
    state = DashboardState()
    for k in range(10):
        state.push_sample(sample(k), 0.0)
        state.push_twin(k, twin_row(1.0))
    state.push_twin(0, twin_row(2.0))
    state.push_sample(sample(0), 0.0)
    assert state.twin.since(0)[0]["closed_input"].tolist() == [2.0]


def test_a_late_row_of_the_session_before_does_no_harm() -> None:
    state = DashboardState()
    for k in range(10):
        state.push_sample(sample(k), 0.0)
    state.push_sample(sample(0), 0.0)
    state.push_twin(9, twin_row(1.0))
    state.push_twin(0, twin_row(2.0))
    assert state.plant.count == 1
    assert state.twin.since(0)[0]["closed_input"].tolist() == [2.0]


def test_events_and_stretches_are_those_of_the_report(judged: Judgement) -> None:
    """Reported one by one as they come, or read together afterwards: the same words and spans."""
    assert len(judged.verdicts) > 5
    state = DashboardState()
    for verdict in judged.verdicts:
        state.push_verdict(verdict)
    told = {(e.sample, e.title, e.why) for e in state.events}
    expected = events(judged.verdicts)
    assert told == {(e.sample, e.title, e.why) for e in expected}
    assert len(state.events) == len(expected)
    assert list(state.trust) == level_stretches(judged.verdicts)


def test_marks_follow_what_happened(judged: Judgement) -> None:
    state = DashboardState()
    last = replace(judged.verdicts[-1], match="")
    state.push_verdict(replace(last, level=TrustLevel.DOUBTFUL, match=ADMITTED))
    marks = {(e.kind, e.mark) for e in state.events}
    assert marks == {
        *((EventKind.ADMITTED, Mark.GOOD), (EventKind.LEADER, Mark.NOTE)),
        *((EventKind.NOMINAL, Mark.NOTE), (EventKind.LEVEL, Mark.WARNING)),
    }
    state.push_verdict(replace(last, level=TrustLevel.FAULT))
    newest = state.events[-1]
    assert (newest.kind, newest.mark) == (EventKind.FAULT, Mark.BAD)


def test_a_fault_is_reported_when_it_comes_and_when_it_goes() -> None:
    state = DashboardState()
    state.push_sample(sample(41), 0.0)
    for fault in (
        "",
        "over_temperature: 111 °C is above 110 °C",
        "over_temperature: 111 °C is above 110 °C",
        "",
    ):
        state.push_drive(DriveReport(0.0, math.nan, fault))
    told = [(e.sample, e.title, e.why) for e in state.events]
    assert told == [
        (41, "output held at zero: over temperature", "111 °C is above 110 °C"),
        (41, "fault cleared", "the output may be driven"),
    ]
    assert state.fault == ""


def test_an_error_on_diagnostics_is_reported_once_however_its_figures_grow() -> None:
    state = DashboardState()
    for k in range(5):
        state.push_health("matcher: health", 2, f"no sample for {k}.5 s", {}, float(k))
    state.push_health("matcher: health", 0, "working", {}, 6.0)
    titles = [e.title for e in state.events]
    assert titles == ["matcher reports an error", "matcher has recovered"]


def test_the_player_is_known_by_what_it_reports_and_goes_when_it_falls_silent() -> None:
    state = DashboardState()
    values = {"rate": "50", "paused": "True", "position": "12.0 s of 300.0 s"}
    state.push_health("rig_a/player: health", 0, "paused", values, 10.0)
    player = state.nodes.player
    assert player is not None
    assert (player.rate, player.paused, player.position) == (50.0, True, "12.0 s of 300.0 s")
    state.nodes.expire(13.0)
    assert state.nodes.player is not None
    state.nodes.expire(15.0)
    assert state.nodes.player is None


def test_an_image_without_values_leaves_the_one_before() -> None:
    state = DashboardState()
    state.push_image(np.full((4, 5), 31.5, dtype=np.float32))
    state.push_image(np.full((4, 5), np.nan, dtype=np.float32))
    assert state.images == 1
    assert state.image is not None
    assert state.image[0, 0] == 31.5


def test_it_takes_no_more_room_however_long(judged: Judgement) -> None:
    """Samples, twins, verdicts, matches, faults, warnings and images, beyond what is kept of each."""
    kept = 5_000
    state = DashboardState(kept)
    images = [np.full((60, 80), float(k), dtype=np.float32) for k in range(2)]

    def feed(first: int, number: int) -> None:
        for k in range(first, first + number):
            state.push_sample(sample(k, 0.1), 0.1 * k)
            state.push_twin(k, twin_row(float(k)))
            if k % 20 == 0:
                verdict = judged.verdicts[k // 20 % len(judged.verdicts)]
                level = list(TrustLevel)[k // 20 % 4]
                state.push_verdict(replace(verdict, sample=k, first=max(0, k - 20), level=level))
                state.push_drive(DriveReport(0.0, 0.5, "stopped: as asked" if k % 40 else ""))
                state.push_health(
                    f"node {k % 1000}: health", k % 3, f"message {k}", {"key": "value"}, 0.1 * k
                )
                state.push_image(images[k // 20 % 2])

    feed(0, kept)
    tracemalloc.start()
    feed(kept, kept)  # whatever is kept has been replaced by what is counted
    settled = tracemalloc.get_traced_memory()[0]
    feed(2 * kept, kept)
    grown = tracemalloc.get_traced_memory()[0] - settled
    tracemalloc.stop()
    assert grown < 100_000, f"{grown} bytes more"
    assert len(state.plant.since(0)[0]["index"]) == kept
    assert len(state.events) == EVENTS
    assert len(state.trust) == STRETCHES


def test_an_hour_at_ten_hertz_is_kept() -> None:
    assert CAPACITY == 3600 * 10
