"""Damped least squares inside bounds, for few parameters and many residuals.

Levenberg–Marquardt on the normal equations. A step is the minimum of the damped quadratic model inside
the box, found by fixing one parameter after another on the bound that it would cross and releasing those
whose gradient points inwards; so a parameter reaches its bound exactly, and leaves it again if that reduces
the residuals. The search ends when an undamped step predicts no further decrease; a damped step would be too
short to show that.

The search has an ask-and-tell interface: `update_search` takes the sum of squares at the requested point and
sets the next one. So the same search runs in Python, on any function (`descend`), and within a plant's
compiled code.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.dynamics.kernels import copy_into
from twinmatch.signals import FloatArray

_TOLERANCE = 1e-9
"""Predicted decrease, in units of the sum of squares, below which the search ends."""
_NOTHING = 1e-10
"""The same in units of the noise variance: with exact data the sum of squares is zero."""
_SMALL = 1e-10
"""Step, in units of the scales, below which a search between kinks ends."""
_FIRST_DAMPING = 1e-3
_NEAR = 0.5
_ALIKE = 0.5
"""Largest rise above a minimum found before, and largest error of its quadratic model, within its valley."""
MIN_DAMPING: Final = 1e-12
_SETTLING = 1e-9
_MAX_DAMPING = 1e9
"""Damping tried next if the least finds no step, and damping at which parameters are nearly independent."""

(
    _DAMPING,
    _GROWTH,
    _EXPECTED,
    _EVALUATIONS,
    _MAX_EVALUATIONS,
    _CONVERGED,
    _KNOWN,
    _CAME_BACK,
    _SETTLED,
    _N,
) = range(10)


class Descended(NamedTuple):
    """Result of a search."""

    values: FloatArray
    cost: float
    """Sum of the squared residuals."""
    converged: bool
    evaluations: int
    hessian: FloatArray
    """JᵀJ at `values`, shape (n, n)."""


class Search(NamedTuple):
    """State of a search, for compiled code; every array is changed in place."""

    point: FloatArray
    """The point to evaluate next, shape (n,)."""
    values: FloatArray
    """The best point so far."""
    best: FloatArray
    """The sum of squares there, shape (1,)."""
    gradient: FloatArray
    hessian: FloatArray
    lower: FloatArray
    upper: FloatArray
    scales: FloatArray
    known: FloatArray
    """A minimum found before, shape (n,), and its JᵀJ."""
    known_hessian: FloatArray
    figures: FloatArray
    """Damping, its growth, expected decrease, evaluations so far and at most, whether it converged, sum at
    the known minimum (NaN without one), whether the search entered its valley, and the predicted decrease
    at which it ends."""


def new_search(  # noqa: PLR0917
    start: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    scales: FloatArray,
    most_evaluations: int,
    found: Descended | None = None,
    settled: float = 0.0,
) -> Search:
    """A new search, which first requests its start, shape (n,), inside the bounds.

    It ends where an undamped step predicts a decrease of at most `settled`, and where that is rounding.
    """
    n = start.size
    figures = np.zeros(_N)
    figures[_DAMPING] = _FIRST_DAMPING
    figures[_GROWTH] = 2.0
    figures[_MAX_EVALUATIONS] = most_evaluations
    figures[_SETTLED] = settled
    is_known = found is not None and found.converged
    figures[_KNOWN] = found.cost if is_known and found else np.nan
    return Search(
        point=start.copy(),
        values=start.copy(),
        best=np.full(1, np.inf),
        gradient=np.empty(n),
        hessian=np.empty((n, n)),
        # columns of an array would need kernels of their own
        lower=np.ascontiguousarray(lower),
        upper=np.ascontiguousarray(upper),
        scales=scales,
        known=found.values if is_known and found else start,
        known_hessian=found.hessian if is_known and found else np.zeros((n, n)),
        figures=figures,
    )


def search_result(search: Search, found: Descended | None) -> Descended:
    """The result of a search; `found` itself if the search entered that minimum's valley."""
    figures = search.figures
    if found is not None and figures[_CAME_BACK]:
        return found
    return Descended(
        search.values,
        float(search.best[0]),
        bool(figures[_CONVERGED]),
        int(figures[_EVALUATIONS]),
        search.hessian,
    )


def descend(  # noqa: PLR0917
    normal: Callable[[FloatArray], tuple[float, FloatArray, FloatArray]],
    start: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    scales: FloatArray,
    most_evaluations: int,
    found: Descended | None = None,
    settled: float = 0.0,
) -> Descended:
    """Minimise the sum of squared residuals from one start (shape (n,), inside the bounds).

    `normal` gives the sum, the gradient Jᵀr, shape (n,), and JᵀJ, shape (n, n). If the search enters the
    valley of the minimum `found` before, it ends with that one. `settled` as in `new_search`.
    """
    search = new_search(start, lower, upper, scales, most_evaluations, found, settled)
    while update_search(search, *normal(search.point.copy())):
        pass
    return search_result(search, found)


@compiled
def update_search(
    search: Search, cost: float, gradient: FloatArray, hessian: FloatArray
) -> bool:
    """Take sum, gradient and JᵀJ at the requested point; return whether another point is requested."""
    values = search.values
    figures = search.figures
    lower = search.lower
    upper = search.upper
    first = figures[_EVALUATIONS] == 0.0
    figures[_EVALUATIONS] += 1.0
    if first or cost < search.best[0]:
        if not first:
            # The accuracy of the quadratic model sets the damping of the next step.
            fell = search.best[0] - cost
            expected = figures[_EXPECTED]
            trusted = fell / expected if expected > 0.0 else 0.0
            less = max(0.1, 1.0 - (2.0 * trusted - 1.0) ** 3)
            figures[_DAMPING] = max(figures[_DAMPING] * less, MIN_DAMPING)
            figures[_GROWTH] = 2.0
        search.best[0] = cost
        copy_into(search.point, values)
        copy_into(gradient, search.gradient)
        for i in range(gradient.size):
            copy_into(hessian[i], search.hessian[i])
        if _in_valley(search, cost):
            figures[_CAME_BACK] = figures[_CONVERGED] = 1.0
            return False
        promised = box_step(
            search.hessian, search.gradient, values, lower, upper, MIN_DAMPING
        )[1]
        if promised <= max(_TOLERANCE * cost + _NOTHING, figures[_SETTLED]):
            figures[_CONVERGED] = 1.0
            return False
    else:
        figures[_DAMPING] *= figures[_GROWTH]
        figures[_GROWTH] *= 2.0
    if figures[_EVALUATIONS] >= figures[_MAX_EVALUATIONS]:
        return False
    step, expected = box_step(
        search.hessian, search.gradient, values, lower, upper, figures[_DAMPING]
    )
    figures[_EXPECTED] = expected
    moved = False
    for i in range(values.size):
        moved = moved or abs(step[i]) > _SMALL * search.scales[i]
        # A point beyond a bound, or within rounding of it, is set on it.
        target = values[i] + step[i]
        near = 1e-12 * (upper[i] - lower[i])
        target = lower[i] if target < lower[i] + near else target
        search.point[i] = upper[i] if target > upper[i] - near else target
    if not moved:
        figures[_CONVERGED] = 1.0 if np.isfinite(search.best[0]) else 0.0
    return moved


@compiled(inside=True)
def _in_valley(search: Search, cost: float) -> bool:
    """Whether the quadratic model around a minimum found before explains the sum at these values."""
    least = search.figures[_KNOWN]
    if np.isnan(least):
        return False
    rise = 0.0
    n = search.values.size
    for i in range(n):
        for j in range(n):
            way = (search.values[i] - search.known[i]) * (
                search.values[j] - search.known[j]
            )
            rise += search.known_hessian[i, j] * way
    return bool(rise <= _NEAR * least and abs(cost - least - rise) <= _ALIKE * rise)


@compiled
def box_step(  # noqa: PLR0917
    hessian: FloatArray,
    gradient: FloatArray,
    values: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    damping: float,
) -> tuple[FloatArray, float]:
    """Step d to the minimum of gᵀd + ½dᵀ(H + damping·diag H)d with values + d in the box.

    If parameters that trade off against each other cycle between bounds, the damping is increased until they
    settle.

    Returns the step, shape (n,), and the predicted decrease −(2gᵀd + dᵀHd) of the sum.
    """
    step, settled = _step_of_free(hessian, gradient, values, lower, upper, damping)
    while not settled and damping < _MAX_DAMPING:
        damping = max(100.0 * damping, _SETTLING)
        step, settled = _step_of_free(hessian, gradient, values, lower, upper, damping)
    promised = 0.0
    for i in range(values.size):
        promised -= 2.0 * gradient[i] * step[i]
        for j in range(values.size):
            promised -= step[i] * hessian[i, j] * step[j]
    return step, promised


@compiled(inside=True)
def _step_of_free(  # noqa: PLR0917
    hessian: FloatArray,
    gradient: FloatArray,
    values: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    damping: float,
) -> tuple[FloatArray, bool]:
    """That step, found by fixing parameters one after another on the bounds they would cross and releasing
    others; and whether this has settled."""
    n = values.size
    step = np.zeros(n)
    fixed = np.zeros(n, dtype=np.bool_)
    for i in range(n):
        outward = (
            gradient[i] > 0.0
            if values[i] <= lower[i]
            else values[i] >= upper[i] and gradient[i] < 0.0
        )
        fixed[i] = outward or lower[i] == upper[i] or not hessian[i, i] > 0.0
    for _ in range(4 * n):
        _solve_free(hessian, gradient, step, fixed, damping)
        first = -1
        reach = 1.0
        for p in range(n):
            if fixed[p]:
                continue
            room = upper[p] - values[p] if step[p] > 0.0 else lower[p] - values[p]
            if abs(step[p]) > abs(room) and abs(room) / abs(step[p]) < reach:
                first = p
                reach = abs(room) / abs(step[p])
        if first >= 0:
            step[first] = (
                upper[first] - values[first]
                if step[first] > 0.0
                else lower[first] - values[first]
            )
            fixed[first] = True
            continue
        # Parameters whose gradient points inwards are released, one at a time.
        pull = 0.0
        for i in range(n):
            if fixed[i] and lower[i] < upper[i] and hessian[i, i] > 0.0:
                slope = gradient[i] + damping * hessian[i, i] * step[i]
                for j in range(n):
                    slope += hessian[i, j] * step[j]
                inward = -slope if values[i] + step[i] <= lower[i] else slope
                inward /= np.sqrt(hessian[i, i])
                if inward > max(pull, 1e-9 * abs(gradient[i]) / np.sqrt(hessian[i, i])):
                    first = i
                    pull = inward
        if first < 0:
            return step, True
        fixed[first] = False
    return step, False


@compiled(inside=True)
def _solve_free(
    hessian: FloatArray,
    gradient: FloatArray,
    step: FloatArray,
    fixed: NDArray[np.bool_],
    damping: float,
) -> None:
    """Write the steps of the parameters that are not fixed, given those of the others.

    By Cholesky's factors, in units in which the diagonal is one.
    """
    free = np.empty(step.size, dtype=np.int64)
    m = 0
    for p in range(step.size):
        if not fixed[p]:
            free[m] = p
            m += 1
    factor = np.zeros((m, m))
    right = np.zeros(m)
    for i in range(m):
        p = free[i]
        size = np.sqrt(hessian[p, p])
        right[i] = -gradient[p]
        for q in range(step.size):
            if fixed[q]:
                right[i] -= hessian[p, q] * step[q]
        right[i] /= size
        for j in range(i + 1):
            q = free[j]
            value = (
                1.0 + damping
                if i == j
                else hessian[p, q] / size / np.sqrt(hessian[q, q])
            )
            for k in range(j):
                value -= factor[i, k] * factor[j, k]
            factor[i, j] = (
                np.sqrt(max(value, 1e-15)) if i == j else value / factor[j, j]
            )
    for i in range(m):
        for k in range(i):
            right[i] -= factor[i, k] * right[k]
        right[i] /= factor[i, i]
    for i in range(m - 1, -1, -1):
        for k in range(i + 1, m):
            right[i] -= factor[k, i] * right[k]
        right[i] /= factor[i, i]
        step[free[i]] = right[i] / np.sqrt(hessian[free[i], free[i]])
