"""A running FMU for compiled code: brought to parameters and states, advanced, read; only in its process.

Its functions are called by address: pointers, sizes and booleans are all passed as integers; additional
arguments of FMI 3 come last, where functions of FMI 2 ignore them. An error is kept in the machine, which
then does nothing more until `error_of` has told it.
"""


# mypy: disable-error-code="untyped-decorator, no-any-return"

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.dynamics.kernels import BISECTIONS, MAX_EVENTS, copy_into
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
) = range(len(FUNCTIONS))  # fmt: skip
ENDED: Final = 101
UNSETTLED: Final = 102
_WARNING = 1
"""Highest status that is not an error."""
MAX_ROUNDS = 100
"""Most event iterations at one time."""

Integers = NDArray[np.int64]
_NUMBERS: Final = (
    "instance",
    "renew",  # a function that replaces the instance
    "fmi_3",  # whether it is of FMI 3
    "exchange",  # whether it is for model exchange
    "n_parameters", "n_states", "n_inputs", "n_indicators", "n_unknown",
    # Addresses of the value references of what is set before a run, of drive and disturbances, of states, of
    # the output.
    "fixed", "inputs", "states", "output",
    "status", "where",  # the first error, and the function that it came from
    "begun",  # whether a run has begun
)  # fmt: skip
_REALS: Final = (
    "run_time",
    "rest",  # rest value of the drive
    "sample",  # sample time of a rate in co-simulation
)
HEAD: Final = np.dtype((
    np.record, [*((name, np.int64) for name in _NUMBERS), *((name, np.float64) for name in _REALS)]
))  # fmt: skip
_BEGIN: Final = len(FUNCTIONS) + HEAD.itemsize // 8
"""Where the lists begin among the integers."""


class Machine(NamedTuple):
    """A running FMU. Plant value = factor · FMU value + offset."""

    functions: Integers
    """Addresses, in the order of FUNCTIONS."""
    head: Any
    """One record of HEAD, as an array: numba returns no tuples of records."""
    places: Integers
    """Index of each state among the FMU's own."""
    given: Integers
    """Indices of the disturbances that it takes."""
    unknown: Integers
    """Indices of the parameters with tangents; room for all."""
    shown: Integers
    """Which of these the output depends on by itself."""
    factors: FloatArray
    """In the order parameters, states, inputs, output; as all that follow."""
    offsets: FloatArray
    held: FloatArray
    """Values at which it is, in the plant's units."""
    sizes: FloatArray
    """Scales of parameters, spans of states and drive."""
    lowest: FloatArray
    """Least possible values."""
    highest: FloatArray


def memory_for(
    parameters: int, states: int, inputs: int
) -> tuple[Integers, FloatArray]:
    """The integers and the floats of a machine, zero but for these sizes."""
    integers = np.zeros(_BEGIN + states + inputs + 2 * parameters, dtype=np.int64)
    head = integers[len(FUNCTIONS) : _BEGIN].view(HEAD)[0]
    head.n_parameters = parameters
    head.n_states = states
    head.n_inputs = inputs
    return integers, np.zeros(6 * (parameters + states + inputs + 1))


@compiled(inside=True)
def machine_of(integers: Integers, floats: FloatArray) -> Machine:
    """The machine that has this memory."""
    head = integers[len(FUNCTIONS) : _BEGIN].view(HEAD)
    m = head[0].n_parameters
    n = head[0].n_states
    inputs = head[0].n_inputs
    first_given = _BEGIN + n
    first_unknown = first_given + inputs
    first_shown = first_unknown + m
    whole = m + n + inputs + 1
    return Machine(
        integers[: len(FUNCTIONS)],
        head,
        integers[_BEGIN:first_given],
        integers[first_given:first_unknown],
        integers[first_unknown:first_shown],
        integers[first_shown : first_shown + m],
        floats[:whole],
        floats[whole : 2 * whole],
        floats[2 * whole : 3 * whole],
        floats[3 * whole : 4 * whole],
        floats[4 * whole : 5 * whole],
        floats[5 * whole : 6 * whole],
    )


@compiled(inside=True)
def machine_at(integers: Any, floats: Any) -> Machine:
    """The machine whose memory begins at these pointers."""
    head = numba.carray(integers, _BEGIN)[len(FUNCTIONS) :].view(HEAD)[0]
    m = head.n_parameters
    n = head.n_states
    inputs = head.n_inputs
    return machine_of(
        numba.carray(integers, _BEGIN + n + inputs + 2 * m),
        numba.carray(floats, 6 * (m + n + inputs + 1)),
    )


@intrinsic
def _fmi(context: Any, address: Any, instance: Any, arguments: Any) -> Any:  # noqa: ARG001
    """Call a function of the FMU by its address; returns its status."""

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:  # noqa: ARG001
        passed_values = [values[1], *cgutils.unpack_tuple(builder, values[2])]
        kinds = ir.FunctionType(ir.IntType(32), [value.type for value in passed_values])
        return builder.call(
            builder.inttoptr(values[0], kinds.as_pointer()), passed_values
        )

    return types.int32(address, instance, arguments), code


@compiled(inside=True)
def _note(machine: Machine, where: int, status: int) -> None:
    if status > _WARNING and machine.head[0].status == 0:
        machine.head[0].status = status
        machine.head[0].where = where


@compiled(inside=True)
def _call(machine: Machine, function: int, arguments: Any) -> None:
    """Call a function with arguments, a tuple, after the instance."""
    _note(
        machine,
        function,
        _fmi(machine.functions[function], machine.head[0].instance, arguments),
    )


@compiled(inside=True)
def _pass(machine: Machine, function: int, values: FloatArray) -> None:
    """Call a function that reads or writes an array."""
    if values.size > 0:
        _call(machine, function, (values.ctypes.data, values.size))


@compiled(inside=True)
def _transfer(
    machine: Machine, function: int, references: int, values: FloatArray
) -> None:
    """Read or set some variables, in the FMU's units."""
    if values.size > 0:
        data = values.ctypes.data
        _call(machine, function, (references, values.size, data, values.size))


@compiled(inside=True)
def _set(machine: Machine, references: int, first: int, count: int) -> None:
    """Set some variables to their values in `held`."""
    values = np.empty(count)
    for i in range(count):
        values[i] = (
            machine.held[first + i] - machine.offsets[first + i]
        ) / machine.factors[first + i]
    _transfer(machine, SET, references, values)


@compiled(inside=True)
def _initialise(machine: Machine) -> None:
    """Initialise with the parameters and inputs that are held, for co-simulation also with the states."""
    m = machine.head[0].n_parameters
    n = machine.head[0].n_states
    if (
        machine.head[0].begun != 0
        and _fmi(machine.functions[RESET], machine.head[0].instance, ()) > _WARNING
    ):
        _note(machine, RESET, _fmi(machine.head[0].renew, machine.head[0].instance, ()))
    machine.head[0].begun = 1
    if machine.functions[SETUP] != 0:
        _call(machine, SETUP, (0, 0.0, 0.0, 0, 0.0))
    _set(machine, machine.head[0].fixed, 0, m if machine.head[0].exchange else m + n)
    _call(machine, INITIALISE, (0, 0.0, 0.0, 0, 0.0))
    _set(machine, machine.head[0].inputs, m + n, machine.head[0].n_inputs)
    _call(machine, BEGIN, ())
    if machine.head[0].exchange:
        _settle(machine)


@compiled(inside=True)
def bring(machine: Machine, z: FloatArray, d: FloatArray) -> None:
    """Bring it to parameters, states and drive, and to disturbances; a drive of NaN: as it is.

    A run continues where nothing but the inputs has changed; otherwise another one begins, with a new
    initialisation: what the FMU remembers beside its states would be that of the run before.
    """
    head = machine.head[0]
    current = machine.held
    m = head.n_parameters
    n = head.n_states
    continues = head.begun != 0
    for i in range(m + n):
        continues = continues and current[i] == z[i]
        current[i] = z[i]
    if not continues:
        head.run_time = 0.0
    changed = not continues
    for i in range(m + n, m + n + head.n_inputs):
        value = z[m + n] if i == m + n else d[machine.given[i - m - n - 1]]
        if np.isnan(value):
            value = current[i] if continues else head.rest
        changed = changed or current[i] != value
        current[i] = value
    if not continues:
        _initialise(machine)
    elif changed and not head.exchange:
        _set(machine, head.inputs, m + n, head.n_inputs)
    if changed and head.exchange:
        if not continues:
            _call(machine, SET_TIME, (0.0,))
        _set(machine, head.inputs, m + n, head.n_inputs)
        if not continues and n > 0:
            states_of_fmu = np.empty(n)
            for i in range(n):
                states_of_fmu[machine.places[i]] = (
                    z[m + i] - machine.offsets[m + i]
                ) / machine.factors[m + i]
            _pass(machine, SET_STATES, states_of_fmu)
        if head.n_indicators > 0:
            _call(machine, EVENT_MODE, ())
            _settle(machine)


@compiled(inside=True)
def output(machine: Machine) -> float:
    """The output, in the plant's unit."""
    value = np.empty(1)
    _transfer(machine, GET, machine.head[0].output, value)
    return machine.factors[-1] * value[0] + machine.offsets[-1]


@compiled(inside=True)
def advance(machine: Machine, h: float) -> None:
    """Advance it by a step, whose end is held."""
    m = machine.head[0].n_parameters
    n = machine.head[0].n_states
    states_of_fmu = np.empty(n)
    if machine.head[0].exchange:
        _integrate(machine, states_of_fmu, h)
    else:
        _step(machine, h)
        _transfer(machine, GET, machine.head[0].states, states_of_fmu)
    for i in range(n):
        value = states_of_fmu[machine.places[i]]
        machine.held[m + i] = machine.factors[m + i] * value + machine.offsets[m + i]


@compiled(inside=True)
def rates(machine: Machine, values: FloatArray) -> None:
    """The derivatives of the states of a model-exchange FMU, in the plant's units."""
    m = machine.head[0].n_parameters
    n = machine.head[0].n_states
    x = np.empty(n)
    rates_of_fmu = np.empty(n)
    _pass(machine, GET_STATES, x)
    _rates(machine, x, machine.head[0].run_time, rates_of_fmu)
    for i in range(n):
        values[i] = rates_of_fmu[machine.places[i]] * machine.factors[m + i]


@compiled(inside=True)
def _step(machine: Machine, h: float) -> None:
    """One step of the FMU's own solver."""
    flags = np.zeros(8, dtype=np.int32)
    data = flags.ctypes.data
    time = machine.head[0].run_time
    _call(machine, STEP, (time, h, 1, data, data + 8, data + 16, data + 24))
    if machine.head[0].fmi_3 and (flags[2] != 0 or flags[4] != 0):
        # it terminated, or returned early
        _note(machine, STEP, ENDED)
    machine.head[0].run_time = time + h


@compiled(inside=True)
def _integrate(machine: Machine, x: FloatArray, h: float) -> None:
    """One Runge–Kutta step of order 4, to the FMU's own states x.

    A step across a change of an event indicator's sign ends just after it, as at kinks of the native
    equations.
    """
    after = np.empty(x.size)
    signs = np.empty(machine.head[0].n_indicators)
    remaining = h
    _pass(machine, GET_STATES, x)
    for event in range(MAX_EVENTS):
        length = remaining
        step = (machine, x, machine.head[0].run_time, after, signs)
        _indicators(machine, x, machine.head[0].run_time, signs)
        if _crosses(step, remaining) and event < MAX_EVENTS - 1:
            low = 0.0
            for _ in range(BISECTIONS):
                middle = 0.5 * (low + length)
                if _crosses(step, middle):
                    length = middle
                else:
                    low = middle
            _crosses(step, length)
        machine.head[0].run_time += length
        copy_into(after, x)
        _complete(machine, x)
        remaining -= length
        if not remaining > 0.0 or machine.head[0].status != 0:
            break


@compiled(inside=True)
def _place(machine: Machine, x: FloatArray, time: float) -> None:
    _call(machine, SET_TIME, (time,))
    _pass(machine, SET_STATES, x)


@compiled(inside=True)
def _rates(machine: Machine, x: FloatArray, time: float, values: FloatArray) -> None:
    _place(machine, x, time)
    _pass(machine, RATES, values)


@compiled(inside=True)
def _runge_kutta(
    machine: Machine, x: FloatArray, t: float, h: float, after: FloatArray
) -> None:
    k = np.empty((4, x.size))
    point = x.copy()
    for stage in range(4):
        reach = h if stage == 3 else 0.5 * h
        if stage > 0:
            for i in range(x.size):
                point[i] = x[i] + reach * k[stage - 1, i]
        _rates(machine, point, t + reach if stage > 0 else t, k[stage])
    for i in range(x.size):
        after[i] = x[i] + h / 6.0 * (k[0, i] + 2.0 * k[1, i] + 2.0 * k[2, i] + k[3, i])


@compiled(inside=True)
def _indicators(
    machine: Machine, x: FloatArray, time: float, values: FloatArray
) -> None:
    if values.size > 0:
        _place(machine, x, time)
        _pass(machine, INDICATORS, values)


@compiled(inside=True)
def _crosses(step: Any, h: float) -> bool:
    """Take a step from x, to `after`; whether an event indicator has another sign there."""
    machine, x, time, after, signs = step
    _runge_kutta(machine, x, time, h, after)
    values = np.empty(signs.size)
    crossed = False
    _indicators(machine, after, time + h, values)
    for i in range(signs.size):
        crossed = crossed or (values[i] > 0.0) != (signs[i] > 0.0)
    return crossed


@compiled(inside=True)
def _complete(machine: Machine, x: FloatArray) -> None:
    """Set the states at the end of a step, handle its events, and read the states after them."""
    flags = np.zeros(4, dtype=np.int32)
    _place(machine, x, machine.head[0].run_time)
    if machine.functions[COMPLETED] != 0:
        data = flags.ctypes.data
        _call(machine, COMPLETED, (1, data, data + 4))
        if flags[1] != 0:
            _note(machine, COMPLETED, ENDED)
    if flags[0] != 0 or machine.head[0].n_indicators > 0:
        _call(machine, EVENT_MODE, ())
        _settle(machine)
        _pass(machine, GET_STATES, x)


@compiled(inside=True)
def _settle(machine: Machine) -> None:
    """Iterate over events until the discrete states stay, and continue."""
    for _ in range(MAX_ROUNDS):
        if machine.head[0].status != 0:
            return
        flags = np.zeros(16, dtype=np.int32)
        data = flags.ctypes.data
        _call(
            machine,
            UPDATE,
            (data, data + 8, data + 16, data + 24, data + 32, data + 40),
        )
        if flags[2 if machine.head[0].fmi_3 else 1] != 0:
            _note(machine, UPDATE, ENDED)
        if flags[0] == 0:
            _call(machine, CONTINUE, ())
            return
    _note(machine, UPDATE, UNSETTLED)


def error_of(machine: Machine) -> str:
    """The error of the calls since the last time, as text; empty without one. It is then forgotten."""
    status = int(machine.head[0].status)
    where = FUNCTIONS[machine.head[0].where]
    if not status:
        return ""
    machine.head[0].status = 0
    machine.held[:] = np.nan
    if status == ENDED:
        return "it terminated the simulation, or returned early"
    if status == UNSETTLED:
        return f"its discrete states do not converge in {MAX_ROUNDS} event iterations"
    name = NAMES_3.get(where, where) if machine.head[0].fmi_3 else where
    return f"its function {name} returned status {status}"
