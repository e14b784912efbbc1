"""Kernels: how the chordal distance of two models changes when their frequency responses are perturbed.

At one frequency the distance is the length of a complex vector, v = minors of [1 P1; 1 P2] over both lengths.
A perturbation moves it to v + e. If the true vector were t·v, the estimate would be the largest |t·v + e|
over the frequencies, and |t·v + e|² = a t² + b t + c with a = |v|², b = 2 Re v*e, c = |e|². These three
coefficients per pair are enough to compute the estimates for any true t·v.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.signals import FloatArray

__all__ = ["directions", "disturbed_pair", "estimates", "failing_draws", "fitting_scales", "turn"]

Complex = NDArray[np.complex128]

HALVINGS = 7
"""Halvings of the interval that contains a scale: finer than a hundred draws resolve."""


@compiled
def directions(responses: Complex) -> Complex:
    """Columns [1; P] of length 1, (n, frequencies, 1 + outputs), for P of shape (n, frequencies, outputs)."""
    n, points, outputs = responses.shape
    columns = np.empty((n, points, outputs + 1), dtype=np.complex128)
    for i in range(n):
        for w in range(points):
            square = 1.0
            for m in range(outputs):
                square += responses[i, w, m].real ** 2 + responses[i, w, m].imag ** 2
            scale = 1 / math.sqrt(square)
            columns[i, w, 0] = scale
            for m in range(outputs):
                columns[i, w, m + 1] = responses[i, w, m] * scale
    return columns


@compiled
def disturbed_pair(
    still1: Complex, still2: Complex, moved1: Complex, moved2: Complex
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The coefficients a, b and c of one pair.

    Args:
        still1: unperturbed direction of the first model, shape (frequencies, 1 + outputs).
        still2: that of the second model.
        moved1: direction of the first model in every draw, shape (draws, frequencies, 1 + outputs).
        moved2: that of the second model.

    Returns:
        Shapes (frequencies,), (frequencies, draws) and (frequencies, draws): draws are contiguous in memory,
        so that they can be vectorised.
    """
    draws, points, rows = moved1.shape
    a = np.zeros(points)
    b = np.zeros((points, draws))
    c = np.zeros((points, draws))
    for m in range(rows):
        for k in range(m + 1, rows):
            for w in range(points):
                v = still1[w, m] * still2[w, k] - still1[w, k] * still2[w, m]
                a[w] += v.real * v.real + v.imag * v.imag
                for s in range(draws):
                    e = moved1[s, w, m] * moved2[s, w, k] - moved1[s, w, k] * moved2[s, w, m] - v
                    b[w, s] += 2 * (v.real * e.real + v.imag * e.imag)
                    c[w, s] += e.real * e.real + e.imag * e.imag
    return a, b, c


@compiled
def turn(direction1: Complex, direction2: Complex) -> float:
    """Total phase change of the inner product of two models' directions over the frequencies, radians."""
    total, before = 0.0, 0j
    for w in range(direction1.shape[0]):
        inner = 0j
        for m in range(direction1.shape[1]):
            inner += direction1[w, m] * direction2[w, m].conjugate()
        if w > 0:
            ratio = inner * before.conjugate()
            total += math.atan2(ratio.imag, ratio.real)
        before = inner
    return total


@compiled
def failing_draws(
    a: FloatArray,
    c: FloatArray,
    still: tuple[Complex, Complex],
    moved: tuple[Complex, Complex],
    failed: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """In which draws the winding condition fails at any operating point, shape (draws,).

    The condition cannot change while the distance stays below 1 along the perturbation; a change shows in the
    phase of the inner product.

    Args:
        a: from `disturbed_pair`, the frequencies of one operating point after the other.
        c: likewise.
        still: unperturbed directions of the two models, shape (frequencies, 1 + outputs).
        moved: the same in every draw, shape (draws, frequencies, 1 + outputs).
        failed: whether the condition fails at each operating point without the draws, shape (points,).
    """
    width = a.size // failed.size
    fails = np.full(c.shape[1], failed.any())
    top = math.sqrt(a.max())
    for s in range(c.shape[1]):
        if not failed.any() and top + math.sqrt(c[:, s].max()) < 1:
            continue
        fails[s] = False
        for p in range(failed.size):
            part = slice(p * width, (p + 1) * width)
            before = turn(still[0][part], still[1][part])
            changed = abs(turn(moved[0][s, part], moved[1][s, part]) - before) > 0.5 * math.pi
            if changed != failed[p]:
                fails[s] = True
    return fails


@compiled
def estimates(
    which: NDArray[np.int64], a: FloatArray, b: FloatArray, c: FloatArray, scale: float
) -> FloatArray:
    """Sum over the pairs `which` of the largest |scale·v + e|, one per draw, shape (draws,)."""
    points, draws = b.shape[1:]
    total = np.zeros(draws)
    top = np.empty(draws)
    for p in which:
        top[:] = 0.0
        for w in range(points):
            square = a[p, w] * scale
            for s in range(draws):
                found = (square + b[p, w, s]) * scale + c[p, w, s]
                top[s] = found if found > top[s] else top[s]
        for s in range(draws):
            total[s] += min(1.0, math.sqrt(top[s]))
    return total


@compiled
def _count_reaching(  # noqa: PLR0917
    which: NDArray[np.int64], a: FloatArray, b: FloatArray, c: FloatArray, scale: float, seen: float
) -> int:
    """Number of draws in which `estimates` is `seen` or more."""
    return int(np.sum(estimates(which, a, b, c, scale) >= seen))


@compiled
def fitting_scales(
    which: NDArray[np.int64], a: FloatArray, b: FloatArray, c: FloatArray, tail: float
) -> tuple[float, float]:
    """Least and largest t for which the actual estimate lies between the quantiles tail and 1 − tail of t·v.

    The actual estimate is the sum over the pairs of the largest |v|.
    """
    seen, most = 0.0, 0.0
    for p in which:
        seen += math.sqrt(a[p].max())
        most += math.sqrt(c[p].max())
    draws = b.shape[2]
    rare = int(tail * draws)
    # beyond these limits no draw reaches the actual estimate
    widest = 2 * most / max(seen, 1e-300)
    low, high = max(0.0, 1.0 - widest), 1.0
    if low == 0.0 and _count_reaching(which, a, b, c, 0.0, seen) > rare:
        high = 0.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if _count_reaching(which, a, b, c, middle, seen) > rare:
            high = middle
        else:
            low = middle
    least = low
    low, high = 1.0, 1.0 + widest
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if _count_reaching(which, a, b, c, middle, seen) < draws - rare:
            low = middle
        else:
            high = middle
    return least, high
