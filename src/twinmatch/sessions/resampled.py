"""Columns on one clock, the result of `resampling`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from twinmatch.signals import FloatArray

__all__ = ["Resampled"]


@dataclass(frozen=True, eq=False)
class Resampled:
    """Columns on one clock."""

    time: FloatArray
    """Times of the samples, s, on the rows' time axis; equidistant within a stretch, which starts at its
    first row; shape (M,)."""
    index: NDArray[np.int64]
    """Indices of the samples, from 0; at least one is skipped where a gap splits the rows; shape (M,)."""
    columns: Mapping[str, FloatArray]
    """By name, each of shape (M,)."""
    period: float
    """Sampling period, s."""
    rows: int
    """Number of input rows."""
    steps: tuple[float, float, float]
    """Shortest, median and longest step between rows within the stretches, s."""
    jitter: float
    """Distance of the rows from the nearest tick, root mean square, s."""
    bridged: tuple[int, ...]
    """Rows (from 0) after which others are missing: the step is longer than 1.5 usual ones."""
    gaps: tuple[float, ...]
    """Lengths of the gaps at which the recording is split, s, in order of time."""

    @property
    def stretches(self) -> list[slice]:
        """The stretches of samples without a gap, in order of time."""
        ends = [0, *(np.flatnonzero(np.diff(self.index) != 1) + 1).tolist(), self.index.size]
        return [slice(*pair) for pair in pairwise(ends)]

    @property
    def moved(self) -> bool:
        """Whether values were interpolated; otherwise they are those of the rows."""
        return self.jitter > 0

    @property
    def sentence(self) -> str:
        """Description of the resampling."""
        if not self.moved:
            return f"{self.rows} rows, one every {self.period:g} s{self._splits}"
        short, usual, long = self.steps
        text = (
            f"{self.rows} rows, {short:.3g} to {long:.3g} s apart (median {usual:.3g} s), resampled to a "
            f"period of {self.period:g} s; jitter {self.jitter:.2g} s (RMS)"
        )
        if self.bridged:
            places = "one place" if len(self.bridged) == 1 else f"{len(self.bridged)} places"
            text += f"; rows are missing at {places}"
        return text + self._splits

    @property
    def _splits(self) -> str:
        if not self.gaps:
            return ""
        lengths = ", ".join(f"{gap:.4g}" for gap in self.gaps[:3]) + (", …" if len(self.gaps) > 3 else "")
        return f"; split into {len(self.gaps) + 1} stretches by gaps of {lengths} s"
