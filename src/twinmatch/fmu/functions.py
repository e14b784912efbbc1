"""An FMU as a plant's functions for the kernels of `twinmatch.dynamics`, which call them by address.

They take the arrays of the functions that are compiled from equations. Most FMUs provide no derivatives by
parameters, so every derivative is a central difference. Where a match needs only the derivatives of a whole
run, whole runs are compared: those of samples would add up the error of an FMU's solver.
"""


# mypy: disable-error-code="untyped-decorator, no-any-return"

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numba
import numpy as np
from llvmlite import binding, ir
from numba import types

from twinmatch.compiled import compiled
from twinmatch.dynamics.kernels import (
    MAX_STEPS,
    OUTPUT_SLOPES,
    OUTPUTS,
    SLOPES,
    STEP,
    TANGENTS,
    Code,
    begin,
    step_count,
)
from twinmatch.dynamics.kernels import SIZES as NUMBERS
from twinmatch.dynamics.laws import GIVEN as DRIVEN
from twinmatch.dynamics.laws import KIND
from twinmatch.dynamics.machine import FUNCTIONS, linked
from twinmatch.dynamics.runs import LeastSquares, add_row, run
from twinmatch.fmu.machine import Machine, advance, bring, machine_at, output, rates
from twinmatch.signals import FloatArray

WIDTH: Final = 1e-4
"""Half width of a central difference, relative to the size of the variable: the truncation error is 1e-8;
with a variable-step solver accurate to 1e-8, the derivative is accurate to 1e-4."""
NEAR_ZERO: Final = 0.1
"""The size of a parameter near zero is this share of its scale."""
_OF_OUTPUT: Final = (OUTPUTS, OUTPUT_SLOPES)

_INTEGERS = types.CPointer(types.int64)
_FLOATS = types.CPointer(types.float64)
_KINDS: Final = (
    _INTEGERS, _FLOATS, types.int64, *(_FLOATS,) * 6, types.float64, _FLOATS, _FLOATS, _INTEGERS, types.int64,
    types.int64,
)  # fmt: skip
"""Arguments of `_function`: the machine's integers and floats, which function, and those of the kernels."""
_LLVM: Final[Mapping[Any, Any]] = {
    _INTEGERS: ir.IntType(64).as_pointer(),
    _FLOATS: ir.DoubleType().as_pointer(),
    types.int64: ir.IntType(64),
    types.float64: ir.DoubleType(),
}
_CALLED: Final = ir.FunctionType(
    ir.VoidType(), [_LLVM[kind] for kind in _KINDS]
).as_pointer()


@compiled(inside=True)
def _value(  # noqa: PLR0917
    machine: Machine,
    quantity: int,
    z: FloatArray,
    d: FloatArray,
    h: float,
    out: FloatArray,
) -> None:
    """The output, the rates, or the states after a step of h; z holds parameters, states and drive.

    The rates of a co-simulation FMU are differences over one sample, which have the same equilibria.
    """
    if machine.head[0].status != 0:
        return
    bring(machine, z, d)
    if quantity == OUTPUTS:
        out[0] = output(machine)
    elif quantity == SLOPES and machine.head[0].exchange:
        rates(machine, out)
    else:
        period = h if quantity == STEP else machine.head[0].sample
        advance(machine, period)
        for i in range(out.size):
            end = machine.held[machine.head[0].n_parameters + i]
            begun = z[machine.head[0].n_parameters + i]
            out[i] = end if quantity == STEP else (end - begun) / period


@compiled
def ends_of(machine: Machine, place: int, value: float) -> tuple[float, float]:
    """The ends of a difference by a parameter, state or the drive; the value instead of an impossible one."""
    size = WIDTH * machine.sizes[place]
    if place < machine.head[0].n_parameters:
        size = max(WIDTH * abs(value), NEAR_ZERO * size)
    high = value + size
    low = value - size
    return high if high <= machine.highest[
        place
    ] else value, low if low >= machine.lowest[place] else value


@compiled(inside=True)
def _slope(  # noqa: PLR0917
    machine: Machine,
    quantity: int,
    z: FloatArray,
    d: FloatArray,
    h: float,
    place: int,
    out: FloatArray,
) -> None:
    """The derivative by one of the parameters, then the states, then the drive."""
    values = np.empty((2, out.size))
    moved = z.copy()
    ends = ends_of(machine, place, z[place])
    for side in range(2):
        moved[place] = ends[side]
        _value(machine, quantity, moved, d, h, values[side])
    for i in range(out.size):
        out[i] = (values[0, i] - values[1, i]) / (ends[0] - ends[1])


@compiled(inside=True)
def _output_slopes(machine: Machine, z: FloatArray, d: FloatArray, out: Any) -> None:
    """Derivatives of the output by the states and the unknowns; 0 by an unknown that it does not show."""
    m = machine.head[0].n_parameters
    n = machine.head[0].n_states
    slope = np.empty(1)
    for i in range(n + machine.head[0].n_unknown):
        out[i] = 0.0
        if i < n or machine.shown[i - n]:
            place = m + i if i < n else machine.unknown[i - n]
            _slope(machine, OUTPUTS, z, d, 0.0, place, slope)
            out[i] = slope[0]


@compiled(inside=True)
def _rate_slopes(machine: Machine, z: FloatArray, d: FloatArray, out: Any) -> None:
    """Derivatives of the rates by the unknowns (n × q), and, after n rates, by the states (n × n) and the
    drive (n)."""
    m = machine.head[0].n_parameters
    n = machine.head[0].n_states
    q = machine.head[0].n_unknown
    slopes = np.empty(n)
    for j in range(q + n + 1):
        place = machine.unknown[j] if j < q else m + j - q
        _slope(machine, SLOPES, z, d, 0.0, place, slopes)
        for i in range(n):
            if j < q:
                out[i * q + j] = slopes[i]
            elif j < q + n:
                out[n * (q + 1) + i * n + j - q] = slopes[i]
            else:
                out[n * (q + 1) + n * n + i] = slopes[i]


@compiled(inside=True)
def _move_tangents(  # noqa: PLR0917
    machine: Machine,
    z: FloatArray,
    d: FloatArray,
    h: float,
    columns: Any,
    du: Any,
    chosen: Any,
    first: int,
    size: int,
) -> None:
    """Move tangents, columns of shape (n, size), on by a step: those by the `first` chosen unknowns, then by
    initial states, whose drive differs by du."""
    m = machine.head[0].n_parameters
    n = machine.head[0].n_states
    slopes = np.empty((first + n + 1, n))
    before = np.empty(n)
    for j in range(first + n + 1):
        place = machine.unknown[chosen[j]] if j < first else m + j - first
        _slope(machine, STEP, z, d, h, place, slopes[j])
    for j in range(size):
        for i in range(n):
            before[i] = columns[i * size + j]
        for i in range(n):
            total = slopes[first + n, i] * du[j] + (slopes[j, i] if j < first else 0.0)
            for k in range(n):
                total += slopes[first + k, i] * before[k]
            columns[i * size + j] = total


@compiled(addressed=True)
def _function(  # noqa: PLR0917
    integers: Any,
    floats: Any,
    quantity: int,
    x: Any,
    u: Any,
    d: Any,
    p: Any,
    b: Any,  # noqa: ARG001
    out: Any,
    h: float,
    columns: Any,
    du: Any,
    chosen: Any,
    first: int,
    size: int,
) -> None:
    """One of the functions, an index of `FUNCTIONS`; b and those after `out` are not used by all of them."""
    machine = machine_at(integers, floats)
    most = 0
    head = machine.head[0]
    m = head.n_parameters
    n = head.n_states
    for i in range(head.n_inputs - 1):
        most = max(most, machine.given[i] + 1)
    disturbances = numba.carray(d, most)
    z = np.empty(m + n + 1)
    for i in range(m):
        z[i] = p[i]
    for i in range(n):
        z[m + i] = x[i]
    z[m + n] = np.nan if quantity in _OF_OUTPUT else u[0]
    if quantity == OUTPUT_SLOPES:
        _output_slopes(machine, z, disturbances, out)
        return
    if quantity == SLOPES:
        _rate_slopes(machine, z, disturbances, out)
    elif quantity == TANGENTS:
        _move_tangents(machine, z, disturbances, h, columns, du, chosen, first, size)
    value = STEP if quantity == TANGENTS else quantity
    skipped = n * head.n_unknown if quantity == SLOPES else 0
    column = np.zeros(max(n, 1))
    _value(
        machine, value, z, disturbances, h, column[: 1 if quantity == OUTPUTS else n]
    )
    for i in range(column.size):
        out[skipped + i] = column[i]
    if value == STEP:
        out[n] = 0.0  # kinks within the step have been found


def functions_for(
    integers: int, numbers: int, start: int
) -> tuple[Any, dict[str, int]]:
    """The functions of the FMU whose machine is at these addresses: their owner, and their addresses.

    `start` is the address of the function for initial states.
    """
    _function.compile(_KINDS)  # type: ignore[attr-defined]
    result = _function.overloads[_KINDS]  # type: ignore[attr-defined]
    # A kernel from the cache does not list this name as defined.
    address = result.library.codegen._engine.get_function_address(
        result.fndesc.llvm_cfunc_wrapper_name
    )
    kinds = [_LLVM[kind] for kind in _KINDS]
    module = ir.Module("fmu")
    for number, name in enumerate(FUNCTIONS):
        count = {STEP: 7, TANGENTS: 12}.get(number, 6)
        llvm = ir.Function(
            module, ir.FunctionType(ir.VoidType(), kinds[3 : 3 + count]), name
        )
        builder = ir.IRBuilder(llvm.append_basic_block())
        if number in {STEP, TANGENTS, SLOPES, OUTPUTS, OUTPUT_SLOPES}:
            pointers = [
                builder.inttoptr(ir.Constant(kinds[2], value), kind)
                for value, kind in zip(
                    (address, integers, numbers), (_CALLED, *kinds), strict=False
                )
            ]
            unused = [
                ir.Constant(kind, None if kind.is_pointer else 0)
                for kind in kinds[3 + count :]
            ]
            builder.call(
                pointers[0],
                [*pointers[1:], ir.Constant(kinds[2], number), *llvm.args, *unused],
            )
        builder.ret_void()
    target = binding.Target.from_default_triple().create_target_machine(
        reloc="pic", jit=True
    )
    owner, addresses = linked(target.emit_object(binding.parse_assembly(str(module))))
    return owner, {**addresses, "start": start}


def code_for(
    addresses: Mapping[str, int], parameters: int, states: int, unknown: int
) -> Code:
    """The FMU as a plant for the kernels."""
    sizes = {
        "n_states": states,
        "n_inputs": 1,
        "n_outputs": 1,
        "n_parameters": parameters,
        "n_unknown": unknown,
    }
    number_of = {**addresses, **dict.fromkeys(NUMBERS, 0), **sizes}
    return np.array(
        [number_of[name] for name in (*FUNCTIONS, *NUMBERS)], dtype=np.int64
    )


@compiled
def normal_at(
    code: Code,
    machine: Machine,
    problem: LeastSquares,
    values: FloatArray,
    limit: float,
) -> tuple[float, FloatArray, FloatArray]:
    """As `twinmatch.dynamics.runs.normal_at`, from differences of whole runs; infinite without finite values.

    `code` has no unknowns: no derivatives of single samples are needed.
    """
    data = problem.data
    n = values.size
    free = problem.places.size
    m = machine.head[0].n_parameters
    size = data.disturbances.shape[0]
    signals = 1 if problem.law[KIND] == DRIVEN else 2
    nowhere = np.inf, np.zeros(n), np.zeros((n, n))
    still = np.zeros((size, 1))
    never = np.zeros(size, dtype=np.bool_)
    simulated = np.empty((1 + 2 * n, 2, size))
    ends = np.empty((n, 2))
    normal = np.zeros((n + 1, n + 1))
    row = np.empty((1, n + 1))
    steps = 0
    for i in range(1 + 2 * n):
        moved = values.copy()
        j = (i - 1) // 2
        if i > 0:
            place = problem.places[j] if j < free else m + problem.started[j - free]
            ends[j, 0], ends[j, 1] = ends_of(machine, place, values[j])
            moved[j] = ends[j, (i - 1) % 2]
        vector = problem.base.copy()
        vector[problem.places] = moved[:free]
        x, _, _ = begin(
            code, vector, problem.first, problem.inputs_before, data.disturbances[0]
        )
        x[problem.started] = moved[free:]
        if i == 0:
            steps = step_count(
                code,
                vector,
                problem.corners,
                problem.drives,
                problem.default_disturbances,
                data.period,
                problem.rate_limit,
            )
            if steps > MAX_STEPS:
                return nowhere
        y, u, _ = run(
            code,
            vector,
            x,
            problem.law,
            data.memory,
            data.references,
            data.disturbances,
            still,
            never,
            0.0,
            data.period,
            steps,
        )
        simulated[i, 0] = y[:, 0]
        simulated[i, 1] = u[:, 0]
        if i == 0 or i == 2 * n:
            normal[:] = 0.0
            for k in range(size):
                for s in range(signals):
                    for j in range(n):
                        rise = simulated[1 + 2 * j, s, k] - simulated[2 + 2 * j, s, k]
                        row[0, j] = rise / (ends[j, 0] - ends[j, 1]) if i > 0 else 0.0
                    row[0, n] = simulated[0, s, k] - data.measured[s, k]
                    add_row(normal, row, 0, data.weights[s, k], data.robust)
        if i == 0 and normal[n, n] > limit:
            break
    if not np.isfinite(normal).all():
        return nowhere
    cost = normal[n, n]
    gradient = normal[n, :n].copy()
    hessian = np.zeros((n, n))
    for j in range(n):
        deviation = values[j] - problem.expected[j]
        cost += problem.pull[j] * deviation * deviation
        gradient[j] += problem.pull[j] * deviation
        for i in range(j + 1):
            hessian[i, j] = hessian[j, i] = normal[j, i]
        hessian[j, j] += problem.pull[j]
    return cost, gradient, hessian
