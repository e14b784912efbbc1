"""Derivation of a plant's equations in SymPy: kinks resolved, symbols ordered, mistakes reported.

Kinks (`Min`, `Max`, `Abs`, `Piecewise` with inequalities) are resolved first. Each becomes a *switch*, a
symbol that is 1 or 0, and a *condition*, the expression whose sign it follows; both branches then appear in
the equations, weighted by the switch and one minus it. With constant switches a plant is smooth: its
derivatives are those of the active branch, and an integrator can step exactly to the moment a condition
changes sign. The equations must be continuous there, like those of a limiter.
"""

from __future__ import annotations

import difflib
import re
import traceback
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from twinmatch.dynamics.errors import PlantError
from twinmatch.dynamics.patience import PATIENCE, TooLongError, at_most
from twinmatch.dynamics.returned import require_usable
from twinmatch.dynamics.roots import Roots

if TYPE_CHECKING:
    from twinmatch.dynamics.plant import Plant

__all__ = ["Derived", "Equations", "derive", "error_words", "written_equations"]

Expression = Any
"""A SymPy expression; SymPy has no types of its own for mypy."""


@dataclass(frozen=True)
class Equations:
    """The return value of a plant's `equations`."""

    rates: Mapping[Expression, Expression]
    """Time derivative of each state that the structure has, in its unit per second."""
    output: Expression
    """The quantity that the sensor measures; a smooth function of states and parameters."""
    start: Mapping[Expression, Expression]
    """Initial value of each state, from the output, the drive until then, disturbances and parameters."""
    quantities: Mapping[str, Expression] = field(default_factory=dict)
    """Other quantities of interest, by name: currents, heat flows."""


@dataclass(frozen=True)
class Derived:
    """The symbols in order, and the expressions in terms of them."""

    states: tuple[Expression, ...]
    drive: Expression
    disturbances: tuple[Expression, ...]
    parameters: tuple[Expression, ...]
    """The parameters that the equations depend on, in the order of declaration."""
    unknown: tuple[Expression, ...]
    """Those of them that tangents are computed for."""
    measured: Expression
    """Symbol of the output, as `start` uses it."""
    switches: tuple[Expression, ...]
    conditions: tuple[Expression, ...]
    """Condition of each switch, which is 1 where this is positive; may use earlier switches."""
    rates: tuple[Expression, ...]
    output: Expression
    start: tuple[Expression, ...]
    quantities: Mapping[str, Expression]

    @property
    def n_states(self) -> int:
        """Number of states."""
        return len(self.states)


def derive(plant: Plant, parts: frozenset[str], unknown: frozenset[str]) -> Derived:
    """Derive the equations of a plant with some of its parts, ready to be written as code.

    Tangents are computed for the parameters `unknown`, if the equations depend on them.

    Raises:
        PlantError: the equations cannot be used, or the output has a kink.
    """
    import sympy  # noqa: PLC0415

    title = f"plant {plant.name}"
    written = written_equations(plant, parts)
    declared = {name: getattr(plant, name) for name in plant.declarations}
    states = tuple(declared[name] for name in plant.states if declared[name] in written.rates)
    drive, measured = declared[plant.drive.name], declared[plant.output.name]
    disturbances = tuple(declared[name] for name in plant.disturbances)

    kinks, roots = _Kinks(), Roots(plant)
    rates = tuple(kinks.resolved(roots.smooth(sympy.sympify(written.rates[s]))) for s in states)
    quantities = {
        name: kinks.resolved(roots.smooth(sympy.sympify(e))) for name, e in written.quantities.items()
    }
    output = roots.smooth(sympy.sympify(written.output))
    start = tuple(roots.smooth(sympy.sympify(written.start[s])) for s in states)
    for what, expressions in (("output", [output]), ("start", start)):
        if any(_Kinks().resolved(expression) != expression for expression in expressions):
            raise PlantError(f"{title}: the {what} has a kink; put it into the sensor or into a rate")

    used = set().union(*(e.free_symbols for e in (*rates, output, *start, *kinks.conditions)))
    parameters = tuple(declared[name] for name in plant.parameters if declared[name] in used)
    return Derived(
        states, drive, disturbances, parameters, tuple(s for s in parameters if str(s) in unknown), measured,
        tuple(kinks.switches), tuple(kinks.conditions), rates, output, start, quantities,
    )  # fmt: skip


def written_equations(plant: Plant, parts: frozenset[str]) -> Equations:
    """Call the plant's `equations`.

    Raises:
        PlantError: a mistake in it, with file and line, or a result that cannot be used.
    """
    try:
        with at_most():
            written = plant.equations(parts)
    except PlantError:
        raise
    except (Exception, SystemExit) as error:
        lines = [f for f in traceback.extract_tb(error.__traceback__) if f.name == "equations"]
        place = f", {lines[-1].filename}, line {lines[-1].lineno}" if lines else ""
        msg = f"plant {plant.name}{place}: {_mistake(plant, error)}"
        raise PlantError(msg) from error
    if not isinstance(written, Equations):
        kind = type(written).__name__
        msg = f"plant {plant.name}: its method `equations` returns {kind}; return Equations(rates=…, …)"
        raise PlantError(msg)
    require_usable(plant, written)
    return written


def _mistake(plant: Plant, error: BaseException) -> str:
    if isinstance(error, AttributeError) and error.obj is plant:
        near = difflib.get_close_matches(error.name or "", plant.declarations, n=1)
        hint = f"did you mean {near[0]}?" if near else "declare it as a State, Parameter or Disturbance"
        return f"self.{error.name} is not declared; {hint}"
    if isinstance(error, TypeError) and "truth value" in str(error):
        return "equations cannot branch on a value; use limited, minimum or maximum instead"
    if isinstance(error, TypeError) and re.search("to float|to int|loop of ufunc|round symbolic", str(error)):
        return "a function of numbers (of math or numpy, float, round) is given an expression; use SymPy's"
    if isinstance(error, TooLongError):
        return f"`equations` did not return within {PATIENCE:g} s; look for a loop without end"
    return error_words(error)


def error_words(error: BaseException) -> str:
    """A Python error in a plant's file, in one line."""
    text = " ".join(str(error).replace(".__init__()", "()").split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


class _Kinks:
    """Replaces kinks by switches, innermost first, and collects their conditions."""

    def __init__(self) -> None:
        self.switches: list[Expression] = []
        self.conditions: list[Expression] = []

    def resolved(self, expression: Expression) -> Expression:
        """The expression with kinks replaced by switches."""
        import sympy  # noqa: PLC0415

        if not expression.args:
            return expression
        if isinstance(expression, sympy.Piecewise):
            return self._pieces(expression)
        args = [self.resolved(a) for a in expression.args]
        if isinstance(expression, sympy.Abs):
            switch = self._switch(args[0])
            return args[0] * (2 * switch - 1)
        if isinstance(expression, sympy.Max | sympy.Min):
            result = args[0]
            for other in args[1:]:
                sign = 1 if isinstance(expression, sympy.Max) else -1
                switch = self._switch(sign * (result - other))
                result = switch * result + (1 - switch) * other
            return result
        return expression.func(*args)

    def _pieces(self, expression: Expression) -> Expression:
        import sympy  # noqa: PLC0415

        pieces = list(expression.args)
        if pieces[-1][1] is not sympy.true:
            msg = f"plant: {expression} has no value elsewhere; give its last piece the condition True"
            raise PlantError(msg)
        result = self.resolved(pieces[-1][0])
        for value, condition in reversed(pieces[:-1]):
            if not isinstance(condition, sympy.StrictGreaterThan | sympy.GreaterThan):
                if not isinstance(condition, sympy.StrictLessThan | sympy.LessThan):
                    msg = f"plant: the condition {condition} of a Piecewise is not a single inequality"
                    raise PlantError(msg)
                condition = condition.reversed  # noqa: PLW2901
            switch = self._switch(self.resolved(condition.lhs - condition.rhs))
            result = switch * self.resolved(value) + (1 - switch) * result
        return result

    def _switch(self, condition: Expression) -> Expression:
        import sympy  # noqa: PLC0415

        if condition in self.conditions:
            return self.switches[self.conditions.index(condition)]
        switch = sympy.Symbol(f"switch {len(self.switches)}", real=True)  # not the name of a quantity
        self.switches.append(switch)
        self.conditions.append(condition)
        return switch
