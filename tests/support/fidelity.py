"""Fidelity of a trace: alignment of a twin's readings with the plant's, allowing time shifts.

The fidelity measure of Muñoz, Wimmer, Troya and Vallecillo, for comparison with twins published with it. Two
readings within a tolerance match, with the score 1 − distance/tolerance; other pairs score zero. Readings of
either trace may stay unpaired, at a cost for each such gap and for each reading in it. The alignment with the
highest score is computed (Needleman and Wunsch 1970, with Gotoh's affine gaps of 1982). The results are the
share of readings that match and their mean distance.

The measure tolerates time shifts and ignores the size of larger errors: if neither is within the tolerance, a
twin that is wrong by 0.3 °C and one that is wrong by 30 °C get the same score.

Source: IEEE Transactions on Software Engineering 2024, doi 10.1109/TSE.2024.3462978.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinmatch.compiled import compiled
from twinmatch.signals import FloatArray

_PAIR, _TWIN, _PLANT = 0, 1, 2
"""Last step of an alignment: both traces advance, the twin's alone, or the plant's alone."""
_OPENING: Final = 1.0
_EXTENDING: Final = 0.1


@dataclass(frozen=True, eq=False)
class Fidelity:
    """Result of the best alignment of two traces."""

    matched: float
    """Number of matching pairs, as a share of the longer trace."""
    mean: float
    """Mean distance of these pairs, in the unit of the readings; NaN without any."""
    score: float
    """Score of the alignment."""
    gaps: int
    """Number of unpaired stretches."""
    pairs: NDArray[np.int64]
    """Indices in twin and plant of all pairs, matching or not, shape (P, 2)."""


def fidelity(
    twin: ArrayLike,
    plant: ArrayLike,
    tolerance: float,
    *,
    opening: float = _OPENING,
    extending: float = _EXTENDING,
) -> Fidelity:
    """Align a twin's trace with the plant's.

    Args:
        twin: readings of the twin, shape (N,).
        plant: readings of the plant, shape (M,), in the same unit.
        tolerance: distance below which two readings match, in that unit.
        opening: cost of a gap; an exact pair scores 1.
        extending: additional cost of each reading in it.

    Raises:
        ValueError: no readings, some that are not finite, or an invalid tolerance or cost.
    """
    a, b = np.asarray(twin, dtype=np.float64), np.asarray(plant, dtype=np.float64)
    for name, values in (("twin", a), ("plant", b)):
        if values.ndim != 1 or not values.size or not np.isfinite(values).all():
            raise ValueError(f"fidelity: the trace of the {name} is invalid; give a row of finite readings")
    if not (math.isfinite(tolerance) and tolerance > 0):
        raise ValueError(f"fidelity: the tolerance is {tolerance}; it must be positive")
    if not (opening >= 0 and extending >= 0):
        raise ValueError(f"fidelity: a gap costs {opening} and {extending}; neither may be negative")
    score, pairs, gaps = _aligned(a, b, tolerance, opening, extending)
    distance = np.abs(a[pairs[:, 0]] - b[pairs[:, 1]])
    matching = distance < tolerance
    mean = float(distance[matching].mean()) if matching.any() else math.nan
    return Fidelity(int(matching.sum()) / max(a.size, b.size), mean, float(score), int(gaps), pairs)


@compiled
def _aligned(
    a: FloatArray, b: FloatArray, tolerance: float, opening: float, extending: float
) -> tuple[float, NDArray[np.int64], int]:
    """Score, pairs, shape (P, 2), and number of gaps of the best alignment."""
    n, m = a.size, b.size
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
                    cost = extending if last == alone else opening + extending
                    if best[last, p, q] - cost > best[alone, i, j]:
                        best[alone, i, j] = best[last, p, q] - cost
                        came[alone, i, j] = last
    step = int(np.argmax(best[:, n, m]))
    score = best[step, n, m]
    pairs = np.zeros((min(n, m), 2), dtype=np.int64)
    i, j, found, gaps = n, m, 0, 0
    while i or j:
        before = came[step, i, j]
        if step == _PAIR:
            i, j = i - 1, j - 1
            pairs[found] = i, j
            found += 1
        else:
            i, j = (i - 1, j) if step == _TWIN else (i, j - 1)
            gaps += (before != step) or not (i or j)
        step = before
    return score, pairs[:found][::-1].copy(), gaps
