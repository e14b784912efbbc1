"""Whole runs of an FMU without events in compiled code, which covers most samples.

The FMU's functions are called by address. Pointers, sizes and booleans are all passed as integers; additional
arguments of FMI 3 come last, where functions of FMI 2 ignore them.
"""

# ruff: noqa: ARG001, PLR0917 (kernels take arrays in a row, and intrinsics the compiler's context)
# mypy: disable-error-code="untyped-decorator, no-any-return"

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from twinmatch.compiled import compiled
from twinmatch.dynamics.pid_step import Gains, pid_step
from twinmatch.dynamics.sensor_step import reading
from twinmatch.signals import FloatArray

__all__ = ["DONE", "EVENT", "Addresses", "Rooms", "prepared", "straight_run"]

DONE, EVENT, ENDED = 0, -1, 3
"""Results of a run; after an error, its status is returned instead."""


class Addresses(NamedTuple):
    """Addresses of the instance, its functions and value references; zero if absent."""

    component: int
    get: int
    set: int
    inputs: int
    """References of drive and disturbances."""
    states: int
    output: int
    set_time: int
    set_x: int
    get_x: int
    get_dx: int
    after_step: int
    do_step: int


class Rooms(NamedTuple):
    """Buffers of the functions."""

    inputs: FloatArray
    states: FloatArray
    output: FloatArray
    x: FloatArray
    dx: FloatArray
    flags: Any
    """Integer flags, shape (8,)."""


def _status(*given: Any) -> Any:
    """Signature and code of a call by address that returns an FMI status."""

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        kinds = [context.get_value_type(kind) for kind in signature.args[1:]]
        function = builder.inttoptr(values[0], ir.FunctionType(ir.IntType(32), kinds).as_pointer())
        return builder.call(function, values[1:])

    return types.int32(*given), code


@intrinsic
def _call_2(context: Any, address: Any, component: Any, a: Any, b: Any) -> Any:
    return _status(address, component, a, b)


@intrinsic
def _call_4(context: Any, address: Any, component: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    return _status(address, component, a, b, c, d)


@intrinsic
def _call_time(context: Any, address: Any, component: Any, time: Any) -> Any:
    return _status(address, component, time)


@intrinsic
def _call_step(
    context: Any, address: Any, component: Any, time: Any, size: Any, kept: Any,
    a: Any, b: Any, c: Any, d: Any,
) -> Any:  # fmt: skip
    return _status(address, component, time, size, kept, a, b, c, d)


@compiled(inside=True)
def _rates(at: Addresses, rooms: Rooms, x: FloatArray, time: float, k: FloatArray) -> int:
    n = x.size
    status = _call_time(at.set_time, at.component, time)
    for i in range(n):
        rooms.x[i] = x[i]
    status = max(status, _call_2(at.set_x, at.component, rooms.x.ctypes.data, n))
    status = max(status, _call_2(at.get_dx, at.component, rooms.dx.ctypes.data, n))
    for i in range(n):
        k[i] = rooms.dx[i]
    return status


@compiled(inside=True)
def _moved(at: Addresses, rooms: Rooms, time: float, period: float, steps: int) -> int:
    """Advance a model-exchange FMU by one period."""
    n = rooms.x.size
    h, x = period / steps, np.empty(n)
    k1, k2, k3, k4 = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    data = rooms.flags.ctypes.data
    status = _call_2(at.get_x, at.component, rooms.x.ctypes.data, n)
    for i in range(n):
        x[i] = rooms.x[i]
    for step in range(steps):
        t = time + step * h
        status = max(status, _rates(at, rooms, x, t, k1))
        status = max(status, _rates(at, rooms, x + 0.5 * h * k1, t + 0.5 * h, k2))
        status = max(status, _rates(at, rooms, x + 0.5 * h * k2, t + 0.5 * h, k3))
        status = max(status, _rates(at, rooms, x + h * k3, t + h, k4))
        for i in range(n):
            x[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
            rooms.x[i] = x[i]
        status = max(status, _call_time(at.set_time, at.component, t + h))
        status = max(status, _call_2(at.set_x, at.component, rooms.x.ctypes.data, n))
        if at.after_step != 0:
            rooms.flags[0] = 0
            status = max(status, _call_4(at.after_step, at.component, 1, data, data + 4, 0))
            if rooms.flags[0] != 0:
                return EVENT
    return status


@compiled
def straight_run(
    at: Addresses, rooms: Rooms, closed: bool, gains: Gains, given: FloatArray, others: FloatArray,
    noise: FloatArray, frozen: FloatArray, numbers: FloatArray, steps: int,
    y: FloatArray, u: FloatArray, states: FloatArray,
) -> int:  # fmt: skip
    """Fill outputs and inputs, shape (N,), and states, shape (N + 1, nx), from the FMU's current state.

    `numbers` holds resolution, integral, previous, period, and factor and offset of output and drive.
    Returns `DONE`, `EVENT`, `ENDED` or an error status.
    """
    resolution, integral, previous, period = numbers[0], numbers[1], numbers[2], numbers[3]
    last, nx, size = 0.0, rooms.states.size, given.size
    worst = 0
    for k in range(size + 1):
        if nx > 0:
            status = _call_4(at.get, at.component, at.states, nx, rooms.states.ctypes.data, nx)
            worst = max(worst, status)
        for i in range(nx):
            states[k, i] = rooms.states[i]
        if k == size:
            break
        worst = max(worst, _call_4(at.get, at.component, at.output, 1, rooms.output.ctypes.data, 1))
        seen = numbers[4] * rooms.output[0] + numbers[5]
        last = reading(seen, noise[k], frozen[k] != 0.0 and k > 0, resolution, last)
        y[k], u[k] = last, given[k]
        if closed:
            u[k], integral, previous = pid_step(gains, integral, previous, given[k], last)
        rooms.inputs[0] = numbers[6] * u[k] + numbers[7]
        for i in range(others.shape[1]):
            rooms.inputs[1 + i] = others[k, i]
        m = rooms.inputs.size
        worst = max(worst, _call_4(at.set, at.component, at.inputs, m, rooms.inputs.ctypes.data, m))
        if at.do_step != 0:
            data = rooms.flags.ctypes.data
            status = _call_step(
                at.do_step, at.component, k * period, period, 1, data, data + 8, data + 16, data + 24
            )
            if rooms.flags[2] != 0 or rooms.flags[4] != 0:  # FMI 3: it terminated, or returned early
                return ENDED
        else:
            status = _moved(at, rooms, k * period, period, steps)
        if status == EVENT:
            return EVENT
        worst = max(worst, status)
        if worst > 1:
            return worst
    return DONE


def prepared() -> None:
    """Compile `straight_run` with empty arguments, before any request with a time limit."""
    none, whole = np.zeros(0), np.zeros(8, dtype=np.int32)
    rooms = Rooms(none, none, none, none, none, whole)
    gains = Gains(0.0, 0.0, 0.0, 0.0, 1.0, -1.0, 1.0, on_measurement=False)
    nothing = Addresses(*(0 for _ in Addresses._fields))
    rows = np.zeros((0, 0))
    straight_run(
        nothing, rooms, False, gains, none, rows, none, none, np.zeros(8), 1, none, none, np.zeros((1, 0))
    )
