"""Fidelity of a trace: alignment of a twin's readings with the plant's, allowing time shifts.

The fidelity measure of Muñoz, Wimmer, Troya and Vallecillo, for comparison with twins published with it. Two
readings within a tolerance match, with the score 1 − distance/tolerance; other pairs score zero. Readings of
either trace may stay unpaired, at a cost for each such gap and for each reading in it. The alignment with the
highest score is computed (Needleman and Wunsch 1970, with Gotoh's affine gaps of 1982). The result is the
share of readings that match.

The measure tolerates time shifts and ignores the size of larger errors: if neither is within the tolerance, a
twin that is wrong by 0.3 °C and one that is wrong by 30 °C get the same score.

Source: IEEE Transactions on Software Engineering 2024, doi 10.1109/TSE.2024.3462978.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from twinmatch.compiled import compiled
from twinmatch.signals import FloatArray

_PAIR = 0
_TWIN = 1
_PLANT = 2
"""Last step of an alignment: both traces advance, the twin's alone, or the plant's alone."""
_OPENING: Final = 1.0
"""Cost of a gap; an exact pair scores 1."""
_EXTENDING: Final = 0.1
"""Additional cost of each reading in it."""


class Fidelity(NamedTuple):
    """Result of the best alignment of two traces."""

    score: float
    matched: float
    """Number of matching pairs, as a share of the longer trace."""


def fidelity(twin: FloatArray, plant: FloatArray, tolerance: float) -> Fidelity:
    """Align a twin's trace, shape (N,), with the plant's, shape (M,), in one unit."""
    score, count = _aligned(np.array(twin), np.array(plant), tolerance)
    return Fidelity(score, count / max(len(twin), len(plant)))


@compiled
def _aligned(a: FloatArray, b: FloatArray, tolerance: float) -> tuple[float, int]:
    """Score and number of matching pairs of the best alignment."""
    n = a.size
    m = b.size
    best = np.full((3, n + 1, m + 1), -np.inf)
    came = np.zeros((3, n + 1, m + 1), dtype=np.int8)
    best[_PAIR, 0, 0] = 0.0
    for i in range(n + 1):
        for j in range(m + 1):
            if i and j:
                reward = max(1.0 - abs(a[i - 1] - b[j - 1]) / tolerance, 0.0)
                for last in range(3):
                    if best[last, i - 1, j - 1] + reward > best[_PAIR, i, j]:
                        best[_PAIR, i, j] = best[last, i - 1, j - 1] + reward
                        came[_PAIR, i, j] = last
            for alone in (_TWIN, _PLANT):
                p, q = (i - 1, j) if alone == _TWIN else (i, j - 1)
                if p < 0 or q < 0:
                    continue
                for last in range(3):
                    cost = _EXTENDING + (0.0 if last == alone else _OPENING)
                    if best[last, p, q] - cost > best[alone, i, j]:
                        best[alone, i, j] = best[last, p, q] - cost
                        came[alone, i, j] = last
    step = int(np.argmax(best[:, n, m]))
    score = best[step, n, m]
    matching = 0
    i = n
    j = m
    while i or j:
        before = came[step, i, j]
        i = i if step == _PLANT else i - 1
        j = j if step == _TWIN else j - 1
        matching += step == _PAIR and abs(a[i] - b[j]) < tolerance
        step = before
    return score, matching
