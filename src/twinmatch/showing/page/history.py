"""The newest rows of a table of numbers, and their reduction to fewer points for drawing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twinmatch.signals import FloatArray

__all__ = ["History", "envelope"]


class History:
    """A table that forgets its oldest rows; each row belongs to one sample of the session.

    Rows are counted from 0 since the last `clear`, so that a reader can ask for the rows after those it has.
    Where samples are missing, a row of NaN breaks the drawn line.
    """

    def __init__(self, columns: Sequence[str], capacity: int) -> None:
        """Allocate `capacity` rows of these columns."""
        self.columns = ("index", *columns)
        self.capacity = capacity
        self.count = 0
        """Rows since the last `clear`, including those dropped."""
        self.epoch = 0
        """How often the table was cleared."""
        self.last: int | None = None
        """Index of the newest sample."""
        self._rows = np.full((capacity, len(self.columns)), np.nan)

    def push(self, index: int, values: Sequence[float]) -> None:
        """Append the row of a sample."""
        if self.last is not None and index > self.last + 1:
            self._append(self.last + 1, [np.nan] * len(values))
        self._append(index, values)
        self.last = index

    def clear(self) -> None:
        """Drop all rows."""
        self.count = 0
        self.epoch += 1
        self.last = None

    def newest(self) -> dict[str, float] | None:
        """The newest row by column name; None while the table is empty."""
        if self.count == 0:
            return None
        row = self._rows[(self.count - 1) % self.capacity]
        return dict(zip(self.columns, row.tolist(), strict=True))

    def since(self, row: int, stride: int = 1) -> tuple[dict[str, FloatArray], int]:
        """The rows after the first `row` rows, and the row number to pass next time.

        Args:
            row: a number this method returned, or 0.
            stride: rows that are drawn as one, see `envelope`; only full groups are returned, and a row
                number is valid only for the stride it was returned for.
        """
        oldest = -(-max(0, self.count - self.capacity) // stride) * stride
        first = max(row, oldest)
        after = max(first, self.count // stride * stride)
        rows = self._rows[np.arange(first, after) % self.capacity]
        drawn = envelope(rows, stride)
        return {name: drawn[:, k].copy() for k, name in enumerate(self.columns)}, after

    def _append(self, index: int, values: Sequence[float]) -> None:
        self._rows[self.count % self.capacity] = (index, *values)
        self.count += 1


def envelope(rows: FloatArray, stride: int) -> FloatArray:
    """Every `stride` rows as two: minimum and maximum of each column, in the order in which they occurred.

    A spike of one sample so keeps its height, however many samples share a pixel.

    Args:
        rows: shape (N, columns); N is a multiple of `stride`. A NaN makes both rows of its group NaN.
        stride: 1 returns the rows as they are.
    """
    if stride == 1 or not rows.size:
        return rows
    groups = rows.reshape(-1, stride, rows.shape[1])
    low, high = np.min(groups, axis=1), np.max(groups, axis=1)
    rising = np.argmin(groups, axis=1) <= np.argmax(groups, axis=1)
    drawn = np.empty((2 * len(groups), rows.shape[1]))
    drawn[0::2] = np.where(rising, low, high)
    drawn[1::2] = np.where(rising, high, low)
    return drawn
