"""The samples and messages of one run, kept on disk for late-joining and restarted subscribers.

A day of samples at 10 Hz is 40 MB, too much for the memory of a process that runs for weeks. The files have
no name: they vanish with the process, however it ends.
"""

from __future__ import annotations

import tempfile
from array import array
from bisect import bisect_right
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twinmatch.signals import SIGNALS, Sample, SignalError, Window

Rows = NDArray[np.void]


def _record_of(shape: Sequence[int]) -> np.dtype[np.void]:
    """The record of a sample with these numbers of signals."""
    signals = (
        (name, "<f8", (width,)) for name, width in zip(SIGNALS, shape, strict=True)
    )
    return np.dtype([("index", "<u8"), ("stamp", "<i8"), *signals, ("seen", "?")])


class SampleSpool:
    """Samples by index."""

    def __init__(self) -> None:
        """Start empty; the first sample says how many signals there are."""
        self.newest: Sample | None = None
        self._row = _record_of((1, 1, 1, 0))
        self._file = tempfile.TemporaryFile(prefix="twinmatch-samples-")  # noqa: SIM115
        self._count = 0
        # First index and first row of each unbroken run; there are few, since a new one needs a missed tick.
        self._firsts = array("Q")
        self._rows = array("Q")

    def __len__(self) -> int:
        return self._count

    @property
    def end(self) -> int:
        """Index of the newest sample, plus one; 0 before the first."""
        return 0 if self.newest is None else self.newest.index + 1

    def continued_by(self, sample: Sample) -> bool:
        """Whether a sample may be pushed: it is the first, or a later one of the same run."""
        return self.newest is None or sample.continues(self.newest)

    def push(self, sample: Sample) -> None:
        """Append a sample, which has to continue the newest one."""
        if self.newest is None:
            self._row = _record_of(sample.shape)
        if self.newest is None or not sample.follows(self.newest):
            self._firsts.append(sample.index)
            self._rows.append(self._count)
        row = np.zeros(1, self._row)
        row[0] = (
            sample.index,
            sample.stamp,
            *(getattr(sample, name) for name in SIGNALS),
            sample.seen,
        )
        self._file.seek(0, 2)
        self._file.write(row.tobytes())
        self._count += 1
        self.newest = sample

    def rows(self, first: int, count: int, most: int) -> Rows:
        """The samples among the `count` indices from `first` on, in order, at most `most` rows."""
        begin = self._row_of(first)
        end = self._row_of(first + count)
        number = min(end - begin, most)
        self._file.seek(begin * self._row.itemsize)
        return np.frombuffer(self._file.read(number * self._row.itemsize), self._row)

    @property
    def stretches(self) -> int:
        """Number of unbroken runs of indices."""
        return len(self._firsts)

    def longest(self, period: float) -> Window:
        """The longest run, the first of equals, as a window with this sampling period (s).

        Raises:
            SignalError: there are no samples.
        """
        begins = np.array(self._rows, dtype=np.int64)
        if not begins.size:
            raise SignalError("window: there are no samples")
        lengths = np.diff(np.append(begins, self._count))
        run = int(np.argmax(lengths))
        rows = self.rows(self._firsts[run], int(lengths[run]), int(lengths[run]))
        signals = {name: rows[name] for name in (*SIGNALS, "seen")}
        return Window(**signals, first=self._firsts[run], period=period)

    def close(self) -> None:
        """Close the file, which deletes it."""
        self._file.close()

    def _row_of(self, index: int) -> int:
        """The row of the first sample with this or a greater index."""
        run = bisect_right(self._firsts, index) - 1
        if run < 0:
            return 0
        end = self._rows[run + 1] if run + 1 < len(self._rows) else self._count
        return min(self._rows[run] + index - self._firsts[run], end)


class MessageSpool:
    """Serialised messages, by number."""

    def __init__(self) -> None:
        """Start empty."""
        self._file = tempfile.TemporaryFile(prefix="twinmatch-messages-")  # noqa: SIM115
        self._ends = array("Q")
        self._newest = b""

    def __len__(self) -> int:
        return len(self._ends)

    def push(self, data: bytes) -> None:
        """Append a message, unless it equals the previous one."""
        if data == self._newest:
            return
        self._newest = data
        self._file.seek(0, 2)
        self._file.write(data)
        self._ends.append((self._ends[-1] if self._ends else 0) + len(data))

    def since(self, number: int, most: int) -> Sequence[bytes]:
        """The messages from a number on (counted from 0), at most `most`."""
        begin = self._ends[number - 1] if 0 < number <= len(self._ends) else 0
        messages = []
        self._file.seek(begin)
        for end in self._ends[number : number + most]:
            messages.append(self._file.read(end - begin))
            begin = end
        return messages

    def close(self) -> None:
        """Close the file, which deletes it."""
        self._file.close()
