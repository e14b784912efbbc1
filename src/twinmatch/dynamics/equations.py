"""Derivation of a plant's equations in SymPy: checked, kinks and roots resolved, symbols ordered."""

from __future__ import annotations

import ctypes
import math
import re
import threading
import traceback
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

from twinmatch.dynamics.declarations import PlantError, is_number
from twinmatch.dynamics.definition import Equations, Expression, PlantDefinition
from twinmatch.dynamics.terms import Kinks, Roots

PATIENCE: Final = 60.0
"""Time for loading a plant's file, and for one call of its equations, s. Both take well below a second, or
some seconds if the file reads a table or imports a large library."""
FUNCTIONS: Final = (
    "Abs", "Max", "Min", "Piecewise", "acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "cos",
    "cosh", "erf", "erfc", "exp", "log", "sin", "sinh", "tan", "tanh",
)  # fmt: skip
"""Functions that can be compiled together with all their derivatives."""


class TooLongError(Exception):
    """The code took longer than its limit."""


@contextmanager
def at_most(seconds: float = PATIENCE) -> Iterator[None]:
    """Raise `TooLongError` in this thread if the block takes longer.

    It interrupts Python code between two instructions, but no call that waits in C, such as `time.sleep`.
    """
    thread = ctypes.c_ulong(threading.get_ident())
    lock = threading.Lock()
    is_switched = False

    def stop() -> None:
        with lock:
            if not is_switched:
                ctypes.pythonapi.PyThreadState_SetAsyncExc(
                    thread, ctypes.py_object(TooLongError)
                )

    timer = threading.Timer(seconds, stop)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        with lock:
            is_switched = True
        timer.cancel()


@dataclass(frozen=True)
class Derived:
    """The symbols in order, and the expressions in terms of them."""

    states: tuple[Expression, ...]
    inputs: tuple[Expression, ...]
    disturbances: tuple[Expression, ...]
    parameters: tuple[Expression, ...]
    """The parameters that the equations depend on, in the order of declaration."""
    unknown: tuple[Expression, ...]
    """Those of them that tangents are computed for."""
    measured: tuple[Expression, ...]
    """Symbols of the outputs, as `start` uses them."""
    switches: tuple[Expression, ...]
    conditions: tuple[Expression, ...]
    """Condition of each switch, which is 1 where this is positive; may use earlier switches."""
    rates: tuple[Expression, ...]
    outputs: tuple[Expression, ...]
    start: tuple[Expression, ...]
    quantities: Mapping[str, Expression]


def derive(
    plant: PlantDefinition, parts: frozenset[str], unknown: frozenset[str]
) -> Derived:
    """Derive the equations of a plant with some of its parts, ready to be written as code.

    Tangents are computed for the parameters `unknown`, if the equations depend on them.

    Raises:
        PlantError: the equations cannot be used, or the output has a kink.
    """
    import sympy  # noqa: PLC0415

    title = f"plant {plant.name}"
    written = written_equations(plant, parts)
    written_outputs = outputs_of(plant, written)
    declared = {name: getattr(plant, name) for name in plant.declarations}
    states = tuple(
        declared[name] for name in plant.states if declared[name] in written.rates
    )
    measured = tuple(declared[name] for name in plant.outputs)
    kinks = Kinks()
    roots = Roots(plant)

    def smooth(expression: Expression) -> Expression:
        return roots.smooth(sympy.sympify(expression))

    rates = tuple(kinks.resolved(smooth(written.rates[state])) for state in states)
    quantities = {
        name: kinks.resolved(smooth(expression))
        for name, expression in written.quantities.items()
    }
    outputs = tuple(smooth(written_outputs[symbol]) for symbol in measured)
    start = tuple(smooth(written.start[state]) for state in states)
    for role, expressions in (("output", outputs), ("start", start)):
        if any(
            Kinks().resolved(expression) != expression for expression in expressions
        ):
            raise PlantError(
                f"{title}: the {role} has a kink; put it into the sensor or into a rate"
            )

    used: set[Any] = set()
    for expression in (*rates, *outputs, *start, *kinks.conditions):
        used |= expression.free_symbols
    parameters = tuple(
        declared[name] for name in plant.parameters if declared[name] in used
    )
    return Derived(
        states=states,
        inputs=tuple(declared[name] for name in plant.drives),
        disturbances=tuple(declared[name] for name in plant.disturbances),
        parameters=parameters,
        unknown=tuple(symbol for symbol in parameters if str(symbol) in unknown),
        measured=measured,
        switches=tuple(kinks.switches),
        conditions=tuple(kinks.conditions),
        rates=rates,
        outputs=outputs,
        start=start,
        quantities=quantities,
    )


def outputs_of(
    plant: PlantDefinition, written: Equations
) -> dict[Expression, Expression]:
    """The expression of each output.

    Raises:
        PlantError: there is not one for each.
    """
    symbols = [getattr(plant, name) for name in plant.outputs]
    if not isinstance(written.output, Mapping):
        if len(symbols) == 1:
            return {symbols[0]: written.output}
        raise PlantError(
            f"plant {plant.name}: it has {len(symbols)} outputs; write `output` as a dictionary, "
            f"{{{', '.join(f'self.{symbol}: …' for symbol in symbols)}}}"
        )
    for symbol in (*symbols, *written.output):
        if symbol not in written.output or symbol not in symbols:
            todo = (
                "has no expression"
                if symbol in symbols
                else "is not declared as an output"
            )
            raise PlantError(f"plant {plant.name}: in `output`, {symbol} {todo}")
    return dict(written.output)


def written_equations(plant: PlantDefinition, parts: frozenset[str]) -> Equations:
    """Call the plant's `equations`.

    Raises:
        PlantError: a mistake in it, with file and line, or a result that cannot be used.
    """
    try:
        with at_most():
            written = plant.equations(parts)
    except PlantError:
        raise
    except BaseException as error:
        if is_interrupt(error):
            raise
        lines = [
            f
            for f in traceback.extract_tb(error.__traceback__)
            if f.name == "equations"
        ]
        place = f", {lines[-1].filename}, line {lines[-1].lineno}" if lines else ""
        raise PlantError(
            f"plant {plant.name}{place}: {_mistake(plant, error)}"
        ) from error
    if not isinstance(written, Equations):
        kind = type(written).__name__
        msg = f"plant {plant.name}: its method `equations` returns {kind}; return Equations(rates=…, …)"
        raise PlantError(msg)
    _require_usable(plant, written)
    return written


def _mistake(plant: PlantDefinition, error: BaseException) -> str:
    if isinstance(error, AttributeError) and error.obj is plant:
        import difflib  # noqa: PLC0415

        near = difflib.get_close_matches(error.name or "", plant.declarations, n=1)
        hint = (
            f"did you mean {near[0]}?"
            if near
            else "declare it as a State, Parameter or Disturbance"
        )
        return f"self.{error.name} is not declared; {hint}"
    if isinstance(error, TypeError) and "truth value" in str(error):
        return "equations cannot branch on a value; use limited, minimum or maximum instead"
    if isinstance(error, TypeError) and re.search(
        "to float|to int|loop of ufunc|round symbolic", str(error)
    ):
        return "a function of numbers (of math or numpy, float, round) is given an expression; use SymPy's"
    if isinstance(error, TooLongError):
        return f"`equations` did not return within {PATIENCE:g} s; look for a loop without end"
    return error_words(error)


def is_interrupt(error: BaseException) -> bool:
    """Whether Ctrl-C ended the code of a plant's file; every other error is a mistake in it."""
    return type(error) is KeyboardInterrupt


def error_words(error: BaseException) -> str:
    """A Python error in a plant's file, in one line."""
    if isinstance(error, OverflowError):
        return "a number is too large for floating point; give one below 1e308"
    try:
        text = " ".join(str(error).replace(".__init__()", "()").split())
    except Exception:  # the file's own class of errors may have a mistake in its text
        text = ""
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _require_usable(plant: PlantDefinition, written: Equations) -> None:
    """Check that the equations are finite expressions of quantities that may occur in them.

    Raises:
        PlantError: a state without rate or start, something that is not an expression, an undeclared quantity
            or one in the wrong place, a function that cannot be compiled.
    """
    # a decorated method may have none
    code = getattr(plant.equations, "__code__", None)
    place = "" if code is None else f", {code.co_filename}, line {code.co_firstlineno}"
    title = f"plant {plant.name}{place}"
    for name in ("rates", "start", "quantities"):
        if not isinstance(getattr(written, name), Mapping):
            kind = type(getattr(written, name)).__name__
            raise PlantError(
                f"{title}: `{name}` is of type {kind}; write a dictionary, {{…: …}}"
            )
    declared = {name: getattr(plant, name) for name in plant.declarations}
    declared_states = [declared[name] for name in plant.states]
    states = _require_states(title, declared_states, written)
    measured_or_constant = {
        declared[name] for name in (*plant.disturbances, *plant.parameters)
    }
    drives = {declared[name] for name in plant.drives}
    measured = {declared[name] for name in plant.outputs}
    usable = {*states, *measured_or_constant}
    for state in states:
        _require(
            f"{title}: the rate of {state}",
            written.rates[state],
            usable | drives,
            declared,
        )
        _require(
            f"{title}: the start of {state}",
            written.start[state],
            measured_or_constant | drives | measured,
            declared,
        )
    for symbol, expression in outputs_of(plant, written).items():
        name = "the output" if len(measured) == 1 else f"the output {symbol}"
        _require(f"{title}: {name}", expression, usable | drives, declared)
        if not _symbols(expression) & set(states):
            raise PlantError(
                f"{title}: {name} depends on no state; write it in terms of the states"
            )
    for name, expression in written.quantities.items():
        _require(f"{title}: the quantity {name}", expression, usable | drives, declared)


def _require_states(title: str, declared: list[Any], written: Equations) -> list[Any]:
    """The states that have a rate; each needs a start."""
    for name in ("rates", "start"):
        for symbol in getattr(written, name):
            if symbol not in declared:
                shown = repr(symbol) if isinstance(symbol, str) else str(symbol)
                todo = (
                    f"write self.{symbol}"
                    if symbol in map(str, declared)
                    else "declare it"
                )
                raise PlantError(
                    f"{title}: `{name}` has {shown}, which is not declared as a state; {todo}"
                )
    states = [state for state in declared if state in written.rates]
    if not states:
        raise PlantError(
            f"{title}: no state has a rate; a plant without memory needs no twin"
        )
    for state in states:
        if state not in written.start:
            raise PlantError(
                f"{title}: state {state} has no start value; give one in `start`"
            )
    return states


def _require(
    place: str, expression: Any, allowed: Iterable[Any], declared: Mapping[str, Any]
) -> None:
    import sympy  # noqa: PLC0415

    if not isinstance(expression, sympy.Expr | int | float) or isinstance(
        expression, bool
    ):
        kind = (
            "a condition"
            if isinstance(expression, sympy.logic.boolalg.Boolean)
            else _kind(expression)
        )
        raise PlantError(
            f"{place} is {kind}; write an expression of the plant's quantities"
        )
    formula = sympy.sympify(expression)
    if formula.has(sympy.nan, sympy.zoo, sympy.oo, -sympy.oo):
        raise PlantError(
            f"{place} is not finite ({_short(formula)}): it divides by zero, or contains NaN"
        )
    if formula.has(sympy.I):
        raise PlantError(
            f"{place} is complex ({_short(formula)}); write it with real quantities"
        )
    if not all(map(_fits, formula.atoms(sympy.Number))):
        raise PlantError(
            f"{place} has a number that is too large for floating point; give one below 1e308"
        )
    for part in sympy.preorder_traversal(formula):
        if isinstance(part, sympy.Function | sympy.Derivative | sympy.Integral):
            name = type(part).__name__
            if name not in FUNCTIONS:
                msg = f"{place} uses {name}, which cannot be compiled; use only {', '.join(FUNCTIONS)}"
                raise PlantError(msg)
    for symbol in sorted(formula.free_symbols - set(allowed), key=str):
        if symbol not in declared.values():
            raise PlantError(
                f"{place} uses {str(symbol)!r}, which is not declared; declare it"
            )
        raise PlantError(f"{place} uses {symbol}, which {_reason(place)}")


def _fits(number: Any) -> bool:
    """Whether floating point holds a number of SymPy; of a fraction, both its parts."""
    if number.is_Rational:
        return is_number(number.p) and is_number(number.q)
    return math.isfinite(float(number))


def _reason(place: str) -> str:
    """Why a declared quantity cannot be used there."""
    if ": the start of" in place:
        return "is not known before the first sample; use the output, the drive, disturbances and parameters"
    return "is the output or a state without a rate; use a state, or give it a rate"


def _symbols(expression: Any) -> set[Any]:
    return set(getattr(expression, "free_symbols", ()))


def _kind(value: Any) -> str:
    return (
        "missing (None)"
        if value is None
        else f"{value!r}, of type {type(value).__name__}"
    )


def _short(expression: Any) -> str:
    text = str(expression)
    return text if len(text) <= 60 else f"{text[:57]}…"
