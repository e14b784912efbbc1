"""Polynomials with exact coefficients.

Every float is an integer over a power of two, so a few polynomials that only matter up to a common factor
can be scaled to integers and then multiplied, mapped and reduced without any rounding. A polynomial is a
list of integers, the constant first; all of one column have the same length.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from twinmatch.comparing.errors import DiscriminationError
from twinmatch.signals import FloatArray

__all__ = [
    "Column",
    "Polynomial",
    "even_part",
    "exact",
    "multiply",
    "split",
    "to_half_plane",
    "trim",
    "trim_top",
]

Polynomial = list[int]
Column = list[Polynomial]


def exact(polynomials: Sequence[FloatArray]) -> Column:
    """Convert float coefficients, constant first, to integers times a common scale that is dropped.

    Raises:
        DiscriminationError: a coefficient is not finite.
    """
    ratios = []
    for coefficients in polynomials:
        if not np.isfinite(coefficients).all():
            msg = f"model: coefficients {coefficients.tolist()} are not all finite; it cannot be compared"
            raise DiscriminationError(msg)
        ratios.append([c.as_integer_ratio() for c in coefficients.tolist()])
    scale = max((denominator for row in ratios for _, denominator in row), default=1)
    longest = max(len(row) for row in ratios)
    return [[n * (scale // d) for n, d in row] + [0] * (longest - len(row)) for row in ratios]


def multiply(left: Polynomial, right: Polynomial) -> Polynomial:
    """Product of two polynomials."""
    product = [0] * (len(left) + len(right) - 1)
    for i, a in enumerate(left):
        if a:
            for j, b in enumerate(right):
                product[i + j] += a * b
    return product


def trim(column: Column) -> Column:
    """Remove the highest and lowest powers that no polynomial has: common roots at ∞ and at 0."""
    used = [k for k in range(len(column[0])) if any(p[k] for p in column)]
    return [p[used[0] : used[-1] + 1] for p in column] if used else column


def trim_top(column: Column) -> Column:
    """Remove the highest powers that no polynomial has: this lowers the degree."""
    top = max(k for k in range(len(column[0])) if any(p[k] for p in column))
    return [p[: top + 1] for p in column]


def to_half_plane(column: Column) -> Column:
    """Polynomials in z as polynomials in w, z = (1 + w)/(1 − w), all times (1 − w)^n.

    The unit disc becomes the left half plane, z = 1 becomes w = 0 and z = −1 becomes w = ∞. Powers of w then
    resolve best at both ends of the frequency axis, as slow poles near z = 1 require.
    """
    degree = len(column[0]) - 1
    basis = _half_plane_basis(degree)
    return [
        [sum(p[k] * basis[k][i] for k in range(degree + 1) if p[k]) for i in range(degree + 1)]
        for p in column
    ]


@lru_cache(maxsize=64)
def _half_plane_basis(degree: int) -> Column:
    """(1 + w)^k (1 − w)^(degree − k) for every k."""
    basis: Column = []
    for k in range(degree + 1):
        term: Polynomial = [1]
        for factor in [[1, 1]] * k + [[1, -1]] * (degree - k):
            term = multiply(term, factor)
        basis.append(term)
    return basis


def even_part(column: Column) -> Polynomial:
    """Σ |p(jΩ)|² over the column, as a polynomial in Ω²."""
    degree = len(column[0]) - 1
    total = [0] * (degree + 1)
    for p in column:
        mirrored = [c if k % 2 == 0 else -c for k, c in enumerate(p)]
        square = multiply(p, mirrored)
        for k in range(degree + 1):
            total[k] += -square[2 * k] if k % 2 else square[2 * k]
    return total


def split(column: Column) -> tuple[FloatArray, FloatArray]:
    """Coefficients as unevaluated sums of two floats, shape (polynomials, n + 1) each, the largest near 1."""
    scale = 1 << max(abs(c).bit_length() for p in column for c in p)
    high = np.zeros((len(column), len(column[0])))
    low = np.zeros_like(high)
    for i, p in enumerate(column):
        for k, c in enumerate(p):
            leading = c / scale
            n, d = leading.as_integer_ratio()
            high[i, k] = leading
            low[i, k] = (c * d - n * scale) / (d * scale)
    return high, low
