"""Everything that was heard of one run, on the disk, to be given again to who missed it.

A day of samples ten times a second is 40 MB, which no process that has to run for weeks can hold. The files
have no name: they go with the process, however it ends.
"""

from __future__ import annotations

import tempfile
from array import array
from bisect import bisect_right
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twinmatch.signals import Sample, SignalError, Window

__all__ = ["Shelf", "Texts"]

Rows = NDArray[np.void]


class Shelf:
    """Samples by their index."""

    def __init__(self, disturbances: int = 0) -> None:
        """Begin empty; every sample has so many measured disturbances."""
        self.disturbances = disturbances
        self._row = np.dtype(
            [
                ("index", "<u8"),
                ("stamp", "<i8"),
                ("reference", "<f8"),
                ("output", "<f8"),
                ("input", "<f8"),
                ("disturbances", "<f8", (disturbances,)),
            ]
        )
        self._file = tempfile.TemporaryFile(prefix="twinmatch-samples-")  # noqa: SIM115 - closed with the object
        self._count = 0
        # Where unbroken runs begin: their first index, and its row. As many as the rig missed ticks.
        self._firsts, self._rows = array("Q"), array("Q")
        self.end = 0
        """Index of the newest sample, plus one; 0 before the first."""

    def __len__(self) -> int:
        return self._count

    def push(self, sample: Sample) -> None:
        """Take a sample; its index has to be greater than that of the one before."""
        if not self._count or sample.index != self.end:
            self._firsts.append(sample.index)
            self._rows.append(self._count)
        row = np.zeros(1, self._row)
        row[0] = (
            sample.index, sample.stamp, sample.reference, sample.output, sample.input, sample.disturbances,
        )  # fmt: skip
        self._file.seek(0, 2)
        self._file.write(row.tobytes())
        self._count += 1
        self.end = sample.index + 1

    def rows(self, first: int, count: int, most: int) -> Rows:
        """What there is of the `count` indices from `first` on, in their order, at most `most` rows."""
        begin, end = self._row_of(first), self._row_of(first + count)
        number = min(end - begin, most)
        self._file.seek(begin * self._row.itemsize)
        return np.frombuffer(self._file.read(number * self._row.itemsize), self._row)

    @property
    def stretches(self) -> int:
        """How many unbroken runs of indices there are."""
        return len(self._firsts)

    def longest(self, period: float) -> Window:
        """The longest of them, the first of several, as a window of this sample time (s).

        Raises:
            SignalError: there is no sample.
        """
        begins = np.array(self._rows, dtype=np.int64)
        if not begins.size:
            raise SignalError("window: there is no sample to gather")
        lengths = np.diff(np.append(begins, self._count))
        run = int(np.argmax(lengths))
        rows = self.rows(self._firsts[run], int(lengths[run]), int(lengths[run]))
        return Window(
            rows["reference"], rows["output"], rows["input"],
            first=self._firsts[run], period=period, disturbances=rows["disturbances"],
        )  # fmt: skip

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()

    def _row_of(self, index: int) -> int:
        """The row of the first sample that has this index or a greater one."""
        run = bisect_right(self._firsts, index) - 1
        if run < 0:
            return 0
        end = self._rows[run + 1] if run + 1 < len(self._rows) else self._count
        return min(self._rows[run] + index - self._firsts[run], end)


class Texts:
    """Serialised messages, by their number."""

    def __init__(self) -> None:
        """Begin empty."""
        self._file = tempfile.TemporaryFile(prefix="twinmatch-messages-")  # noqa: SIM115 - as above
        self._ends = array("Q")
        self._newest = b""

    def __len__(self) -> int:
        return len(self._ends)

    def push(self, data: bytes) -> None:
        """Take a message, unless it says again what the one before said."""
        if data == self._newest:
            return
        self._newest = data
        self._file.seek(0, 2)
        self._file.write(data)
        self._ends.append((self._ends[-1] if self._ends else 0) + len(data))

    def since(self, number: int, most: int) -> Sequence[bytes]:
        """The messages from a number (from 0) on, at most so many."""
        begin = self._ends[number - 1] if 0 < number <= len(self._ends) else 0
        found = []
        self._file.seek(begin)
        for end in self._ends[number : number + most]:
            found.append(self._file.read(end - begin))
            begin = end
        return found

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()
