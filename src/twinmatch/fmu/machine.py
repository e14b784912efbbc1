"""A running FMU for compiled code: brought to parameters and states, advanced, read; only in its process.

Its functions are called by address: pointers, sizes and booleans are all passed as integers; additional
arguments of FMI 3 come last, where functions of FMI 2 ignore them. An error is kept in the machine, which
then does nothing more until `error_of` has told it.
"""


# mypy: disable-error-code="untyped-decorator, no-any-return"

from __future__ import annotations

from typing import Any, Final

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.signals import FloatArray

FUNCTIONS: Final = (
    "Reset", "SetupExperiment", "EnterInitializationMode", "ExitInitializationMode", "GetReal", "SetReal",
    "DoStep", "SetTime", "GetContinuousStates", "SetContinuousStates", "GetDerivatives", "GetEventIndicators",
    "CompletedIntegratorStep", "EnterEventMode", "NewDiscreteStates", "EnterContinuousTimeMode",
)  # fmt: skip
"""Functions of FMI 2 whose addresses a machine begins with; zero where it has none or needs none."""
NAMES_3: Final = {
    "SetupExperiment": "",
    "GetReal": "GetFloat64",
    "SetReal": "SetFloat64",
    "GetDerivatives": "GetContinuousStateDerivatives",
    "NewDiscreteStates": "UpdateDiscreteStates",
}
"""Those with other names in FMI 3."""
(
    RESET, SETUP, INITIALISE, BEGIN, GET, SET, STEP, SET_TIME, GET_STATES, SET_STATES, RATES, INDICATORS,
    COMPLETED, EVENT_MODE, UPDATE, CONTINUE,
) = range(16)  # fmt: skip
INSTANCE, RENEW, FMI_3, EXCHANGE, N_PARAMETERS, N_STATES, N_INPUTS, N_INDICATORS, N_UNKNOWN = range(16, 25)
"""The instance, a function that replaces it, whether it is of FMI 3 and for model exchange, and numbers."""
FIXED, INPUTS, STATES, OUTPUT = range(25, 29)
"""Addresses of the value references of what is set before a run, of drive and disturbances, of states, of the
output."""
STATUS, WHERE, BEGUN = range(29, 32)
"""The first error and the function that it came from, and whether a run has begun."""
PLACES, GIVEN, UNKNOWN, SHOWN = range(32, 36)
"""Where these begin among the integers: index of each state among the FMU's own, indices of the disturbances
that it takes, indices of the parameters with tangents, and which of these the output depends on by itself."""
FACTORS, OFFSETS, HELD, SIZES, LOWEST, HIGHEST, HEAD = range(36, 43)
"""Where these begin among the floats, each in the order parameters, states, inputs, output. Plant value =
factor · FMU value + offset; the values at which it is, in the plant's units; scales of parameters, and spans
of states and drive; least and most possible values. And the end of the integers that are not lists."""
RUN_TIME, REST, SAMPLE, VALUES = range(4)
"""Time of the run, rest value of the drive, sample time of a rate in co-simulation; and the end of these."""
ENDED: Final = 101
UNSETTLED: Final = 102
_WARNING = 1
"""Highest status that is not an error."""
MAX_ROUNDS = 100
"""Most event iterations at one time."""
BISECTIONS = 48
MAX_EVENTS = 24
"""Most events located in one step; later ones are not located."""


Integers = NDArray[np.int64]
"""Addresses and numbers of a machine, in the order above, then lists."""


def memory_for(parameters: int, states: int, inputs: int) -> tuple[Integers, FloatArray]:
    """The integers and the floats of a machine, zero but for what follows from its sizes."""
    whole = parameters + states + inputs + 1
    at = np.zeros(HEAD + states + inputs + 2 * parameters, dtype=np.int64)
    at[[N_PARAMETERS, N_STATES, N_INPUTS]] = parameters, states, inputs
    at[PLACES : SHOWN + 1] = np.cumsum([HEAD, states, inputs, parameters])
    at[FACTORS:HEAD] = VALUES + whole * np.arange(6)
    return at, np.zeros(VALUES + 6 * whole)


@compiled(inside=True)
def integers_at(pointer: Any) -> Integers:
    """The integers of a machine that begin at a pointer."""
    at = numba.carray(pointer, HEAD)
    return numba.carray(pointer, HEAD + at[N_STATES] + at[N_INPUTS] + 2 * at[N_PARAMETERS])


@compiled(inside=True)
def floats_at(integers: Any, floats: Any) -> FloatArray:
    """The floats of a machine that begin at a pointer, as do its integers."""
    at = numba.carray(integers, HEAD)
    return numba.carray(floats, VALUES + 6 * (at[N_PARAMETERS] + at[N_STATES] + at[N_INPUTS] + 1))


@intrinsic
def _fmi(context: Any, address: Any, instance: Any, given: Any) -> Any:  # noqa: ARG001 (numba's interface)
    """Call a function of the FMU by its address; returns its status."""

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:  # noqa: ARG001
        passed = [values[1], *cgutils.unpack_tuple(builder, values[2])]
        kinds = ir.FunctionType(ir.IntType(32), [value.type for value in passed])
        return builder.call(builder.inttoptr(values[0], kinds.as_pointer()), passed)

    return types.int32(address, instance, given), code


@compiled(inside=True)
def _note(at: Integers, where: int, status: int) -> None:
    if status > _WARNING and at[STATUS] == 0:
        at[STATUS], at[WHERE] = status, where


@compiled(inside=True)
def _call(at: Integers, function: int, given: Any) -> None:
    """Call a function with arguments, a tuple, after the instance."""
    _note(at, function, _fmi(at[function], at[INSTANCE], given))


@compiled(inside=True)
def _pass(at: Integers, function: int, values: FloatArray) -> None:
    """Call a function that reads or writes an array."""
    if values.size > 0:
        _call(at, function, (values.ctypes.data, values.size))


@compiled(inside=True)
def _transfer(at: Integers, function: int, references: int, values: FloatArray) -> None:
    """Read or set some variables, in the FMU's units."""
    if values.size > 0:
        data = values.ctypes.data
        _call(at, function, (at[references], values.size, data, values.size))


@compiled(inside=True)
def _set(at: Integers, f: FloatArray, references: int, first: int, count: int) -> None:
    """Set some variables to their values in `held`."""
    own = np.empty(count)
    for i in range(count):
        own[i] = (f[at[HELD] + first + i] - f[at[OFFSETS] + first + i]) / f[at[FACTORS] + first + i]
    _transfer(at, SET, references, own)


@compiled(inside=True)
def _initialise(at: Integers, f: FloatArray) -> None:
    """Initialise with the parameters and inputs that are held, for co-simulation also with the states."""
    m, n = at[N_PARAMETERS], at[N_STATES]
    if at[BEGUN] != 0 and _fmi(at[RESET], at[INSTANCE], ()) > _WARNING:
        _note(at, RESET, _fmi(at[RENEW], at[INSTANCE], ()))
    at[BEGUN] = 1
    if at[SETUP] != 0:
        _call(at, SETUP, (0, 0.0, 0.0, 0, 0.0))
    _set(at, f, FIXED, 0, m if at[EXCHANGE] else m + n)
    _call(at, INITIALISE, (0, 0.0, 0.0, 0, 0.0))
    _set(at, f, INPUTS, m + n, at[N_INPUTS])
    _call(at, BEGIN, ())
    if at[EXCHANGE]:
        _settle(at)


@compiled(inside=True)
def bring(at: Integers, f: FloatArray, z: FloatArray, d: FloatArray) -> None:
    """Bring it to parameters, states and drive, and to disturbances; a drive of NaN: as it is.

    A run continues where nothing but the inputs has changed; otherwise another one begins.
    """
    m, n, held = at[N_PARAMETERS], at[N_STATES], at[HELD]
    same, there = at[BEGUN] != 0, True
    for i in range(m + n):
        if f[held + i] != z[i]:
            there = False
            same = same and i >= m
        f[held + i] = z[i]
    there = there and same
    if not there:
        f[RUN_TIME] = 0.0
    changed = not there
    for i in range(m + n, m + n + at[N_INPUTS]):
        value = z[m + n] if i == m + n else d[at[at[GIVEN] + i - m - n - 1]]
        if np.isnan(value):
            value = f[held + i] if there else f[REST]
        changed = changed or f[held + i] != value
        f[held + i] = value
    if not (same if at[EXCHANGE] else there):
        _initialise(at, f)
    elif changed and not at[EXCHANGE]:
        _set(at, f, INPUTS, m + n, at[N_INPUTS])
    if changed and at[EXCHANGE]:
        if not there:
            _call(at, SET_TIME, (0.0,))
        _set(at, f, INPUTS, m + n, at[N_INPUTS])
        if not there and n > 0:
            own = np.empty(n)
            for i in range(n):
                own[at[at[PLACES] + i]] = (z[m + i] - f[at[OFFSETS] + m + i]) / f[at[FACTORS] + m + i]
            _pass(at, SET_STATES, own)
        if at[N_INDICATORS] > 0:
            _call(at, EVENT_MODE, ())
            _settle(at)


@compiled(inside=True)
def output(at: Integers, f: FloatArray) -> float:
    """The output, in the plant's unit."""
    found = np.empty(1)
    _transfer(at, GET, OUTPUT, found)
    return f[at[OFFSETS] - 1] * found[0] + f[at[HELD] - 1]


@compiled(inside=True)
def advance(at: Integers, f: FloatArray, h: float) -> None:
    """Advance it by a step, whose end is held."""
    m, n = at[N_PARAMETERS], at[N_STATES]
    own = np.empty(n)
    if at[EXCHANGE]:
        _integrate(at, f, own, h)
    else:
        _step(at, f, h)
        _transfer(at, GET, STATES, own)
    for i in range(n):
        value = own[at[at[PLACES] + i]]
        f[at[HELD] + m + i] = f[at[FACTORS] + m + i] * value + f[at[OFFSETS] + m + i]


@compiled(inside=True)
def rates(at: Integers, f: FloatArray, found: FloatArray) -> None:
    """The derivatives of the states of a model-exchange FMU, in the plant's units."""
    m, n = at[N_PARAMETERS], at[N_STATES]
    x, own = np.empty(n), np.empty(n)
    _pass(at, GET_STATES, x)
    _rates(at, x, f[RUN_TIME], own)
    for i in range(n):
        found[i] = own[at[at[PLACES] + i]] * f[at[FACTORS] + m + i]


@compiled(inside=True)
def _step(at: Integers, f: FloatArray, h: float) -> None:
    """One step of the FMU's own solver."""
    flags = np.zeros(8, dtype=np.int32)
    data, time = flags.ctypes.data, f[RUN_TIME]
    _call(at, STEP, (time, h, 1, data, data + 8, data + 16, data + 24))
    if at[FMI_3] and (flags[2] != 0 or flags[4] != 0):  # it terminated, or returned early
        _note(at, STEP, ENDED)
    f[RUN_TIME] = time + h


@compiled(inside=True)
def _integrate(at: Integers, f: FloatArray, x: FloatArray, h: float) -> None:
    """One Runge–Kutta step of order 4, to the FMU's own states x.

    If an event indicator changes sign within it, its time is found by bisection and the step ends just
    after it, as for kinks of the native equations.
    """
    n, indicated = x.size, at[N_INDICATORS]
    after, signs = np.empty(n), np.empty(indicated)
    _pass(at, GET_STATES, x)
    left = h
    for event in range(MAX_EVENTS):
        time, taken = f[RUN_TIME], left
        _indicators(at, x, time, signs)
        _stepped(at, x, time, left, after)
        if indicated > 0 and event < MAX_EVENTS - 1 and _crossed(at, after, time + left, signs):
            low, taken = 0.0, left
            for _ in range(BISECTIONS):
                middle = 0.5 * (low + taken)
                _stepped(at, x, time, middle, after)
                if _crossed(at, after, time + middle, signs):
                    taken = middle
                else:
                    low = middle
            _stepped(at, x, time, taken, after)
        f[RUN_TIME] = time + taken
        for i in range(n):
            x[i] = after[i]
        _complete(at, f, x)
        left -= taken
        if not left > 0.0 or at[STATUS] != 0:
            break


@compiled(inside=True)
def _place(at: Integers, x: FloatArray, time: float) -> None:
    _call(at, SET_TIME, (time,))
    _pass(at, SET_STATES, x)


@compiled(inside=True)
def _rates(at: Integers, x: FloatArray, time: float, found: FloatArray) -> None:
    _place(at, x, time)
    _pass(at, RATES, found)


@compiled(inside=True)
def _stepped(at: Integers, x: FloatArray, t: float, h: float, after: FloatArray) -> None:
    k, there = np.empty((4, x.size)), x.copy()
    for stage in range(4):
        reach = h if stage == 3 else 0.5 * h
        if stage > 0:
            for i in range(x.size):
                there[i] = x[i] + reach * k[stage - 1, i]
        _rates(at, there, t + reach if stage > 0 else t, k[stage])
    for i in range(x.size):
        after[i] = x[i] + h / 6.0 * (k[0, i] + 2.0 * k[1, i] + 2.0 * k[2, i] + k[3, i])


@compiled(inside=True)
def _indicators(at: Integers, x: FloatArray, time: float, found: FloatArray) -> None:
    if found.size > 0:
        _place(at, x, time)
        _pass(at, INDICATORS, found)


@compiled(inside=True)
def _crossed(at: Integers, x: FloatArray, time: float, signs: FloatArray) -> bool:
    """Whether an event indicator has another sign here."""
    found = np.empty(signs.size)
    _indicators(at, x, time, found)
    crossed = False
    for i in range(signs.size):
        crossed = crossed or (found[i] > 0.0) != (signs[i] > 0.0)
    return crossed


@compiled(inside=True)
def _complete(at: Integers, f: FloatArray, x: FloatArray) -> None:
    """Set the states at the end of a step, handle its events, and read the states after them."""
    flags = np.zeros(4, dtype=np.int32)
    _place(at, x, f[RUN_TIME])
    if at[COMPLETED] != 0:
        data = flags.ctypes.data
        _call(at, COMPLETED, (1, data, data + 4))
        if flags[1] != 0:
            _note(at, COMPLETED, ENDED)
    if flags[0] != 0 or at[N_INDICATORS] > 0:
        _call(at, EVENT_MODE, ())
        _settle(at)
        _pass(at, GET_STATES, x)


@compiled(inside=True)
def _settle(at: Integers) -> None:
    """Iterate over events until the discrete states stay, and continue."""
    for _ in range(MAX_ROUNDS):
        if at[STATUS] != 0:
            return
        flags = np.zeros(16, dtype=np.int32)
        data = flags.ctypes.data
        _call(at, UPDATE, (data, data + 8, data + 16, data + 24, data + 32, data + 40))
        if flags[2 if at[FMI_3] else 1] != 0:
            _note(at, UPDATE, ENDED)
        if flags[0] == 0:
            _call(at, CONTINUE, ())
            return
    _note(at, UPDATE, UNSETTLED)


def error_of(at: Integers, f: FloatArray) -> str:
    """The error of the calls since the last time, as text; empty without one. It is then forgotten."""
    status, where = int(at[STATUS]), FUNCTIONS[at[WHERE]]
    if not status:
        return ""
    at[STATUS], f[at[HELD] : at[SIZES]] = 0, np.nan
    if status == ENDED:
        return "it terminated the simulation, or returned early"
    if status == UNSETTLED:
        return f"its discrete states do not converge in {MAX_ROUNDS} event iterations"
    name = NAMES_3.get(where, where) if at[FMI_3] else where
    return f"its function {name} returned status {status}"
