"""What the page knows: bounded, restarted with every session, and summed up as on the terminal."""

from __future__ import annotations

import math
import tracemalloc
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.comparing import ADMITTED, TrustLevel, Verdict
from twinmatch.offline.judging import Judgement
from twinmatch.offline.summary import MAX_STRETCHES
from twinmatch.showing.page.state import (
    CAPACITY,
    EVENTS,
    DashboardState,
    DriveReport,
    RollingTable,
    TwinRow,
    envelope,
    update_sentence,
)
from twinmatch.showing.summary import sentence
from twinmatch.showing.verdicts import EventKind, Mark, events
from twinmatch.signals import Sample
from twinmatch.twin import TwinSettings


def filled(number: int, capacity: int) -> RollingTable:
    history = RollingTable(("value",), capacity)
    for k in range(number):
        history.push(k, (10.0 * k,))
    return history


def test_the_oldest_rows_are_forgotten() -> None:
    columns, row = filled(1003, 10).since(0)
    assert columns["index"].tolist() == list(range(993, 1003))
    assert columns["value"].tolist() == [10.0 * k for k in range(993, 1003)]
    assert row == 1003


def test_a_gap_breaks_the_line() -> None:
    history = filled(3, 10)
    history.push(8, (80.0,))
    columns, _ = history.since(0)
    assert columns["index"].tolist() == [0, 1, 2, 3, 8]
    assert np.isnan(columns["value"][3])


def test_clear_starts_over() -> None:
    history = filled(5, 10)
    history.clear()
    assert (history.count, history.epoch, history.last) == (0, 1, None)
    assert history.newest() is None
    history.push(0, (3.0,))
    assert history.newest() == {"index": 0.0, "value": 3.0}
    assert history.since(0)[0]["value"].tolist() == [3.0]


def test_a_spike_of_one_sample_stays_as_high_as_it_was() -> None:
    history = RollingTable(("value",), 5000)
    spikes = {1234: 100.0, 2345: -7.0}
    for k in range(4000):
        history.push(k, (spikes.get(k, 0.0),))
    columns, _ = history.since(0, stride=50)
    assert columns["value"].size == 160
    assert columns["value"].max() == 100.0
    assert columns["value"].min() == -7.0
    assert np.all(np.diff(columns["index"]) > 0)


def test_envelope_keeps_the_order_within_a_group_and_shows_what_is_missing() -> None:
    rows = np.array([[0.0, 5.0], [1.0, 9.0], [2.0, 1.0], [3.0, 2.0]])
    assert envelope(rows, 4).tolist() == [[0.0, 9.0], [3.0, 1.0]]
    rows = np.array([[0.0, 1.0], [1.0, np.nan], [2.0, 3.0], [3.0, 4.0]])
    drawn = envelope(rows, 2)
    assert np.isnan(drawn[:2, 1]).all()
    assert drawn[2:].tolist() == [[2.0, 3.0], [3.0, 4.0]]


@given(
    pushes=st.lists(st.integers(1, 40), min_size=1, max_size=30),
    stride=st.integers(1, 7),
    capacity=st.integers(50, 90),
)
def test_reading_piece_by_piece_is_reading_all(
    pushes: list[int], stride: int, capacity: int
) -> None:
    """A reader that looks before rows are forgotten sees every group once, in order."""
    history = RollingTable(("value",), capacity)
    row = 0
    indices_read = []
    total = 0
    for number in pushes:
        for _ in range(number):
            history.push(total, (float(total % 11),))
            total += 1
        columns, row = history.since(row, stride)
        indices_read += columns["index"].tolist()
    per_group = 1 if stride == 1 else 2
    assert len(indices_read) == total // stride * per_group
    starts = indices_read[::per_group]
    assert starts == [float(k * stride) for k in range(total // stride)]


SECOND = 1_000_000_000


def sample(index: int, period: float = 1.0, temperature: float = 40.0) -> Sample:
    return Sample(
        index, 10**18 + round(index * period * SECOND), 50.0, temperature, 20.0
    )


def twin_row(value: float) -> TwinRow:
    return TwinRow(*[value] * len(TwinRow._fields))


@pytest.mark.parametrize("period", [0.1, 0.25, 1.0, 2.5])
def test_the_period_is_found_from_the_stamps_however_they_jitter(period: float) -> None:
    state = DashboardState()
    random = np.random.default_rng(3)
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
    assert (state.session, state.sample, state.plant.count, state.twin.count) == (
        2,
        0,
        1,
        0,
    )
    assert state.verdict is None
    assert not state.tally.stretches
    newest = state.events[-1]
    assert newest.title == "a new session began"
    assert newest.session == 2
    assert {e.session for e in list(state.events)[:-1]} == {1}


def test_the_twins_rows_of_a_new_session_may_come_first_and_a_late_one_of_the_old_does_no_harm() -> (
    None
):
    for early in (True, False):
        state = DashboardState()
        for k in range(10):
            state.push_sample(sample(k), 0.0)
            state.push_twin(k, twin_row(1.0))
        if early:
            state.push_twin(0, twin_row(2.0))
        state.push_sample(sample(0), 0.0)
        if not early:
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
    event_words = {(e.sample, e.title, e.why) for e in state.events}
    expected = events(judged.verdicts)
    assert event_words == {(e.sample, e.title, e.why) for e in expected}
    assert len(state.events) == len(expected)
    assert tuple(state.tally.stretches) == judged.summary.stretches


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
    hot = "over_temperature: 111 °C is above 110 °C"
    for fault in ("", hot, hot, "", "limited: hotter than it reads", ""):
        state.push_drive(DriveReport(0.0, math.nan, fault))
    event_words = [(e.sample, e.title, e.why) for e in state.events]
    assert event_words == [
        (41, "output held at zero: over temperature", "111 °C is above 110 °C"),
        (41, "fault cleared", "the output may be driven"),
        (41, "output limited", "hotter than it reads"),
        (41, "fault cleared", "the output may be driven"),
    ]
    assert state.fault == ""


@pytest.mark.parametrize("heard", [0, 1, 2, 5])
def test_a_fault_is_dated_by_its_stamp_whatever_was_received_before_it(
    heard: int,
) -> None:
    state = DashboardState()
    samples = [sample(k, 0.5) for k in range(3, 8)]
    for pushed in samples[:heard]:
        state.push_sample(pushed, 0.0)
    state.push_drive(
        DriveReport(0.0, math.nan, "stopped: as asked", samples[1].stamp + 125_000_000)
    )
    for pushed in samples[heard:]:
        state.push_sample(pushed, 0.0)
    assert [event.time(0.5) for event in state.events] == [2.125]


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
    assert (player.rate, player.paused, player.position) == (
        50.0,
        True,
        "12.0 s of 300.0 s",
    )
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
    assert CAPACITY == 3600 * 10  # an hour at 10 Hz
    capacity = 5_000
    state = DashboardState(capacity)
    images = [np.full((60, 80), float(k), dtype=np.float32) for k in range(2)]

    def feed(first: int, number: int) -> None:
        for k in range(first, first + number):
            state.push_sample(sample(k, 0.1), 0.1 * k)
            state.push_twin(k, twin_row(float(k)))
            if k % 20 == 0:
                verdict = judged.verdicts[k // 20 % len(judged.verdicts)]
                level = list(TrustLevel)[k // 20 % 4]
                state.push_verdict(
                    replace(verdict, sample=k, first=max(0, k - 20), level=level)
                )
                state.push_drive(
                    DriveReport(0.0, 0.5, "stopped: as asked" if k % 40 else "")
                )
                state.push_health(
                    f"node {k % 1000}: health",
                    k % 3,
                    f"message {k}",
                    {"key": "value"},
                    0.1 * k,
                )
                state.push_image(images[k // 20 % 2])

    feed(0, capacity)
    tracemalloc.start()
    feed(capacity, capacity)  # whatever is kept has been replaced by what is counted
    settled = tracemalloc.get_traced_memory()[0]
    feed(2 * capacity, capacity)
    grown = tracemalloc.get_traced_memory()[0] - settled
    tracemalloc.stop()
    assert grown < 100_000, f"{grown} bytes more"
    assert len(state.plant.since(0)[0]["index"]) == capacity
    assert len(state.events) == EVENTS
    assert len(state.tally.stretches) == MAX_STRETCHES


def summed_up(samples: Sequence[Sample], verdicts: Sequence[Verdict]) -> str:
    state = DashboardState()
    for sample in samples:
        state.push_sample(sample, 0.0)
    for verdict in verdicts:
        state.push_verdict(verdict)
    update_sentence(state, TwinSettings())
    return state.sentence


def test_the_sentence_is_the_terminals_and_empty_before_there_are_candidates(
    judged: Judgement,
) -> None:
    text = summed_up(judged.samples, judged.verdicts)
    assert text == sentence(judged.summary)
    assert judged.summary.leader in text
    assert judged.summary.nominal in text
    assert summed_up(judged.samples[:50], []) == ""
    assert judged.verdicts[0].leader is judged.verdicts[0].nominal is None
    assert summed_up(judged.samples[:50], judged.verdicts[:1]) == ""


def test_missing_samples_do_not_disturb_it(judged: Judgement) -> None:
    text = summed_up([*judged.samples[:5], *judged.samples[9:]], judged.verdicts)
    assert text.startswith("Leader")
    assert judged.summary.leader in text
