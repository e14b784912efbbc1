"""The compiled arithmetic of a sample, for every plant: steps, exact tangents, starts, slopes.

A kernel is compiled once for all plants. It gets a plant as `code`: the addresses of the functions made from
its equations (`machine.py`), and their sizes.

A sample takes `steps` Runge–Kutta steps of order 4, none of which crosses a kink: if a condition changes sign
within a step, the moment is found by bisection and the step ends just after it. Tangents pass through the
same stages. They need no correction at a kink: the rates are continuous there, so its moment has no
first-order effect.
"""


# mypy: disable-error-code="untyped-decorator"

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.signals import FloatArray

RATE_LIMIT = 0.06
"""Runge–Kutta step in units of the fastest time constant: its error is below 1e-7 of the step."""
MAX_STEPS = 2000
MAX_EVENTS = 24
"""Kinks located within one step; further ones are stepped over."""
BISECTIONS = 48
MAX_SWITCHES = 6
"""Kinks whose combinations are all checked for the fastest rate."""

Code = NDArray[np.int64]
"""A plant for the kernels: the addresses of its functions, in the order of `machine.FUNCTIONS`, and SIZES."""
(
    CONSTANTS,
    SWITCHES,
    STEP,
    TANGENTS,
    SLOPES,
    OUTPUTS,
    OUTPUT_SLOPES,
    START,
    QUANTITIES,
) = range(9)
(
    N,
    N_INPUTS,
    N_OUTPUTS,
    N_PARAMETERS,
    N_UNKNOWN,
    N_QUANTITIES,
    N_CONSTANTS,
    N_SWITCHES,
) = range(9, 17)
SIZES = (
    "n_states", "n_inputs", "n_outputs", "n_parameters", "n_unknown", "n_quantities", "n_constants",
    "n_switches",
)  # fmt: skip
"""Names of the numbers after the addresses."""


class Work(NamedTuple):
    """Arrays that a kernel works with at one plant."""

    p: FloatArray
    """Parameters, and after them the constants that are computed from them."""
    b: FloatArray
    """Switches, 1 or 0."""
    after: FloatArray
    """States after a step, and whether it crosses a kink."""
    outputs: FloatArray
    """Outputs."""
    output_slopes: FloatArray
    """Derivatives of the outputs by the states, then by the unknowns, then by the inputs, row by row."""


@intrinsic
def call(  # noqa: PLR0917
    context: Any,  # noqa: ARG001
    address: Any,
    x: Any,
    u: Any,
    d: Any,
    p: Any,
    b: Any,
    out: Any,
) -> Any:
    """Call a plant's function."""
    return types.void(address, x, u, d, p, b, out), _by_address


@intrinsic
def _call_step(  # noqa: PLR0917
    context: Any,  # noqa: ARG001
    address: Any,
    x: Any,
    u: Any,
    d: Any,
    p: Any,
    b: Any,
    out: Any,
    h: Any,
) -> Any:
    return types.void(address, x, u, d, p, b, out, h), _by_address


@intrinsic
def _call_tangents(  # noqa: PLR0917
    context: Any,  # noqa: ARG001
    address: Any,
    x: Any,
    u: Any,
    d: Any,
    p: Any,
    b: Any,
    out: Any,
    h: Any,
    columns: Any,
    du: Any,
    which: Any,
    first: Any,
    size: Any,
) -> Any:
    arguments = (address, x, u, d, p, b, out, h, columns, du, which, first, size)
    return types.void(*arguments), _by_address


def _by_address(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Arrays are passed as pointers to their first value."""
    pointers = [
        context.make_array(kind)(context, builder, value).data
        if isinstance(kind, types.Array)
        else value
        for kind, value in zip(signature.args[1:], arguments[1:], strict=True)
    ]
    function = ir.FunctionType(ir.VoidType(), [value.type for value in pointers])
    builder.call(builder.inttoptr(arguments[0], function.as_pointer()), pointers)
    return context.get_dummy_value()


@compiled(inside=True)
def copy_into(source: FloatArray, target: FloatArray) -> None:
    """Copy the source over the first values of the target.

    An assignment to a slice would compile the words of an error, too: a second.
    """
    for t in range(source.size):
        target[t] = source[t]


@compiled(inside=True)
def prepare(code: Code, vector: FloatArray, work: Work) -> None:
    """Change the parameters."""
    for i in range(code[N_PARAMETERS]):
        work.p[i] = vector[i]
    constants = work.p[code[N_PARAMETERS] :]
    call(code[CONSTANTS], vector, vector, vector, work.p, work.b, constants)


@compiled(inside=True)
def work_for(code: Code, vector: FloatArray) -> Work:
    """The arrays for a plant with these parameters."""
    p = np.empty(code[N_PARAMETERS] + code[N_CONSTANTS])
    b = np.zeros(code[N_SWITCHES])
    after = np.zeros(code[N] + 1)
    outputs = np.zeros(code[N_OUTPUTS])
    output_slopes = np.zeros(
        code[N_OUTPUTS] * (code[N] + code[N_UNKNOWN] + code[N_INPUTS])
    )
    work = Work(p, b, after, outputs, output_slopes)
    prepare(code, vector, work)
    return work


@compiled(inside=True)
def _reach(  # noqa: PLR0917
    code: Code, x: FloatArray, u: FloatArray, d: FloatArray, work: Work, h: float
) -> float:
    """Length of the step that ends just beyond the first kink within a step of h."""
    low = 0.0
    high = h
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        _call_step(code[STEP], x, u, d, work.p, work.b, work.after, middle)
        if work.after[x.size] != 0.0:
            high = middle
        else:
            low = middle
    return high


@compiled(inside=True)
def tick(  # noqa: PLR0917
    code: Code,
    x: FloatArray,
    u: FloatArray,
    d: FloatArray,
    work: Work,
    period: float,
    steps: int,
) -> None:
    """Move the states one period on, in place."""
    after = work.after
    for _ in range(steps):
        remaining = period / steps
        for event in range(MAX_EVENTS):
            step_length = remaining
            _call_step(code[STEP], x, u, d, work.p, work.b, after, remaining)
            if after[x.size] != 0.0 and event < MAX_EVENTS - 1:
                step_length = _reach(code, x, u, d, work, remaining)
                _call_step(code[STEP], x, u, d, work.p, work.b, after, step_length)
            for i in range(x.size):
                x[i] = after[i]
            remaining -= step_length
            if not remaining > 0.0:
                break


@compiled(inside=True)
def tick_with_tangents(  # noqa: PLR0917
    code: Code,
    x: FloatArray,
    u: FloatArray,
    d: FloatArray,
    work: Work,
    period: float,
    steps: int,
    which: NDArray[np.int64],
    columns: FloatArray,
    du: FloatArray,
) -> None:
    """Move the states one period on, in the same steps as `tick`, and their derivatives with them, in place.

    `columns`, shape (n, k), are the derivatives by the parameters `which`, indices of those with tangents,
    and then by others; `du`, shape (m, k), are those of the inputs.
    """
    after = work.after
    for _ in range(steps):
        remaining = period / steps
        for event in range(MAX_EVENTS):
            h = remaining
            after[x.size] = 1.0 if code[N_SWITCHES] and event < MAX_EVENTS - 1 else 0.0
            for _ in range(2):  # again, if the step would cross a kink
                _call_tangents(
                    code[TANGENTS],
                    x,
                    u,
                    d,
                    work.p,
                    work.b,
                    after,
                    h,
                    columns,
                    du,
                    which,
                    which.size,
                    columns.shape[1],
                )
                if after[x.size] == 0.0:
                    break
                h = _reach(code, x, u, d, work, remaining)
                after[x.size] = 0.0
            for i in range(x.size):
                x[i] = after[i]
            remaining -= h
            if not remaining > 0.0:
                break


@compiled(inside=True)
def scalar(u: float) -> FloatArray:
    """The one value of a signal, as an array."""
    values = np.empty(1)
    values[0] = u
    return values


@compiled
def advance(  # noqa: PLR0917
    code: Code,
    vector: FloatArray,
    x: FloatArray,
    u: FloatArray,
    d: FloatArray,
    period: float,
    steps: int,
) -> FloatArray:
    """The states one period later under constant inputs, shape (m,), and disturbances, shape (n,)."""
    after = x.copy()
    tick(code, after, u, d, work_for(code, vector), period, steps)
    return after


@compiled
def advance_side_by_side(  # noqa: PLR0917
    code: Code,
    vectors: FloatArray,
    states: FloatArray,
    u: FloatArray,
    d: FloatArray,
    period: float,
    steps: int,
) -> tuple[FloatArray, FloatArray]:
    """The states of several plants of one model one period later, shape (k, n), and their outputs then,
    shape (k, o); `vectors` has a row of parameters for each."""
    after = states.copy()
    outputs = np.empty((states.shape[0], code[N_OUTPUTS]))
    for plant in range(states.shape[0]):
        work = work_for(code, vectors[plant])
        x = after[plant]
        tick(code, x, u, d, work, period, steps)
        call(code[OUTPUTS], x, u, d, work.p, work.b, work.outputs)
        for k in range(work.outputs.size):
            outputs[plant, k] = work.outputs[k]
    return after, outputs


@compiled
def begin(
    code: Code, vector: FloatArray, y: FloatArray, u: FloatArray, d: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Initial states, shape (n,), at readings y after inputs u, and their derivatives by y, shape (n, o), and
    the unknowns, (n, q)."""
    n = code[N]
    o = code[N_OUTPUTS]
    q = code[N_UNKNOWN]
    work = work_for(code, vector)
    start = np.empty(n * (1 + o + q))
    call(code[START], y, u, d, work.p, work.b, start)
    by_y = start[n : n * (1 + o)].copy()
    by_unknown = start[n * (1 + o) :].copy()
    return start[:n].copy(), by_y.reshape((n, o)), by_unknown.reshape((n, q))


@compiled
def outputs_at(
    code: Code, vector: FloatArray, x: FloatArray, u: FloatArray, d: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The outputs, shape (o,), and the plant's other quantities."""
    work = work_for(code, vector)
    quantities = np.zeros(code[N_QUANTITIES])
    call(code[SWITCHES], x, u, d, work.p, work.b, work.b)
    call(code[QUANTITIES], x, u, d, work.p, work.b, quantities)
    call(code[OUTPUTS], x, u, d, work.p, work.b, work.outputs)
    return work.outputs, quantities


@compiled
def parts(  # noqa: PLR0917
    code: Code,
    vector: FloatArray,
    y: float,
    before: FloatArray,
    u: float,
    rest: float,
    d: FloatArray,
    period: float,
    steps: int,
) -> tuple[float, float, FloatArray]:
    """Movement of a measured output in one period due to the drive and to all else, and the states after it.

    States that the output does not show start from `before`, unless that is NaN. Those whose initial value
    depends on the output, such as a heater that starts at the temperature of what it heats, are shifted by
    the output's error: their distance from the output is kept, so that errors of the plant do not accumulate.
    """
    n = code[N]
    work = work_for(code, vector)
    of_u = scalar(u)
    of_rest = scalar(rest)
    started = np.empty(code[N] * (2 + code[N_UNKNOWN]))
    call(code[START], scalar(y), of_u, d, work.p, work.b, started)
    call(code[OUTPUT_SLOPES], started, of_u, d, work.p, work.b, work.output_slopes)
    if not np.isnan(before[0]):
        call(code[OUTPUTS], before, of_u, d, work.p, work.b, work.outputs)
        deviation = y - work.outputs[0]
        for i in range(n):
            if work.output_slopes[i] == 0.0:
                started[i] = before[i] + (
                    started[n + i] * deviation if started[n + i] != 0.0 else 0.0
                )
    call(code[OUTPUTS], started, of_u, d, work.p, work.b, work.outputs)
    begun = work.outputs[0]
    after = started[:n].copy()
    idle = started[:n].copy()
    tick(code, after, of_u, d, work, period, steps)
    tick(code, idle, of_rest, d, work, period, steps)
    # what acts at once is not a movement
    call(code[OUTPUTS], idle, of_u, d, work.p, work.b, work.outputs)
    passive = work.outputs[0]
    call(code[OUTPUTS], after, of_u, d, work.p, work.b, work.outputs)
    return work.outputs[0] - passive, passive - begun, after


@compiled
def slopes_at(
    code: Code, vector: FloatArray, x: FloatArray, u: FloatArray, d: FloatArray
) -> tuple[
    FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray
]:
    """Rates, their derivatives by states, shape (n, n), inputs, (n, m), and parameters, (n, q); and those of
    the outputs by states, shape (o, n), parameters, (o, q), and inputs, (o, m)."""
    n = code[N]
    q = code[N_UNKNOWN]
    m = code[N_INPUTS]
    o = code[N_OUTPUTS]
    work = work_for(code, vector)
    slopes = np.empty(n * (q + 1 + n + m))
    call(code[SWITCHES], x, u, d, work.p, work.b, work.b)
    call(code[SLOPES], x, u, d, work.p, work.b, slopes)
    call(code[OUTPUT_SLOPES], x, u, d, work.p, work.b, work.output_slopes)
    rates = slopes[n * q : n * q + n].copy()
    of_rates = slopes[n * q + n :]
    fx = of_rates[: n * n].copy().reshape((n, n))
    fu = of_rates[n * n :].copy().reshape((n, m))
    fb = slopes[: n * q].copy().reshape((n, q))
    of_outputs = work.output_slopes
    hx = of_outputs[: o * n].copy().reshape((o, n))
    hb = of_outputs[o * n : o * (n + q)].copy().reshape((o, q))
    hu = of_outputs[o * (n + q) :].copy().reshape((o, m))
    return rates, fx, fu, fb, hx, hb, hu


@compiled
def spectral_bound(matrix: FloatArray) -> float:
    """A bound on the eigenvalues' moduli, in whatever units the states are; balances `matrix`, shape (n, n).

    It is the least of three norms (rows, columns, Frobenius) after the states have been scaled until rows and
    columns are of like size (Osborne 1960). What a cascade passes on does not count: it moves no eigenvalue.
    """
    n = matrix.shape[0]
    for _ in range(n + 1):
        for i in range(n):
            row = column = 0.0
            for m in range(n):
                if m != i:
                    row += abs(matrix[i, m])
                    column += abs(matrix[m, i])
            ratio = np.sqrt(row / column) if row > 0.0 and column > 0.0 else 0.0
            for m in range(n):
                if m != i:
                    matrix[i, m] = matrix[i, m] / ratio if ratio > 0.0 else 0.0
                    matrix[m, i] *= ratio
    rows = columns = squares = 0.0
    for i in range(n):
        row = column = square = 0.0
        for m in range(n):
            row += abs(matrix[i, m])
            column += abs(matrix[m, i])
            square += matrix[i, m] * matrix[i, m]
        rows = max(rows, row)
        columns = max(columns, column)
        squares += square
    return float(min(rows, columns, np.sqrt(squares)))


@compiled
def step_count(  # noqa: PLR0917
    code: Code,
    vector: FloatArray,
    corners: FloatArray,
    drives: FloatArray,
    d: FloatArray,
    period: float,
    limit: float,
) -> int:
    """Runge–Kutta steps per sample, none longer than `limit` times the fastest time constant; more than
    MAX_STEPS where the plant is too fast.

    The fastest rate decides: the largest over the states `corners`, shape (k, n), the inputs `drives`, shape
    (k, m), and all branches of the kinks, of a bound on the eigenvalues of df/dx.
    """
    n = code[N]
    q = code[N_UNKNOWN]
    switched = code[N_SWITCHES]
    fastest = 0.0
    work = work_for(code, vector)
    slopes = np.empty(n * (q + 1 + n + code[N_INPUTS]))
    fx = slopes[n * q + n : n * q + n + n * n].reshape(n, n)
    for k in range(corners.shape[0]):
        x = corners[k]
        for drive_row in range(drives.shape[0]):
            u = drives[drive_row]
            for branch in range(2 ** min(switched, MAX_SWITCHES)):
                for i in range(switched):
                    work.b[i] = float(branch >> i & 1)
                call(code[SLOPES], x, u, d, work.p, work.b, slopes)
                fastest = max(fastest, spectral_bound(fx))
    count = np.ceil(period * fastest / limit)
    return int(max(count, 1.0)) if count <= MAX_STEPS else MAX_STEPS + 1
