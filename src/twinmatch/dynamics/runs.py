"""Compiled runs of every plant: over a record, with exact tangents, and in a least-squares search."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.dynamics.descent import Search, update_search
from twinmatch.dynamics.kernels import (
    MAX_STEPS,
    N_INPUTS,
    N_OUTPUTS,
    N_UNKNOWN,
    OUTPUT_SLOPES,
    OUTPUTS,
    Code,
    begin,
    call,
    copy_into,
    step_count,
    tick,
    tick_with_tangents,
    work_for,
)
from twinmatch.dynamics.laws import (
    BACK,
    DERIVATIVE,
    GIVEN,
    HIGH,
    INTEGRAL,
    KIND,
    LOW,
    PERIOD,
    PID,
    PROPORTIONAL,
    LawCode,
    gain_slopes,
    law_slopes,
    law_step,
    law_tangents,
    pid_step,
)
from twinmatch.dynamics.sensor import reading
from twinmatch.signals import FloatArray


class RunData(NamedTuple):
    """What a run with derivatives is given, and compared with; the same for all values of the unknowns."""

    which: NDArray[np.int64]
    """Indices of the unknown parameters among those with tangents, shape (m,)."""
    tuned: NDArray[np.int64]
    """Places of the unknown gains in the law."""
    memory: FloatArray
    """The controller's state at the start."""
    references: FloatArray
    """Shape (N, r)."""
    disturbances: FloatArray
    """Shape (N, number of disturbances)."""
    measured: FloatArray
    """Outputs and inputs, shape (o + inputs, N)."""
    weights: FloatArray
    """Weights of their residuals, of the same shape."""
    robust: bool
    """Whether large residuals count linearly."""
    period: float


class Start(NamedTuple):
    """Where a run with derivatives starts: the values of the unknowns, and what follows from them."""

    vector: FloatArray
    """Parameters."""
    law: LawCode
    x: FloatArray
    """States, shape (nx,)."""
    columns: FloatArray
    """Their derivatives by the n unknowns, shape (nx, n): parameters, gains, and others (initial states) that
    act only through x."""
    steps: int
    """Runge–Kutta steps per sample."""


class LeastSquares(NamedTuple):
    """A window's least-squares problem for compiled code: all but the values of the unknowns."""

    data: RunData
    base: FloatArray
    """Values of all parameters, shape (n,); those of the unknown ones are ignored."""
    places: NDArray[np.int64]
    """Indices of the unknown parameters among all of them."""
    started: NDArray[np.int64]
    """Indices of the states with unknown initial value."""
    first: FloatArray
    """Outputs measured at the start, shape (o,)."""
    inputs_before: FloatArray
    """Inputs until the start, shape (inputs,)."""
    law: LawCode
    """The controller; if the inputs are given, they are the references, and are not compared."""
    default_disturbances: FloatArray
    """Defaults of the disturbances."""
    corners: FloatArray
    """States at which the fastest rate is searched, shape (k, number of states); inputs `drives` likewise."""
    drives: FloatArray
    rate_limit: float
    """Longest Runge–Kutta step in units of the fastest time constant."""
    expected: FloatArray
    """Prior values of the unknowns (parameters, gains, states at the start)."""
    pull: FloatArray
    """Weight of their squared distance from it in the cost; zero without prior."""


class Tangents(NamedTuple):
    """A run of N samples and its derivatives."""

    outputs: FloatArray
    """y, shape (N, o)."""
    inputs: FloatArray
    """u, shape (N, m)."""
    by: FloatArray
    """Derivatives of outputs and inputs by the unknowns, shape (o + m, N, n)."""
    by_state: FloatArray
    """Derivatives of the states one period later by the states, shape (N, nx, nx)."""
    by_input: FloatArray
    """Derivatives of the states one period later by u, shape (N, nx, m)."""
    around: FloatArray
    """Derivatives of the controller's commands, and of its state after them, by its state and the readings,
    shape (N, m + q, q + o)."""
    seen: FloatArray
    """Derivatives of the outputs by the states, shape (N, o, nx)."""


@compiled(innermost=True)
def add_row(
    normal: FloatArray, rows: FloatArray, s: int, weight: float, robust: bool
) -> None:
    """Add one residual, the last entry of row s, and its derivatives to the lower half of the equations."""
    if weight == 0.0:
        return
    n = rows.shape[1] - 1
    square = weight * weight
    square_sum = square * rows[s, n] * rows[s, n]
    lost = square_sum
    if robust:
        root = np.sqrt(1.0 + square_sum)
        square = square / root
        lost = 2.0 * (root - 1.0)
    for i in range(n):
        scaled = square * rows[s, i]
        for j in range(i + 1):
            normal[i, j] += scaled * rows[s, j]
    scaled = square * rows[s, n]
    for j in range(n):
        normal[n, j] += scaled * rows[s, j]
    normal[n, n] += lost


@compiled
def run(  # noqa: PLR0917
    code: Code,
    vector: FloatArray,
    x: FloatArray,
    law: LawCode,
    memory: FloatArray,
    references: FloatArray,
    disturbances: FloatArray,
    noise: FloatArray,
    frozen: Any,
    resolution: float,
    period: float,
    steps: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Outputs, shape (N, o), inputs, shape (N, inputs), and states before each tick, shape (N + 1, nx).

    `references`, shape (N, r), are those of the law, `memory` its state; `noise`, shape (N, o), is added to
    the readings.
    """
    size = disturbances.shape[0]
    outputs = noise.shape[1]
    y = np.empty((size, outputs))
    u = np.empty((size, code[N_INPUTS]))
    states = np.empty((size + 1, x.size))
    work = work_for(code, vector)
    states_now = x.copy()
    z = memory.copy()
    after = memory.copy()
    last = np.zeros(outputs)
    inputs_now = np.zeros(code[N_INPUTS])
    kind = law[KIND]
    d = np.empty(disturbances.shape[1])
    for k in range(size):
        for i in range(d.size):  # no view of a row: each is counted
            d[i] = disturbances[k, i]
        for i in range(x.size):
            states[k, i] = states_now[i]
        if kind == GIVEN:
            for i in range(inputs_now.size):
                inputs_now[i] = references[k, i]
        call(code[OUTPUTS], states_now, inputs_now, d, work.p, work.b, work.outputs)
        for o in range(outputs):
            last[o] = reading(
                work.outputs[o], noise[k, o], frozen[k] and k > 0, resolution, last[o]
            )
            y[k, o] = last[o]
        if kind == PID:
            inputs_now[0], z[0], z[1] = pid_step(
                law, references[k, 0], last[0], z[0], z[1]
            )
        elif kind != GIVEN:
            law_step(law, z, references, k, last, inputs_now, after)
            copy_into(after, z)
        for i in range(inputs_now.size):
            u[k, i] = inputs_now[i]
        tick(code, states_now, inputs_now, d, work, period, steps)
    for i in range(x.size):
        states[size, i] = states_now[i]
    return y, u, states


@compiled(innermost=True)
def _output_tangents(  # noqa: PLR0917
    shown: FloatArray,
    which: NDArray[np.int64],
    columns: FloatArray,
    dy: FloatArray,
    n: int,
    unknown: int,
) -> None:
    """Derivatives of the outputs by n unknowns, from those of the states and, in `shown`, of the outputs."""
    outputs = dy.shape[0]
    nx = columns.shape[0]
    for o in range(outputs):
        for j in range(n):
            slope = (
                shown[outputs * nx + o * unknown + which[j]] if j < which.size else 0.0
            )
            for i in range(nx):
                slope += shown[o * nx + i] * columns[i, j]
            dy[o, j] = slope


@compiled(innermost=True)
def _pid_tangents(  # noqa: PLR0917
    law: LawCode, u: float, dy: FloatArray, dz: FloatArray, du: FloatArray, n: int
) -> None:
    """Derivatives of the PID's command u and of its next state, in place."""
    by_change = law[DERIVATIVE] / law[PERIOD]
    by_reading = law[PROPORTIONAL] + by_change
    free = 1.0 if law[LOW] < u < law[HIGH] else 0.0
    for j in range(n):
        unlimited = dz[0, j] - by_reading * dy[0, j] - by_change * dz[1, j]
        du[0, j] = free * unlimited
        dz[0, j] += law[PERIOD] * (
            law[BACK] * (du[0, j] - unlimited) - law[INTEGRAL] * dy[0, j]
        )
        dz[1, j] = -dy[0, j]


@compiled(innermost=True)
def _store(  # noqa: PLR0917
    stored: Tangents,
    k: int,
    y: FloatArray,
    u: FloatArray,
    dy: FloatArray,
    du: FloatArray,
    slopes: FloatArray,
    shown: FloatArray,
    columns: FloatArray,
    n: int,
) -> None:
    """Store what is known of sample k before its tick, whose derivatives by states and inputs begin."""
    outputs = y.size
    inputs = u.size
    nx = columns.shape[0]
    for i in range(slopes.shape[0]):
        for j in range(slopes.shape[1]):
            stored.around[k, i, j] = slopes[i, j]
    for o in range(outputs):
        stored.outputs[k, o] = y[o]
        for j in range(n):
            stored.by[o, k, j] = dy[o, j]
        for i in range(nx):
            stored.seen[k, o, i] = shown[o * nx + i]
    for i in range(inputs):
        stored.inputs[k, i] = u[i]
        for j in range(n):
            stored.by[outputs + i, k, j] = du[i, j]
        du[i, n + nx + i] = 1.0
    for i in range(nx):
        for j in range(nx + inputs):
            columns[i, n + j] = 1.0 if i == j else 0.0


@compiled
def run_with_tangents(  # noqa: PLR0912, PLR0915
    code: Code, start: Start, data: RunData, stored: bool, limit: float
) -> tuple[Tangents, FloatArray]:
    """The run with its derivatives; either its arrays are stored, or the normal equations are summed.

    Returns the arrays and [J r]ᵀ[J r] of the weighed residuals r = weights·(simulated − measured), shape
    (n + 1, n + 1); its last entry is the sum of r², or of 2(√(1 + r²) − 1) if robust, with rows weighted by
    1/√(1 + r²). A run ends when its sum exceeds `limit`.
    """
    # One function for its length: states, loop and sums of a sample share arrays, and a call between them
    # would be compiled into each of its callers again.
    vector, law, x, columns, steps = start
    (
        unknown_places,
        tuned,
        memory,
        references,
        disturbances,
        measured,
        weights,
        robust,
        period,
    ) = data
    size = disturbances.shape[0]
    nx, n = columns.shape
    q = memory.size
    inputs = code[N_INPUTS]
    outputs = code[N_OUTPUTS]
    unknown = code[N_UNKNOWN]
    kind = law[KIND]
    compared = inputs if kind != GIVEN else 0
    kept_samples = size if stored else 0
    width = n + (nx + inputs if stored else 0)
    tangents = Tangents(
        np.empty((kept_samples, outputs)),
        np.empty((kept_samples, inputs)),
        np.zeros((outputs + inputs, kept_samples, n)),
        np.empty((kept_samples, nx, nx)),
        np.empty((kept_samples, nx, inputs)),
        np.empty((kept_samples, inputs + q, q + outputs)),
        np.empty((kept_samples, outputs, nx)),
    )
    by_state = tangents.by_state
    by_input = tangents.by_input
    normal = np.zeros((n + 1, n + 1))
    dy = np.zeros((outputs, n + 1))
    of_inputs = np.zeros((compared, n + 1))
    dz = np.zeros((q, n))
    moved = np.zeros((q, n))
    all_columns = np.zeros((nx, width))
    du = np.zeros((inputs, width))
    for i in range(nx):
        copy_into(columns[i], all_columns[i])
    slopes = np.zeros((inputs + q, q + outputs))
    of_gains = np.zeros((inputs + q, tuned.size))
    states_now = x.copy()
    u = np.zeros(inputs)
    z = memory.copy()
    after = memory.copy()
    work = work_for(code, vector)
    d = np.empty(disturbances.shape[1])
    shown = work.output_slopes
    y = work.outputs
    for k in range(size):
        for i in range(d.size):
            d[i] = disturbances[k, i]
        if kind == GIVEN:
            for i in range(inputs):
                u[i] = references[k, i]
        call(code[OUTPUTS], states_now, u, d, work.p, work.b, y)
        call(code[OUTPUT_SLOPES], states_now, u, d, work.p, work.b, shown)
        _output_tangents(shown, unknown_places, all_columns, dy, n, unknown)
        if kind == PID and not tuned.size:
            u[0], after[0], after[1] = pid_step(law, references[k, 0], y[0], z[0], z[1])
            if stored:
                law_slopes(law, z, references, k, y, u, slopes)
            z[0] = after[0]
            z[1] = after[1]
            _pid_tangents(law, u[0], dy, dz, du, n)
        elif kind != GIVEN:
            law_step(law, z, references, k, y, u, after)
            law_slopes(law, z, references, k, y, u, slopes)
            law_tangents(slopes, dy, dz, du, moved, n)
            if tuned.size:
                gain_slopes(law, z, references, k, y, u, tuned, of_gains)
                first = unknown_places.size
                last = unknown_places.size + tuned.size
                for i in range(inputs + q):
                    for j in range(first, last):
                        if i < inputs:
                            du[i, j] += of_gains[i, j - first]
                        else:
                            dz[i - inputs, j] += of_gains[i, j - first]
            copy_into(after, z)
        if stored:
            _store(tangents, k, y, u, dy, du, slopes, shown, all_columns, n)
        else:
            for o in range(outputs):
                dy[o, n] = y[o] - measured[o, k]
                add_row(normal, dy, o, weights[o, k], robust)
            for i in range(compared):
                for j in range(n):
                    of_inputs[i, j] = du[i, j]
                of_inputs[i, n] = u[i] - measured[outputs + i, k]
                add_row(normal, of_inputs, i, weights[outputs + i, k], robust)
            if normal[n, n] > limit:
                break
        tick_with_tangents(
            code, states_now, u, d, work, period, steps, unknown_places, all_columns, du
        )
        if stored:
            for i in range(nx):
                for j in range(nx):
                    by_state[k, i, j] = all_columns[i, n + j]
                for j in range(inputs):
                    by_input[k, i, j] = all_columns[i, n + nx + j]
    for i in range(n + 1):
        for j in range(i):
            normal[j, i] = normal[i, j]
    return tangents, normal


@compiled
def start_at(code: Code, problem: LeastSquares, values: FloatArray) -> Start:
    """The start of a run with these values of the unknowns."""
    data = problem.data
    n = data.which.size
    tuned = data.tuned.size
    p = problem.base.copy()
    law = problem.law.copy()
    for j in range(n):
        p[problem.places[j]] = values[j]
    for j in range(tuned):
        law[data.tuned[j]] = values[n + j]
    disturbances = data.disturbances[0]
    x, _, by_parameters = begin(
        code, p, problem.first, problem.inputs_before, disturbances
    )
    columns = np.zeros((x.size, values.size))
    for i in range(x.size):
        for j in range(n):
            columns[i, j] = by_parameters[i, data.which[j]]
    for k in range(problem.started.size):
        i = problem.started[k]
        x[i] = values[n + tuned + k]
        columns[i, :n] = 0.0
        columns[i, n + tuned + k] = 1.0
    steps = step_count(
        code,
        p,
        problem.corners,
        problem.drives,
        problem.default_disturbances,
        data.period,
        problem.rate_limit,
    )
    return Start(p, law, x, columns, steps)


@compiled(inside=True)
def normal_at(
    code: Code, problem: LeastSquares, values: FloatArray, limit: float
) -> tuple[float, FloatArray, FloatArray]:
    """Sum, gradient Jᵀr and JᵀJ of the weighed residuals, as far as the sum does not come above `limit`; it
    is infinite where the plant is too fast. What is known beforehand counts like so many residuals more."""
    n = values.size
    start = start_at(code, problem, values)
    if start.steps > MAX_STEPS:
        return np.inf, np.zeros(n), np.zeros((n, n))
    _, normal = run_with_tangents(code, start, problem.data, False, limit)
    cost = normal[n, n]
    gradient = normal[n, :n].copy()
    hessian = normal[:n, :n].copy()
    for j in range(n):
        if problem.pull[j] > 0.0:
            deviation = values[j] - problem.expected[j]
            cost += problem.pull[j] * deviation * deviation
            gradient[j] += problem.pull[j] * deviation
            hessian[j, j] += problem.pull[j]
    return cost, gradient, hessian


@compiled
def search(code: Code, problem: LeastSquares, state: Search) -> None:
    """Run a search to its end. A run whose cost exceeds the best one's stops early, the first one by what
    stands there before it."""
    is_asking = True
    while is_asking:
        cost, gradient, hessian = normal_at(code, problem, state.point, state.best[0])
        is_asking = update_search(state, cost, gradient, hessian)
