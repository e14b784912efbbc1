"""Compiled runs of every plant: over a record, with exact tangents, and in a least-squares search."""

# ruff: noqa: PLR0912, PLR0917 (kernels are long and take arrays in a row)

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.dynamics.descent import Search, update_search
from twinmatch.dynamics.kernels import (
    MOST_STEPS,
    OUTPUT_SLOPES,
    OUTPUTS,
    Code,
    begin,
    call,
    step_count,
    tick,
    tick_with_tangents,
    work_for,
)
from twinmatch.dynamics.loop import Gains, loop_step, pid_step, reading
from twinmatch.signals import FloatArray


class LeastSquares(NamedTuple):
    """A window's least-squares problem for compiled code: all but the values of the unknowns."""

    base: FloatArray
    """Values of all parameters, shape (n,); those of the unknown ones are ignored."""
    which: NDArray[np.int64]
    """Indices of the unknown parameters among those with tangents, shape (m,)."""
    places: NDArray[np.int64]
    """Their indices among all parameters."""
    started: NDArray[np.int64]
    """Indices of the states with unknown initial value."""
    first: float
    """Output measured at the start."""
    input_before: float
    """Input until the start."""
    closed: bool
    gains: Gains
    reference: FloatArray
    measured: FloatArray
    """Output and input, shape (2, N)."""
    weights: FloatArray
    """Weights of their residuals, shape (2, N)."""
    robust: bool
    disturbances: FloatArray
    """Shape (N, number of disturbances)."""
    default_disturbances: FloatArray
    """Defaults of the disturbances."""
    corners: FloatArray
    """States at which the fastest rate is searched, shape (k, number of states); `drives` likewise."""
    drives: FloatArray
    integral: float
    previous: float
    """The controller's state, with `integral`."""
    period: float
    rate_limit: float
    """Longest Runge–Kutta step in units of the fastest time constant."""
    expected: FloatArray
    """Prior values of the unknowns, shape (m + starts,)."""
    pull: FloatArray
    """Weight of their squared distance from it in the cost; zero without prior."""


@compiled(innermost=True)
def add_row(normal: FloatArray, of: FloatArray, weight: float, robust: bool) -> None:
    """Add one residual, the last entry of `of`, and its derivatives to the lower half of the equations."""
    if weight == 0.0:
        return
    n = of.size - 1
    square = weight * weight
    left = square * of[n] * of[n]
    lost = left
    if robust:
        root = np.sqrt(1.0 + left)
        square, lost = square / root, 2.0 * (root - 1.0)
    for i in range(n):
        scaled = square * of[i]
        for j in range(i + 1):
            normal[i, j] += scaled * of[j]
    scaled = square * of[n]
    for j in range(n):
        normal[n, j] += scaled * of[j]
    normal[n, n] += lost


@compiled
def run(
    code: Code, vector: FloatArray, x: FloatArray, closed: bool, gains: Gains, reference: FloatArray,
    given: FloatArray, disturbances: FloatArray, noise: FloatArray, frozen: Any, resolution: float,
    integral: float, previous_error: float, period: float, steps: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Output, input, both shape (N,), and states before each tick, shape (N + 1, nx).

    The loop over the reference if `closed`, else the plant under the inputs given.
    """
    size = disturbances.shape[0]
    y, u, states = np.empty(size), np.empty(size), np.empty((size + 1, x.size))
    work, at, of_u = work_for(code, vector), x.copy(), np.zeros(1)
    last = 0.0
    for k in range(size):
        d = disturbances[k]
        for i in range(x.size):
            states[k, i] = at[i]
        call(code[OUTPUTS], at, of_u, d, work.p, work.b, work.seen)
        last = reading(work.seen[0], noise[k], frozen[k] and k > 0, resolution, last)
        y[k] = last
        if closed:
            u[k], integral, previous_error = pid_step(gains, integral, previous_error, reference[k], last)
        else:
            u[k] = given[k]
        of_u[0] = u[k]
        tick(code, at, of_u, d, work, period, steps)
    for i in range(x.size):
        states[size, i] = at[i]
    return y, u, states


@compiled
def run_with_tangents(
    code: Code, vector: FloatArray, which: Any, x: FloatArray, columns: FloatArray, closed: bool,
    gains: Gains, reference: FloatArray, given: FloatArray, disturbances: FloatArray, integral: float,
    previous_error: float, period: float, steps: int, measured: FloatArray, weights: FloatArray,
    robust: bool, stored: bool, limit: float,
) -> tuple[
    FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray
]:  # fmt: skip
    """The run with its derivatives; either its arrays are stored, or the normal equations are summed.

    `columns`, shape (nx, n), are the derivatives of x by the n unknowns: the parameters `which`,
    indices into UNKNOWN, then others (initial states) that act only through x. `measured` holds output and
    input, shape (2, N), and `weights` the weight of every sample of both, shape (2, N). Returns output,
    input, their derivatives (2, N, n), the derivatives of every tick by state (N, nx, nx) and
    drive (N, nx), whether the controller was free (N,), the derivatives of the output by state (N,
    nx), and [J r]ᵀ[J r] of the weighed residuals r = weights·(simulated − measured), shape (n + 1, n +
    1); its last entry is the sum of r², or of 2(√(1 + r²) − 1) if `robust`, with rows weighted by 1/√(1 +
    r²). A run ends when its sum exceeds `limit`.
    """
    size, n, nx = disturbances.shape[0], columns.shape[1], x.size
    kept = size if stored else 0
    extra = nx + 1 if stored else 0
    m = n + extra
    y_all, u_all, by = np.empty(kept), np.empty(kept), np.empty((2, kept, n))
    by_state, by_drive = np.empty((kept, nx, nx)), np.empty((kept, nx))
    free_all, seen = np.empty(kept), np.empty((kept, nx))
    normal, dy = np.zeros((n + 1, n + 1)), np.zeros(n + 1)
    all_columns, by_inputs, of_u = np.zeros((nx, m)), np.zeros((1, m)), np.zeros(n + 1)
    all_columns[:, :n] = columns
    du = by_inputs[0]
    d_integral, d_error = np.zeros(n), np.zeros(n)
    work, at, inputs = work_for(code, vector), x.copy(), np.zeros(1)
    hx, hp = work.shown[:nx], work.shown[nx:]
    for k in range(size):
        d = disturbances[k]
        call(code[OUTPUTS], at, inputs, d, work.p, work.b, work.seen)
        call(code[OUTPUT_SLOPES], at, inputs, d, work.p, work.b, work.shown)
        y = work.seen[0]
        for j in range(n):
            slope = hp[which[j]] if j < which.size else 0.0
            for i in range(nx):
                slope += hx[i] * all_columns[i, j]
            dy[j] = slope
        u, free = 0.0, 0.0
        if closed:
            u, integral, previous_error, free = loop_step(
                gains, integral, previous_error, reference[k], y, dy, d_integral, d_error, du, n
            )
        else:
            u = given[k]
        if stored:
            y_all[k], u_all[k], free_all[k] = y, u, free
            for j in range(n):
                by[0, k, j], by[1, k, j] = dy[j], du[j]
            for i in range(nx):
                seen[k, i] = hx[i]
                for q in range(extra):
                    all_columns[i, n + q] = 1.0 if i == q else 0.0
            du[m - 1] = 1.0
        else:
            dy[n] = y - measured[0, k]
            add_row(normal, dy, weights[0, k], robust)
            if closed:
                for j in range(n):
                    of_u[j] = du[j]
                of_u[n] = u - measured[1, k]
                add_row(normal, of_u, weights[1, k], robust)
            if normal[n, n] > limit:
                break
        inputs[0] = u
        tick_with_tangents(code, at, inputs, d, work, period, steps, which, all_columns, by_inputs)
        if stored:
            for i in range(nx):
                by_drive[k, i] = all_columns[i, m - 1]
                for q in range(nx):
                    by_state[k, i, q] = all_columns[i, n + q]
    for i in range(n + 1):
        for j in range(i):
            normal[j, i] = normal[i, j]
    return y_all, u_all, by, by_state, by_drive, free_all, seen, normal


@compiled
def start_at(
    code: Code, problem: LeastSquares, values: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, int]:
    """Parameters, states at the start, their derivatives by the unknowns, and steps per sample."""
    n = problem.which.size
    p = problem.base.copy()
    for j in range(n):
        p[problem.places[j]] = values[j]
    given = problem.disturbances[0]
    x, _, by_parameters = begin(code, p, problem.first, problem.input_before, given)
    columns = np.zeros((x.size, values.size))
    for i in range(x.size):
        for j in range(n):
            columns[i, j] = by_parameters[i, problem.which[j]]
    for k in range(problem.started.size):
        i = problem.started[k]
        x[i] = values[n + k]
        columns[i, :n] = 0.0
        columns[i, n + k] = 1.0
    return (
        p,
        x,
        columns,
        step_count(
            code,
            p,
            problem.corners,
            problem.drives,
            problem.default_disturbances,
            problem.period,
            problem.rate_limit,
        ),
    )


@compiled
def normal_at(
    code: Code, problem: LeastSquares, values: FloatArray, limit: float
) -> tuple[float, FloatArray, FloatArray]:
    """Sum, gradient Jᵀr and JᵀJ of the weighed residuals, as far as the sum does not come above `limit`; it
    is infinite where the plant is too fast. What is known beforehand counts like so many residuals more."""
    n = values.size
    p, x, columns, steps = start_at(code, problem, values)
    if steps > MOST_STEPS:
        return np.inf, np.zeros(n), np.zeros((n, n))
    normal = run_with_tangents(
        code, p, problem.which, x, columns, problem.closed, problem.gains, problem.reference,
        problem.measured[1], problem.disturbances, problem.integral, problem.previous, problem.period,
        steps, problem.measured, problem.weights, problem.robust, False, limit,
    )[7]  # fmt: skip
    cost, gradient, hessian = normal[n, n], normal[n, :n].copy(), normal[:n, :n].copy()
    for j in range(n):
        if problem.pull[j] > 0.0:
            off = values[j] - problem.expected[j]
            cost += problem.pull[j] * off * off
            gradient[j] += problem.pull[j] * off
            hessian[j, j] += problem.pull[j]
    return cost, gradient, hessian


@compiled
def search(code: Code, problem: LeastSquares, state: Search) -> None:
    """Run a search to its end."""
    cost, gradient, hessian = normal_at(code, problem, state.point, np.inf)
    while update_search(state, cost, gradient, hessian):
        # A run whose cost exceeds the best one's can stop early.
        cost, gradient, hessian = normal_at(code, problem, state.point, state.best[0])
