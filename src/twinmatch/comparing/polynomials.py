"""Polynomials with exact coefficients, and the models, roots and common factors made of them.

Every float is an integer over a power of two, so a few polynomials that only matter up to a common factor
can be scaled to integers and then multiplied, mapped and reduced without any rounding. A polynomial is a
list of integers, the constant first; all of one column have the same length.

A float eigenvalue solver cannot resolve two roots closer than the square root of the rounding error. Where
that may hide a resonance, the roots are computed again with 50 digits.

The method of Faddeev and LeVerrier is inaccurate in floats but exact in integers: every division in it has
no remainder. A model of order 10 takes some milliseconds, once.

Stable common factors do not affect the ν-gap: they cancel in every ratio. One with a root on the imaginary
axis gives 0/0 there, and one in the right half plane adds to the winding number although no transfer function
has the pole. These are divided out if they are common to within rounding. Factors that only nearly cancel
are a property of the model and stay.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from twinmatch.errors import TwinmatchError
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray


class DiscriminationError(TwinmatchError):
    """A model or table that cannot be scored or compared; the message says which and why."""


Polynomial = list[int]
Column = list[Polynomial]


def exact(polynomials: Sequence[FloatArray]) -> Column:
    """Convert float coefficients, constant first, to integers times a common scale that is dropped.

    Raises:
        DiscriminationError: a coefficient is not finite.
    """
    padded = np.zeros((len(polynomials), max(len(p) for p in polynomials)))
    for row, coefficients in zip(padded, polynomials, strict=True):
        row[: len(coefficients)] = coefficients
    whole, _ = _integers(padded)
    return [list(row) for row in whole]


def multiply(left: Polynomial, right: Polynomial) -> Polynomial:
    """Product of two polynomials."""
    coefficients = [0] * (len(left) + len(right) - 1)
    for i, a in enumerate(left):
        if a:
            for j, b in enumerate(right):
                coefficients[i + j] += a * b
    return coefficients


def product(factors: Iterable[Polynomial]) -> Polynomial:
    """Product of any number of polynomials."""
    return functools.reduce(multiply, factors, [1])


def trim(column: Column) -> Column:
    """Remove the highest and lowest powers that no polynomial has: common roots at ∞ and at 0."""
    used = _used_powers(column)
    return (
        [polynomial[used[0] : used[-1] + 1] for polynomial in column]
        if used
        else column
    )


def trim_top(column: Column) -> Column:
    """Remove the highest powers that no polynomial has: this lowers the degree."""
    top = max(_used_powers(column))
    return [polynomial[: top + 1] for polynomial in column]


def _used_powers(column: Column) -> list[int]:
    """Powers of which some polynomial has a coefficient."""
    return [
        k
        for k, coefficients in enumerate(zip(*column, strict=True))
        if any(coefficients)
    ]


def to_half_plane(column: Column) -> Column:
    """Polynomials in z as polynomials in w, z = (1 + w)/(1 − w), all times (1 − w)^n.

    The unit disc becomes the left half plane, z = 1 becomes w = 0 and z = −1 becomes w = ∞. Powers of w then
    resolve best at both ends of the frequency axis, as slow poles near z = 1 require.
    """
    degree = len(column[0]) - 1
    basis = _half_plane_basis(degree)
    mapped = []
    for polynomial in column:
        coefficients = [0] * (degree + 1)
        for coefficient, powers_of_w in zip(polynomial, basis, strict=True):
            if coefficient:
                for i, factor in enumerate(powers_of_w):
                    coefficients[i] += coefficient * factor
        mapped.append(coefficients)
    return mapped


@functools.lru_cache(maxsize=64)
def _half_plane_basis(degree: int) -> Column:
    """(1 + w)^k (1 − w)^(degree − k) for every k."""
    return [product([[1, 1]] * k + [[1, -1]] * (degree - k)) for k in range(degree + 1)]


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


def scale_of(column: Column) -> int:
    """The power of two above the largest coefficient."""
    return 1 << max(abs(c).bit_length() for p in column for c in p)


def split(column: Column, scale: int | None = None) -> tuple[FloatArray, FloatArray]:
    """Coefficients as unevaluated sums of two floats, shape (polynomials, n + 1) each, divided by `scale`;
    default: the largest near 1."""
    scale = scale or scale_of(column)
    high = np.zeros((len(column), len(column[0])))
    low = np.zeros_like(high)
    for i, p in enumerate(column):
        for k, c in enumerate(p):
            leading = c / scale
            n, d = leading.as_integer_ratio()
            high[i, k] = leading
            low[i, k] = (c * d - n * scale) / (d * scale)
    return high, low


def is_hurwitz(polynomial: Polynomial) -> bool:
    """Routh's test on integers, constant first; a highest coefficient of zero is a root at infinity.

    Roots on the imaginary axis or at infinity are not stable.
    """
    sign = -1 if polynomial[-1] < 0 else 1
    descending = [sign * c for c in reversed(polynomial)]
    if not all(c > 0 for c in descending):
        return False
    above = descending[::2]
    row = descending[1::2]
    while row:
        if row[0] <= 0:
            return False
        padded = row + [0] * (len(above) - len(row))
        below = [row[0] * above[k] - above[0] * padded[k] for k in range(1, len(above))]
        divisor = math.gcd(*below) or 1
        above = row
        row = [c // divisor for c in below]
    return True


NEAR = 1e-5
"""Angle to the positive real axis, radians, below which roots are refined."""

MAX_STEPS = 500


def roots_of_even_part(polynomial: Polynomial) -> NDArray[np.complex128]:
    """Roots in Ω² of a polynomial that is positive for real Ω; those near the real axis refined."""
    high, _ = split([polynomial])
    roots = _roots(high[0])
    if np.any((roots.real > 0) & (np.abs(roots.imag) < NEAR * np.abs(roots))):
        return _refine_roots(polynomial)
    return roots


def _roots(ascending: FloatArray) -> NDArray[np.complex128]:
    """Roots of a polynomial, constant first: the eigenvalues of its companion matrix.

    Neither end of a trimmed polynomial is zero, and `numpy.roots` spends most of its time on looking for zeros there.
    """
    if ascending[0] == 0.0 or ascending[-1] == 0.0:  # too small for a float
        return np.asarray(np.roots(ascending[::-1]), dtype=np.complex128)
    companion = np.eye(ascending.size - 1, k=-1)
    companion[:1] = ascending[-2::-1] / -ascending[-1]
    return np.linalg.eigvals(companion).astype(np.complex128)


def _refine_roots(polynomial: Polynomial) -> NDArray[np.complex128]:
    """Roots with 50 digits; those of a power of a factor are computed once, as they would not converge."""
    from sympy import Poly, Symbol  # noqa: PLC0415

    _, factors = Poly(polynomial[::-1], Symbol("x")).sqf_list()
    roots = [
        root
        for factor, power in factors
        for root in factor.nroots(50, maxsteps=MAX_STEPS) * power
    ]
    return np.array([complex(root) for root in roots])


def column_of(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray) -> Column:
    """det(sI − A) and the numerators C adj(sI − A) B + D det(sI − A), all times one power of two.

    Args:
        A, B, C, D: shapes (n, n), (n, 1), (m, n), (m, 1).

    Raises:
        DiscriminationError: an entry is not finite.
    """
    order = len(A)
    whole, scale = _integers(np.vstack([np.hstack([A, B]), np.hstack([C, D])]))
    a = whole[:order, :order]
    b = whole[:order, order:]
    c = whole[order:, :order]
    d = whole[order:, order]
    # with s = σ/scale, σI − a has integer entries
    characteristic, adjugate_b = _faddeev_leverrier(a, b)
    powers = [scale**k for k in range(order + 1)]
    scaled = [
        power * coefficient
        for power, coefficient in zip(powers, characteristic, strict=True)
    ]
    column = [[scale * coefficient for coefficient in scaled]]
    for row, direct in zip(c, d, strict=True):
        numerator = [direct * coefficient for coefficient in scaled]
        for k in range(order):
            numerator[k] += int((row @ adjugate_b[k])[0]) * powers[k]
        column.append(numerator)
    return column


def _faddeev_leverrier(a: Any, b: Any) -> tuple[list[int], list[Any]]:
    """Coefficients of det(σI − a) and of adj(σI − a)·b in σ, lowest first, in whole numbers."""
    order = len(a)
    characteristic = [0] * order + [1]
    adjugate_b: list[Any] = [None] * order
    identity = np.array(
        [[int(i == j) for j in range(order)] for i in range(order)], dtype=object
    )
    m = identity
    for k in range(1, order + 1):
        adjugate_b[order - k] = m @ b
        m = a @ m
        characteristic[order - k] = -sum(m[i, i] for i in range(order)) // k
        m = m + characteristic[order - k] * identity
    return characteristic, adjugate_b


def _integers(matrix: FloatArray) -> tuple[Any, int]:
    """A matrix times the smallest power of two that makes its entries integers, and that power."""
    if not np.isfinite(matrix).all():
        msg = f"model: its numbers {np.asarray(matrix).tolist()} are not all finite; it cannot be compared"
        raise DiscriminationError(msg)
    ratios: Sequence[tuple[int, int]] = [
        float(x).as_integer_ratio() for x in np.ravel(matrix)
    ]
    scale = max((d for _, d in ratios), default=1)
    whole = np.empty(len(ratios), dtype=object)
    whole[:] = [n * (scale // d) for n, d in ratios]
    return whole.reshape(np.shape(matrix)), scale


ON_AXIS = 1e-6
"""A root this close to the axis, relative to 1 or its distance from 0, is treated as lying on it."""

SUSPECT = 1e-6
"""Roots of double factors are known to the square root of rounding only; so are the values there."""


class _CommonFactor(Rule):
    """When polynomials have a common factor to within rounding: where a linear system is nearly singular, one
    is tried and refined, and accepted if hardly more than the rounding of the coefficients is left."""

    singular: float = 1e-12
    """Singular values below this, relative to the largest, make a common factor worth trying."""
    rounding: float = 1e-13
    """Largest residual of a factor that counts as common, relative to the largest coefficient."""
    steps: int = 3
    """Steps of refinement."""


_COMMON: Final = _CommonFactor()


def without_unstable_common_factor(
    column: Column, high: FloatArray, *, discrete: bool
) -> Column:
    """Divide the column, in floats `high`, by its common factor if that has a root that is not clearly stable.

    Rounding errors in coefficients of z appear in those of w relative to the largest; a continuous model has
    no natural frequency unit, so the one that balances its coefficients is used.
    """
    scale = 1.0 if discrete else _frequency(high)
    rows = high * scale ** np.arange(high.shape[1])
    rows /= np.abs(rows).max()
    if not _shares_unstable_root(rows):
        return column
    reduced = _cofactors(rows)
    return (
        column
        if reduced is None
        else trim(exact(list(reduced / scale ** np.arange(reduced.shape[1]))))
    )


def _frequency(rows: FloatArray) -> float:
    """A power of two that gives the lowest and the highest power equal weight."""
    size = np.abs(rows).max(axis=0)
    used = np.flatnonzero(size)
    if used.size < 2:
        return 1.0
    lowest = used[0]
    highest = used[-1]
    octaves = (np.log2(size[lowest]) - np.log2(size[highest])) / (highest - lowest)
    return float(2.0 ** np.round(octaves))


def _shares_unstable_root(rows: FloatArray) -> bool:
    """Whether all polynomials nearly vanish at a root of the first that is not clearly stable."""
    degree = int(np.flatnonzero(rows[0])[-1])
    roots = _roots(rows[0, : degree + 1])
    for root in roots[roots.real >= -ON_AXIS * np.maximum(1, np.abs(roots))]:
        powers = root ** np.arange(rows.shape[1])
        if np.all(np.abs(rows @ powers) <= SUSPECT * np.abs(powers).max()):
            return True
    return False


def _cofactors(rows: FloatArray) -> FloatArray | None:
    """Quotients by the greatest common factor, or None if no factor is common to within rounding."""
    degree = rows.shape[1] - 1
    singular = np.linalg.svd(_proportionality(rows, degree - 1), compute_uv=False)
    common = rows.shape[0] * degree - int(
        np.sum(singular > _COMMON.singular * singular[0])
    )
    for count in range(min(common, degree), 0, -1):
        _, _, right = np.linalg.svd(_proportionality(rows, degree - count))
        quotients, residual = _refine_quotients(
            rows, right[-1].reshape(rows.shape[0], -1)
        )
        if residual <= _COMMON.rounding:
            return quotients
    return None


def _refine_quotients(
    rows: FloatArray, quotients: FloatArray
) -> tuple[FloatArray, float]:
    """Quotients after Gauss–Newton steps on rows = factor·quotients, and the largest residual."""
    from scipy.linalg import block_diag  # noqa: PLC0415

    count, width = quotients.shape
    degree = rows.shape[1] - width
    products = np.vstack([_product_matrix(q, degree) for q in quotients])
    factor = _least_squares(products, rows.ravel())
    for _ in range(_COMMON.steps):
        slopes = np.hstack(
            [products, block_diag(*[_product_matrix(factor, width - 1)] * count)]
        )
        step = _least_squares(slopes, rows.ravel() - products @ factor)
        factor = factor + step[: degree + 1]
        quotients = quotients + step[degree + 1 :].reshape(count, width)
        products = np.vstack([_product_matrix(q, degree) for q in quotients])
    return quotients, float(np.abs(products @ factor - rows.ravel()).max())


def _least_squares(matrix: FloatArray, target: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.lstsq(matrix, target, rcond=None)[0], dtype=np.float64)


def _proportionality(rows: FloatArray, degree: int) -> FloatArray:
    """Matrix of the equations p0·h[k] = p[k]·h0 for unknown polynomials h of the given degree."""
    count, width = rows.shape
    height = width + degree
    matrix = np.zeros(((count - 1) * height, count * (degree + 1)))
    first = _product_matrix(rows[0], degree)
    for k in range(1, count):
        block = slice((k - 1) * height, k * height)
        matrix[block, k * (degree + 1) : (k + 1) * (degree + 1)] = first
        matrix[block, : degree + 1] = -_product_matrix(rows[k], degree)
    return matrix


def _product_matrix(polynomial: FloatArray, degree: int) -> FloatArray:
    """Matrix that multiplies coefficients of a polynomial of the given degree by this polynomial."""
    matrix = np.zeros((polynomial.size + degree, degree + 1))
    for k in range(degree + 1):
        matrix[k : k + polynomial.size, k] = polynomial
    return matrix
