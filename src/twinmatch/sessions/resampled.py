"""Columns on one clock, as `resampling` makes them."""

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
    """Of the samples, s, as the rows count it; equally far apart within a stretch, the first of which begins
    with the first row; shape (M,)."""
    index: NDArray[np.int64]
    """Numbers of the samples, from 0; they skip at least one where a gap splits the recording; shape (M,)."""
    columns: Mapping[str, FloatArray]
    """By name, each of shape (M,)."""
    period: float
    """Seconds from sample to sample."""
    rows: int
    """How many there were."""
    steps: tuple[float, float, float]
    """Seconds from row to row within the stretches: the shortest, the median and the longest."""
    jitter: float
    """How far a row lay from the nearest tick of the clock, root mean square, s."""
    bridged: tuple[int, ...]
    """Rows (from 0) behind which others are missing: steps longer than one and a half of the usual."""
    gaps: tuple[float, ...]
    """Lengths of the gaps at which the recording is split, s, in the order of time."""

    @property
    def stretches(self) -> list[slice]:
        """The samples without a gap between them, in the order of time."""
        ends = [0, *(np.flatnonzero(np.diff(self.index) != 1) + 1).tolist(), self.index.size]
        return [slice(*pair) for pair in pairwise(ends)]

    @property
    def moved(self) -> bool:
        """Whether the values were put elsewhere; otherwise they are those of the rows."""
        return self.jitter > 0

    @property
    def sentence(self) -> str:
        """What was done, in plain words."""
        if not self.moved:
            return f"{self.rows} rows, one every {self.period:g} s{self._splits}"
        short, usual, long = self.steps
        text = (
            f"{self.rows} rows {short:.3g} to {long:.3g} s apart (half of them up to {usual:.3g} s) put on a "
            f"clock of {self.period:g} s; they lie {self.jitter:.2g} s beside it (RMS)"
        )
        if self.bridged:
            places = "one place" if len(self.bridged) == 1 else f"{len(self.bridged)} places"
            text += f"; rows are missing in {places}"
        return text + self._splits

    @property
    def _splits(self) -> str:
        if not self.gaps:
            return ""
        lengths = ", ".join(f"{gap:.4g}" for gap in self.gaps[:3]) + (", …" if len(self.gaps) > 3 else "")
        return f"; split into {len(self.gaps) + 1} stretches by gaps of {lengths} s"
