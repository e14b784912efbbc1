"""Common factors of a column of polynomials, to rounding.

Stable common factors do not affect the ν-gap: they cancel in every ratio. One with a root on the imaginary
axis gives 0/0 there, and one in the right half plane adds to the winding number although no transfer function
has the pole. These are divided out if they are common to within rounding. Factors that only nearly cancel
are a property of the model and stay.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import polynomial as power

from twinmatch.comparing.polynomials import Column, exact, split, trim
from twinmatch.signals import FloatArray

__all__ = ["without_unstable_common_factor"]

ON_AXIS = 1e-6
"""A root this close to the axis, relative to 1 or its distance from 0, is treated as lying on it."""

SUSPECT = 1e-6
"""Roots of double factors are known to the square root of rounding only; so are the values there."""

NEARLY_SINGULAR = 1e-12
"""Singular values below this, relative to the largest, make a common factor worth trying."""

ROUNDING = 1e-13
"""Largest residual of a factor that counts as common, relative to the largest coefficient."""

STEPS = 3


def without_unstable_common_factor(column: Column, *, discrete: bool) -> Column:
    """Divide the column by its common factor if that has a root that is not clearly stable.

    Rounding errors in coefficients of z appear in those of w relative to the largest; a continuous model has
    no natural frequency unit, so the one that balances its coefficients is used.
    """
    high, _ = split(column)
    scale = 1.0 if discrete else _frequency(high)
    rows = high * scale ** np.arange(high.shape[1])
    rows /= np.abs(rows).max()
    if not _shares_unstable_root(rows):
        return column
    reduced = _cofactors(rows)
    return column if reduced is None else trim(exact(list(reduced / scale ** np.arange(reduced.shape[1]))))


def _frequency(rows: FloatArray) -> float:
    """A power of two that gives the lowest and the highest power equal weight."""
    size = np.abs(rows).max(axis=0)
    used = np.flatnonzero(size)
    if used.size < 2:
        return 1.0
    return float(2.0 ** np.round((np.log2(size[used[0]]) - np.log2(size[used[-1]])) / (used[-1] - used[0])))


def _shares_unstable_root(rows: FloatArray) -> bool:
    """Whether all polynomials nearly vanish at a root of the first that is not clearly stable."""
    roots = power.polyroots(np.trim_zeros(rows[0], "b"))
    for root in roots[roots.real >= -ON_AXIS * np.maximum(1, np.abs(roots))]:
        powers = root ** np.arange(rows.shape[1])
        if np.all(np.abs(rows @ powers) <= SUSPECT * np.abs(powers).max()):
            return True
    return False


def _cofactors(rows: FloatArray) -> FloatArray | None:
    """Quotients by the greatest common factor, or None if no factor is common to within rounding."""
    degree = rows.shape[1] - 1
    singular = np.linalg.svd(_proportionality(rows, degree - 1), compute_uv=False)
    common = rows.shape[0] * degree - int(np.sum(singular > NEARLY_SINGULAR * singular[0]))
    for count in range(min(common, degree), 0, -1):
        _, _, right = np.linalg.svd(_proportionality(rows, degree - count))
        quotients, residual = _refined(rows, right[-1].reshape(rows.shape[0], -1))
        if residual <= ROUNDING:
            return quotients
    return None


def _refined(rows: FloatArray, quotients: FloatArray) -> tuple[FloatArray, float]:
    """Quotients after Gauss–Newton steps on rows = factor·quotients, and the largest residual."""
    from scipy.linalg import block_diag  # noqa: PLC0415 — a tenth of a second that few models need

    count, width = quotients.shape
    others = rows.shape[1] - width
    products = np.vstack([_times(q, others) for q in quotients])
    factor = _least_squares(products, rows.ravel())
    for _ in range(STEPS):
        slopes = np.hstack([products, block_diag(*[_times(factor, width - 1)] * count)])
        step = _least_squares(slopes, rows.ravel() - products @ factor)
        factor = factor + step[: others + 1]
        quotients = quotients + step[others + 1 :].reshape(count, width)
        products = np.vstack([_times(q, others) for q in quotients])
    return quotients, float(np.abs(products @ factor - rows.ravel()).max())


def _least_squares(matrix: FloatArray, target: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.lstsq(matrix, target, rcond=None)[0], dtype=np.float64)


def _proportionality(rows: FloatArray, degree: int) -> FloatArray:
    """Matrix of the equations p0·h[k] = p[k]·h0 for unknown polynomials h of the given degree."""
    count, width = rows.shape
    height = width + degree
    matrix = np.zeros(((count - 1) * height, count * (degree + 1)))
    first = _times(rows[0], degree)
    for k in range(1, count):
        block = slice((k - 1) * height, k * height)
        matrix[block, k * (degree + 1) : (k + 1) * (degree + 1)] = first
        matrix[block, : degree + 1] = -_times(rows[k], degree)
    return matrix


def _times(polynomial: FloatArray, degree: int) -> FloatArray:
    """Matrix that multiplies coefficients of a polynomial of the given degree by this polynomial."""
    matrix = np.zeros((polynomial.size + degree, degree + 1))
    for k in range(degree + 1):
        matrix[k : k + polynomial.size, k] = polynomial
    return matrix
