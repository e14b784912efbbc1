"""Damped least squares inside bounds, for few parameters and many residuals.

Levenberg–Marquardt on the normal equations. A step is the minimum of the damped quadratic model inside
the box, found by fixing one parameter after another on the bound it would cross and letting go those that
pull inwards; so a parameter lands on its bound exactly, and leaves it again when the residuals ask for
it. The search ends where an undamped step promises nothing more, which a step cut short by damping cannot
pretend.
"""

# ruff: noqa: PLR0912, PLR0917 (a kernel is long and takes arrays in a row)

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple, Protocol

import numpy as np

from twinmatch.compiled import compiled
from twinmatch.signals import FloatArray

__all__ = ["LEAST_DAMPING", "Descended", "Point", "box_step", "descend"]

_TOLERANCE = 1e-9
"""Promised decrease, in units of the sum of squares, below which the search ends."""
_NOTHING = 1e-10
"""The same in units of the noise variance: exact data leave no sum to compare with."""
_SMALL = 1e-10
"""Step, in units of the scales, below which a search between kinks ends."""
_FIRST_DAMPING = 1e-3
_NEAR, _ALIKE = 0.5, 0.5
"""Largest rise above a minimum found before, and largest error of its quadratic model, within its valley."""
LEAST_DAMPING: Final = 1e-12


class Point(Protocol):
    """A problem at some values of its parameters."""

    @property
    def cost(self) -> float:
        """Sum of the squared residuals."""

    @property
    def normal(self) -> tuple[float, FloatArray, FloatArray]:
        """That sum, the gradient Jᵀr, shape (n,), and JᵀJ, shape (n, n)."""


class Descended(NamedTuple):
    """Where a search ended."""

    values: FloatArray
    cost: float
    """Sum of the squared residuals."""
    converged: bool
    evaluations: int
    hessian: FloatArray
    """JᵀJ there, shape (n, n)."""


def descend(
    evaluate: Callable[[FloatArray], Point],
    start: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    scales: FloatArray,
    most_evaluations: int,
    found: Descended | None = None,
) -> Descended:
    """Minimise the sum of squared residuals from one start (shape (n,), inside the bounds).

    Where the search comes into the valley of a minimum found before, it ends with that one.
    """
    values, evaluations = start, 1
    cost, gradient, hessian = evaluate(values).normal
    damping, growth = _FIRST_DAMPING, 2.0
    while True:
        if found is not None and _in_valley(found, values, cost):
            return found
        _, promised = box_step(hessian, gradient, values, lower, upper, LEAST_DAMPING)
        if promised <= _TOLERANCE * cost + _NOTHING:
            return Descended(values, cost, True, evaluations, hessian)
        while True:
            if evaluations >= most_evaluations:
                return Descended(values, cost, False, evaluations, hessian)
            step, expected = box_step(hessian, gradient, values, lower, upper, damping)
            if not np.max(np.abs(step) / scales) > _SMALL:
                return Descended(values, cost, bool(np.isfinite(cost)), evaluations, hessian)
            tried = _onto_bounds(values + step, lower, upper)
            there = evaluate(tried)
            evaluations += 1
            if there.cost < cost:
                break
            damping, growth = damping * growth, 2.0 * growth
        # How far the quadratic model was right decides how far the next one is followed.
        trusted = (cost - there.cost) / expected if expected > 0.0 else 0.0
        damping = max(damping * max(0.1, 1.0 - (2.0 * trusted - 1.0) ** 3), LEAST_DAMPING)
        growth = 2.0
        values = tried
        cost, gradient, hessian = there.normal


def _onto_bounds(values: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """What lies beyond a bound, or short of it by no more than rounding, is put on it."""
    near = 1e-12 * (upper - lower)
    return np.where(values < lower + near, lower, np.where(values > upper - near, upper, values))


def _in_valley(found: Descended, values: FloatArray, cost: float) -> bool:
    """Whether the quadratic model around a minimum found before accounts for the sum at these values."""
    way = values - found.values
    rise = float(way @ found.hessian @ way)
    return found.converged and rise <= _NEAR * found.cost and abs(cost - found.cost - rise) <= _ALIKE * rise


@compiled
def box_step(
    hessian: FloatArray,
    gradient: FloatArray,
    values: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    damping: float,
) -> tuple[FloatArray, float]:
    """Step to the minimum of gᵀd + ½dᵀ(H + damping·diag H)d with values + d in the box.

    Returns the step, shape (n,), and by how much 2gᵀd + dᵀHd, the change of the sum, is negative.
    """
    n = values.size
    step = np.zeros(n)
    held = np.zeros(n, dtype=np.bool_)
    for i in range(n):
        outward = gradient[i] > 0.0 if values[i] <= lower[i] else values[i] >= upper[i] and gradient[i] < 0.0
        held[i] = outward or lower[i] == upper[i] or not hessian[i, i] > 0.0
    for _ in range(4 * n):
        # Cholesky on what is free, in units in which the diagonal is one.
        free = np.flatnonzero(~held)
        m = free.size
        factor, right = np.zeros((m, m)), np.zeros(m)
        for i in range(m):
            p = free[i]
            size = np.sqrt(hessian[p, p])
            right[i] = -gradient[p]
            for q in range(n):
                if held[q]:
                    right[i] -= hessian[p, q] * step[q]
            right[i] /= size
            for j in range(i + 1):
                q = free[j]
                value = hessian[p, q] / size / np.sqrt(hessian[q, q])
                if i == j:
                    value = 1.0 + damping
                for k in range(j):
                    value -= factor[i, k] * factor[j, k]
                factor[i, j] = np.sqrt(max(value, 1e-15)) if i == j else value / factor[j, j]
        for i in range(m):
            for k in range(i):
                right[i] -= factor[i, k] * right[k]
            right[i] /= factor[i, i]
        for i in range(m - 1, -1, -1):
            for k in range(i + 1, m):
                right[i] -= factor[k, i] * right[k]
            right[i] /= factor[i, i]
        first, reach = -1, 1.0
        for i in range(m):
            p = free[i]
            step[p] = right[i] / np.sqrt(hessian[p, p])
            room = upper[p] - values[p] if step[p] > 0.0 else lower[p] - values[p]
            if abs(step[p]) > abs(room) and abs(room) / abs(step[p]) < reach:
                first, reach = p, abs(room) / abs(step[p])
        if first < 0:
            # A parameter that would rather leave its bound again is let go, one at a time.
            pull = 0.0
            for i in range(n):
                if held[i] and lower[i] < upper[i] and hessian[i, i] > 0.0:
                    slope = gradient[i] + damping * hessian[i, i] * step[i]
                    for j in range(n):
                        slope += hessian[i, j] * step[j]
                    inward = -slope if values[i] + step[i] <= lower[i] else slope
                    inward /= np.sqrt(hessian[i, i])
                    if inward > max(pull, 1e-9 * abs(gradient[i]) / np.sqrt(hessian[i, i])):
                        first, pull = i, inward
            if first < 0:
                break
            held[first] = False
            continue
        step[first] = upper[first] - values[first] if step[first] > 0.0 else lower[first] - values[first]
        held[first] = True
    promised = 0.0
    for i in range(n):
        promised -= 2.0 * gradient[i] * step[i]
        for j in range(n):
            promised -= step[i] * hessian[i, j] * step[j]
    return step, promised
