"""State-space models as columns of polynomials, in exact arithmetic.

The method of Faddeev and LeVerrier is inaccurate in floats but exact in integers: every division in it has
no remainder. A model of order 10 takes some milliseconds, once.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from twinmatch.comparing.errors import DiscriminationError
from twinmatch.comparing.polynomials import Column
from twinmatch.signals import FloatArray

__all__ = ["column_of"]


def column_of(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray) -> Column:
    """det(sI − A) and the numerators C adj(sI − A) B + D det(sI − A), all times one power of two.

    Args:
        A, B, C, D: shapes (n, n), (n, 1), (m, n), (m, 1).

    Raises:
        DiscriminationError: an entry is not finite.
    """
    order = len(A)
    a, a_scale = _integers(A)
    b, b_scale = _integers(B)
    c, c_scale = _integers(C)
    d, d_scale = _integers(D)
    # with s = σ/a_scale, σI − a has integer entries; M[k] are the coefficients of its adjugate
    characteristic = [0] * order + [1]
    adjugate_b: list[Any] = [None] * order
    identity = np.array([[int(i == j) for j in range(order)] for i in range(order)], dtype=object)
    m = identity
    for k in range(1, order + 1):
        adjugate_b[order - k] = m @ b
        product = a @ m
        characteristic[order - k] = -sum(product[i, i] for i in range(order)) // k
        m = product + characteristic[order - k] * identity
    scaled = [coefficient * a_scale**k for k, coefficient in enumerate(characteristic)]
    column = [[coefficient * b_scale * c_scale * d_scale for coefficient in scaled]]
    for output in range(len(C)):
        through = [coefficient * d[output, 0] * b_scale * c_scale for coefficient in scaled]
        for k in range(order):
            through[k] += int((c[output] @ adjugate_b[k])[0]) * a_scale ** (k + 1) * d_scale
        column.append(through)
    return column


def _integers(matrix: FloatArray) -> tuple[Any, int]:
    """A matrix times the smallest power of two that makes its entries integers, and that power."""
    if not np.isfinite(matrix).all():
        msg = (
            f"model: a state-space matrix {np.asarray(matrix).tolist()} is not finite; it cannot be compared"
        )
        raise DiscriminationError(msg)
    ratios: Sequence[tuple[int, int]] = [float(x).as_integer_ratio() for x in np.ravel(matrix)]
    scale = max((d for _, d in ratios), default=1)
    whole = np.empty(len(ratios), dtype=object)
    whole[:] = [n * (scale // d) for n, d in ratios]
    return whole.reshape(np.shape(matrix)), scale
