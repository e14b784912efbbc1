"""Consecutive samples as an array, with the columns by what they hold."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate, pairwise

import numpy as np

from twinmatch.signals import BoolArray, FloatArray, Sample

__all__ = ["SampleRows"]


class SampleRows:
    """Set-points, outputs, inputs and disturbances of samples, one sample per row, oldest first."""

    def __init__(self, rows: FloatArray, shape: tuple[int, int, int, int]) -> None:
        """Rows whose samples have this `Sample.shape`; the last column says whether a sample was received."""
        self._rows = rows
        self._shape = shape
        begins = accumulate((0, *shape))
        self._references, self._outputs, self._inputs, self._disturbances = (
            slice(begin, end) for begin, end in pairwise(begins)
        )

    @classmethod
    def of(cls, samples: Sequence[Sample]) -> SampleRows:
        """The rows of samples, at least one."""
        rows = [
            (
                *sample.references,
                *sample.outputs,
                *sample.inputs,
                *sample.disturbances,
                sample.seen,
            )
            for sample in samples
        ]
        return cls(np.array(rows, dtype=np.float64), samples[0].shape)

    def __len__(self) -> int:
        """Number of samples."""
        return len(self._rows)

    def followed_by(self, later: SampleRows, most: int) -> SampleRows:
        """These rows and later ones; of all, the newest `most`."""
        rows = np.concatenate([self._rows, later._rows])
        return SampleRows(rows[-most:], self._shape)

    def newest(self, count: int) -> SampleRows:
        """The newest so many rows."""
        return SampleRows(self._rows[-count:], self._shape)

    @property
    def values(self) -> FloatArray:
        """All columns, shape (N, columns)."""
        return self._rows

    @property
    def references(self) -> FloatArray:
        """Set-points, shape (N, r)."""
        return self._rows[:, self._references]

    @property
    def outputs(self) -> FloatArray:
        """Outputs, shape (N, o)."""
        return self._rows[:, self._outputs]

    @property
    def inputs(self) -> FloatArray:
        """Inputs, shape (N, m)."""
        return self._rows[:, self._inputs]

    @property
    def disturbances(self) -> FloatArray:
        """Measured disturbances, shape (N, d)."""
        return self._rows[:, self._disturbances]

    def signals(self, count: int) -> FloatArray:
        """The first so many of outputs and then inputs, shape (N, count)."""
        first = self._outputs.start
        return self._rows[:, first : first + count]

    @property
    def is_received(self) -> BoolArray:
        """Which samples were received, shape (N,)."""
        return np.asarray(self._rows[:, -1] > 0.0)
