"""Samples as an array: which column holds what, and how many rows are kept."""

from __future__ import annotations

import numpy as np

from twinmatch.signals import Sample
from twinmatch.twin.sample_rows import SampleRows


def sample(index: int, *, seen: bool = True) -> Sample:
    """Two outputs, two inputs and one disturbance whose tens say what they are, and ones which sample."""
    return Sample(
        index, 0, (10.0 + index,), (20.0 + index, 30.0 + index), (40.0 + index, 50.0 + index),
        (60.0 + index,), seen=seen,
    )  # fmt: skip


def test_columns_have_their_names() -> None:
    rows = SampleRows.of([sample(0), sample(1, seen=False)])
    np.testing.assert_array_equal(rows.references, [[10.0], [11.0]])
    np.testing.assert_array_equal(rows.outputs, [[20.0, 30.0], [21.0, 31.0]])
    np.testing.assert_array_equal(rows.inputs, [[40.0, 50.0], [41.0, 51.0]])
    np.testing.assert_array_equal(rows.disturbances, [[60.0], [61.0]])
    np.testing.assert_array_equal(rows.signals(2), rows.outputs)
    np.testing.assert_array_equal(
        rows.signals(4), np.hstack([rows.outputs, rows.inputs])
    )
    assert rows.is_received.tolist() == [True, False]


def test_later_rows_follow_and_the_oldest_are_dropped() -> None:
    rows = SampleRows.of([sample(0), sample(1)])
    kept = rows.followed_by(SampleRows.of([sample(2), sample(3)]), most=3)
    assert kept.references.ravel().tolist() == [11.0, 12.0, 13.0]
    assert kept.newest(2).references.ravel().tolist() == [12.0, 13.0]
    assert len(kept.newest(9)) == 3
    assert len(rows) == 2
