"""Checks of what a plant's `equations` returns, before anything is derived from it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final

from twinmatch.dynamics.errors import PlantError

if TYPE_CHECKING:
    from twinmatch.dynamics.equations import Equations
    from twinmatch.dynamics.plant import Plant

__all__ = ["require_usable"]

_FUNCTIONS: Final = (
    "Abs", "Max", "Min", "Piecewise", "acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "cos",
    "cosh", "erf", "erfc", "exp", "log", "sin", "sinh", "tan", "tanh",
)  # fmt: skip
"""Functions that can be compiled together with all their derivatives."""


def require_usable(plant: Plant, written: Equations) -> None:
    """Check that the equations are finite expressions of quantities that may occur in them.

    Raises:
        PlantError: a state without rate or start, something that is not an expression, an undeclared quantity
            or one in the wrong place, a function that cannot be compiled.
    """
    title = f"plant {plant.name}"
    for name in ("rates", "start", "quantities"):
        if not isinstance(getattr(written, name), Mapping):
            kind = type(getattr(written, name)).__name__
            raise PlantError(f"{title}: `{name}` is of type {kind}; write a dictionary, {{…: …}}")
    declared = {name: getattr(plant, name) for name in plant.declarations}
    every = [declared[name] for name in plant.states]
    states = _require_states(title, every, written)
    inputs = {declared[name] for name in (*plant.disturbances, *plant.parameters)}
    drive, measured = declared[plant.drive.name], declared[plant.output.name]
    known = {*states, *inputs}
    for state in states:
        _require(f"{title}: the rate of {state}", written.rates[state], {*known, drive}, declared)
        _require(f"{title}: the start of {state}", written.start[state], {*inputs, drive, measured}, declared)
    if _symbols(written.output) & {drive}:
        msg = (
            f"{title}: the output depends on the drive at the same instant; add a state between, or declare "
            "a disturbance, map the drive's column to it too, and use it in the output"
        )
        raise PlantError(msg)
    _require(f"{title}: the output", written.output, known, declared)
    if not _symbols(written.output) & set(states):
        raise PlantError(f"{title}: the output depends on no state; write it in terms of the states")
    for name, expression in written.quantities.items():
        _require(f"{title}: the quantity {name}", expression, {*known, drive}, declared)


def _require_states(title: str, declared: list[Any], written: Equations) -> list[Any]:
    """The states that have a rate; each needs a start."""
    for name in ("rates", "start"):
        for symbol in getattr(written, name):
            if symbol not in declared:
                shown = repr(symbol) if isinstance(symbol, str) else str(symbol)
                todo = f"write self.{symbol}" if symbol in map(str, declared) else "declare it"
                msg = f"{title}: `{name}` has {shown}, which is not declared as a state; {todo}"
                raise PlantError(msg)
    states = [state for state in declared if state in written.rates]
    if not states:
        raise PlantError(f"{title}: no state has a rate; a plant without memory needs no twin")
    for state in states:
        if state not in written.start:
            raise PlantError(f"{title}: state {state} has no start value; give one in `start`")
    return states


def _require(place: str, expression: Any, allowed: Iterable[Any], declared: Mapping[str, Any]) -> None:
    import sympy  # noqa: PLC0415 (slow; needed only to derive equations)

    if not isinstance(expression, sympy.Expr | int | float) or isinstance(expression, bool):
        kind = "a condition" if isinstance(expression, sympy.logic.boolalg.Boolean) else _kind(expression)
        raise PlantError(f"{place} is {kind}; write an expression of the plant's quantities")
    found = sympy.sympify(expression)
    if found.has(sympy.nan, sympy.zoo, sympy.oo, -sympy.oo):
        raise PlantError(f"{place} is not finite ({_short(found)}): it divides by zero, or contains NaN")
    if found.has(sympy.I):
        raise PlantError(f"{place} is complex ({_short(found)}); write it with real quantities")
    for part in sympy.preorder_traversal(found):
        if isinstance(part, sympy.Function | sympy.Derivative | sympy.Integral):
            name = type(part).__name__
            if name not in _FUNCTIONS:
                msg = f"{place} uses {name}, which cannot be compiled; use only {', '.join(_FUNCTIONS)}"
                raise PlantError(msg)
    for symbol in sorted(found.free_symbols - set(allowed), key=str):
        if symbol not in declared.values():
            raise PlantError(f"{place} uses {str(symbol)!r}, which is not declared; declare it")
        raise PlantError(f"{place} uses {symbol}, which {_reason(place)}")


def _reason(place: str) -> str:
    """Why a declared quantity cannot be used there."""
    if ": the start of" in place:
        return "is not known before the first sample; use the output, the drive, disturbances and parameters"
    return "is the output or a state without a rate; use a state, or give it a rate"


def _symbols(expression: Any) -> set[Any]:
    return set(getattr(expression, "free_symbols", ()))


def _kind(value: Any) -> str:
    return "missing (None)" if value is None else f"{value!r}, of type {type(value).__name__}"


def _short(expression: Any) -> str:
    text = str(expression)
    return text if len(text) <= 60 else f"{text[:57]}…"
