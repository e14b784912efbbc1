"""Tables that forget, and drawing them with fewer points."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.showing.page.state import RollingTable, envelope


def filled(number: int, capacity: int) -> RollingTable:
    history = RollingTable(("value",), capacity)
    for k in range(number):
        history.push(k, (10.0 * k,))
    return history


def test_rows_come_back_in_order_and_once() -> None:
    history = filled(7, 10)
    columns, row = history.since(0)
    assert columns["index"].tolist() == list(range(7))
    assert columns["value"].tolist() == [10.0 * k for k in range(7)]
    history.push(7, (70.0,))
    columns, row = history.since(row)
    assert columns["index"].tolist() == [7.0]
    assert history.since(row)[0]["index"].size == 0


def test_the_oldest_rows_are_forgotten() -> None:
    columns, row = filled(1003, 10).since(0)
    assert columns["index"].tolist() == list(range(993, 1003))
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
    for k in range(4000):
        history.push(k, (100.0 if k == 1234 else -7.0 if k == 2345 else 0.0,))
    columns, _ = history.since(0, stride=50)
    assert columns["value"].size == 160
    assert columns["value"].max() == 100.0
    assert columns["value"].min() == -7.0
    assert np.all(np.diff(columns["index"]) > 0)


def test_envelope_keeps_the_order_within_a_group() -> None:
    rows = np.array([[0.0, 5.0], [1.0, 9.0], [2.0, 1.0], [3.0, 2.0]])
    assert envelope(rows, 4).tolist() == [[0.0, 9.0], [3.0, 1.0]]


def test_envelope_shows_what_is_missing() -> None:
    rows = np.array([[0.0, 1.0], [1.0, np.nan], [2.0, 3.0], [3.0, 4.0]])
    drawn = envelope(rows, 2)
    assert np.isnan(drawn[:2, 1]).all()
    assert drawn[2:].tolist() == [[2.0, 3.0], [3.0, 4.0]]


@given(
    pushes=st.lists(st.integers(1, 40), min_size=1, max_size=30),
    stride=st.integers(1, 7),
    capacity=st.integers(50, 90),
)
def test_reading_piece_by_piece_is_reading_all(pushes: list[int], stride: int, capacity: int) -> None:
    """A reader that looks before rows are forgotten sees every group once, in order."""
    history, row, seen, total = RollingTable(("value",), capacity), 0, [], 0
    for number in pushes:
        for _ in range(number):
            history.push(total, (float(total % 11),))
            total += 1
        columns, row = history.since(row, stride)
        seen += columns["index"].tolist()
    per_group = 1 if stride == 1 else 2
    assert len(seen) == total // stride * per_group
    starts = seen[::per_group]
    assert starts == [float(k * stride) for k in range(total // stride)]
