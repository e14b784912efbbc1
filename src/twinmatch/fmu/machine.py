"""A running FMU: initialise, advance, read. Used only in the FMU's own process.

Values are in the FMU's units. As used here, FMI 2 and FMI 3 differ only in names. Functions that are called
at every sample are bound once. Whole runs without events, which cover most samples, are compiled code that
calls the FMU's functions by address: pointers, sizes and booleans are all passed as integers; additional
arguments of FMI 3 come last, where functions of FMI 2 ignore them.
"""

# ruff: noqa: ARG001, PLR0917 (kernels take arrays in a row, and intrinsics the compiler's context)
# mypy: disable-error-code="untyped-decorator, no-any-return"

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from twinmatch.compiled import compiled
from twinmatch.dynamics.loop import Gains, pid_step, reading
from twinmatch.signals import FloatArray

_WARNING: Final = 1
"""Highest status that is not an error."""
_POINTER, _SIZE, _REAL = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_double
DONE, EVENT, ENDED = 0, -1, 3
"""Results of a run; after an error, its status is returned instead."""


class Calls:
    """Functions by name without `fmi2` or `fmi3`; an error status is raised as an exception."""

    def __init__(self, fmu: Any, major: int) -> None:
        """Bind an instance made by FMPy; `major` is the version of FMI."""
        self.fmu, self.major = fmu, major

    def bound(self, name: str, *types: Any) -> Callable[..., None]:
        """A function of the library, bound to the instance as its first argument."""
        function = self.fmu.dll[f"fmi{self.major}{name}"]
        function.restype, function.argtypes = ctypes.c_int, (_POINTER, *types)
        fmu = self.fmu

        def call(*arguments: Any) -> None:
            status = function(fmu.component, *arguments)
            if status > _WARNING:
                raise RuntimeError(f"its function {name} returned status {status}")

        return call

    def address(self, name: str) -> int:
        """Address of a function; 0 if it is missing."""
        return int(ctypes.cast(self.fmu.dll[f"fmi{self.major}{name}"], _POINTER).value or 0)

    def group(self, references: Sequence[int]) -> Group:
        """Variables that are set or read together."""
        return Group(self, references)


class Group:
    """Some variables of an FMU, with a buffer for their values."""

    def __init__(self, calls: Calls, references: Sequence[int]) -> None:
        n = len(references)
        self.values = (_REAL * n)()
        self._references = (ctypes.c_uint32 * n)(*references)
        self.address = ctypes.addressof(self._references)
        """Address of the references."""
        self._arguments: tuple[int, ...] = (
            ctypes.addressof(self._references), n, ctypes.addressof(self.values), n,
        )[: 3 if calls.major == 2 else 4]  # fmt: skip
        types = (_POINTER, _SIZE, _POINTER, _SIZE)[: len(self._arguments)]
        kind = "Real" if calls.major == 2 else "Float64"
        self._get, self._set = (calls.bound(f"{verb}{kind}", *types) for verb in ("Get", "Set"))

    def write(self, values: Sequence[float]) -> None:
        """Set the variables."""
        if values:
            self.values[:] = list(values)
            self._set(*self._arguments)

    def read(self) -> list[float]:
        """Read the variables."""
        if len(self.values):
            self._get(*self._arguments)
        return self.values[:]


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


class Buffers(NamedTuple):
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
def _rates(at: Addresses, buffers: Buffers, x: FloatArray, time: float, k: FloatArray) -> int:
    n = x.size
    status = _call_time(at.set_time, at.component, time)
    for i in range(n):
        buffers.x[i] = x[i]
    status = max(status, _call_2(at.set_x, at.component, buffers.x.ctypes.data, n))
    status = max(status, _call_2(at.get_dx, at.component, buffers.dx.ctypes.data, n))
    for i in range(n):
        k[i] = buffers.dx[i]
    return status


@compiled(inside=True)
def _moved(at: Addresses, buffers: Buffers, time: float, period: float, steps: int) -> int:
    """Advance a model-exchange FMU by one period."""
    n = buffers.x.size
    h, x = period / steps, np.empty(n)
    k1, k2, k3, k4 = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    data = buffers.flags.ctypes.data
    status = _call_2(at.get_x, at.component, buffers.x.ctypes.data, n)
    for i in range(n):
        x[i] = buffers.x[i]
    for step in range(steps):
        t = time + step * h
        status = max(status, _rates(at, buffers, x, t, k1))
        status = max(status, _rates(at, buffers, x + 0.5 * h * k1, t + 0.5 * h, k2))
        status = max(status, _rates(at, buffers, x + 0.5 * h * k2, t + 0.5 * h, k3))
        status = max(status, _rates(at, buffers, x + h * k3, t + h, k4))
        for i in range(n):
            x[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
            buffers.x[i] = x[i]
        status = max(status, _call_time(at.set_time, at.component, t + h))
        status = max(status, _call_2(at.set_x, at.component, buffers.x.ctypes.data, n))
        if at.after_step != 0:
            buffers.flags[0] = 0
            status = max(status, _call_4(at.after_step, at.component, 1, data, data + 4, 0))
            if buffers.flags[0] != 0:
                return EVENT
    return status


@compiled
def compiled_run(
    at: Addresses, buffers: Buffers, closed: bool, gains: Gains, given: FloatArray, others: FloatArray,
    noise: FloatArray, frozen: FloatArray, numbers: FloatArray, steps: int,
    y: FloatArray, u: FloatArray, states: FloatArray,
) -> int:  # fmt: skip
    """Fill outputs and inputs, shape (N,), and states, shape (N + 1, nx), from the FMU's current state.

    `numbers` holds resolution, integral, previous, period, and factor and offset of output and drive.
    Returns `DONE`, `EVENT`, `ENDED` or an error status.
    """
    resolution, integral, previous, period = numbers[0], numbers[1], numbers[2], numbers[3]
    last, nx, size = 0.0, buffers.states.size, given.size
    worst = 0
    for k in range(size + 1):
        if nx > 0:
            status = _call_4(at.get, at.component, at.states, nx, buffers.states.ctypes.data, nx)
            worst = max(worst, status)
        for i in range(nx):
            states[k, i] = buffers.states[i]
        if k == size:
            break
        worst = max(worst, _call_4(at.get, at.component, at.output, 1, buffers.output.ctypes.data, 1))
        seen = numbers[4] * buffers.output[0] + numbers[5]
        last = reading(seen, noise[k], frozen[k] != 0.0 and k > 0, resolution, last)
        y[k], u[k] = last, given[k]
        if closed:
            u[k], integral, previous = pid_step(gains, integral, previous, given[k], last)
        buffers.inputs[0] = numbers[6] * u[k] + numbers[7]
        for i in range(others.shape[1]):
            buffers.inputs[1 + i] = others[k, i]
        m = buffers.inputs.size
        worst = max(worst, _call_4(at.set, at.component, at.inputs, m, buffers.inputs.ctypes.data, m))
        if at.do_step != 0:
            data = buffers.flags.ctypes.data
            status = _call_step(
                at.do_step, at.component, k * period, period, 1, data, data + 8, data + 16, data + 24
            )
            if buffers.flags[2] != 0 or buffers.flags[4] != 0:  # FMI 3: it terminated, or returned early
                return ENDED
        else:
            status = _moved(at, buffers, k * period, period, steps)
        if status == EVENT:
            return EVENT
        worst = max(worst, status)
        if worst > 1:
            return worst
    return DONE


def compile_runs() -> None:
    """Compile `compiled_run` with empty arguments, before any request with a time limit."""
    none, whole = np.zeros(0), np.zeros(8, dtype=np.int32)
    buffers = Buffers(none, none, none, none, none, whole)
    gains = Gains(0.0, 0.0, 0.0, 0.0, 1.0, -1.0, 1.0, on_measurement=False)
    nothing = Addresses(*(0 for _ in Addresses._fields))
    rows = np.zeros((0, 0))
    compiled_run(
        nothing, buffers, False, gains, none, rows, none, none, np.zeros(8), 1, none, none, np.zeros((1, 0))
    )


class FmuRunError(Exception):
    """The FMU cannot be run, or violates FMI."""


class References(NamedTuple):
    """Value references of the variables that are set and read."""

    fixed: list[int]
    """Set before a run: parameters, and initial states."""
    inputs: list[int]
    """Drive, then disturbances."""
    states: list[int]
    """States to read."""
    output: list[int]


class CoSimulation:
    """A co-simulation FMU, which has its own solver."""

    def __init__(self, fmu: Any, major: int, references: References) -> None:
        self.fmu, self.major, self.references = fmu, major, references
        self._begun, self._resets = False, True
        self._calls = calls = Calls(fmu, major)
        self._fixed, self._inputs, self._states, self._output = (calls.group(own) for own in references)
        self.time = 0.0
        self._at: dict[str, int] = {}

    def put(self, fixed: Sequence[float], inputs: Sequence[float]) -> None:
        """Initialise with these values."""
        fmu = self.fmu
        if self._begun:
            self._reset()
        self._begun, self.time = True, 0.0
        if self.major == 2:
            fmu.setupExperiment(startTime=0.0)
        self._fixed.write(fixed)
        if self.major == 2:
            fmu.enterInitializationMode()
        else:
            fmu.enterInitializationMode(startTime=0.0)
        self._inputs.write(inputs)
        fmu.exitInitializationMode()

    def run_arguments(self) -> tuple[Addresses, Buffers] | None:
        """The arguments of a compiled run from the current state; None if it may have events."""
        if not self._at:
            real = "Real" if self.major == 2 else "Float64"
            names = (f"Get{real}", f"Set{real}")
            self._at = {
                **dict(zip(("get", "set"), map(self._calls.address, names), strict=True)),
                **dict(zip(("inputs", "states", "output"), self._references(), strict=True)),
                **{name: self._calls.address(of) if of else 0 for name, of in self._functions().items()},
            }
            sizes = (len(self.references.inputs), len(self.references.states), 1, self._size, self._size)
            inputs, states, output, x, dx = map(np.zeros, sizes)
            self._buffers = Buffers(inputs, states, output, x, dx, np.zeros(8, dtype=np.int32))
        return Addresses(component=self.fmu.component, **self._at), self._buffers

    _size = 0
    """Number of continuous states that are integrated here."""

    def _functions(self) -> dict[str, str]:
        """Names of the functions that advance it, by the fields of `Addresses`; empty ones are not called."""
        none = dict.fromkeys(("set_time", "set_x", "get_x", "get_dx", "after_step"), "")
        return {**none, "do_step": "DoStep"}

    def _references(self) -> list[int]:
        return [group.address for group in (self._inputs, self._states, self._output)]

    def forget(self) -> None:
        """Do nothing after an error: `put` always initialises again."""

    def feed(self, inputs: Sequence[float]) -> None:
        """Set drive and disturbances."""
        self._inputs.write(inputs)

    def move(self, period: float, steps: int) -> None:  # noqa: ARG002 (it chooses its own steps)
        """Advance by one period."""
        result = self.fmu.doStep(self.time, period)
        if self.major == 3 and (result[1] or result[2]):
            raise FmuRunError("it terminated the simulation, or returned early")
        self.time += period

    def states(self) -> list[float]:
        """The current states."""
        return self._states.read()

    def output(self) -> float:
        """The current output."""
        return self._output.read()[0]

    def _reset(self) -> None:
        """Reset the instance, or replace it if the FMU cannot be reset."""
        from fmpy.fmi1 import FMICallException  # noqa: PLC0415 (an extra)

        fmu = self.fmu
        if self._resets:
            try:
                fmu.reset()
            except FMICallException:
                self._resets = False
            else:
                return
        if self.major == 2:
            fmu.fmi2FreeInstance(fmu.component)
        else:
            fmu.fmi3FreeInstance(fmu.component)
        fmu.instantiate()
