"""Derived equations as formulas over numbered values, ready to be compiled.

Expressions of the parameters alone are computed once per run and become constants; common subexpressions
are computed once per call.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from twinmatch.dynamics.definition import Expression
from twinmatch.dynamics.equations import Derived


class Formulas(NamedTuple):
    """Expressions that are computed together, as syntax trees of Python's arithmetic.

    They use the values x (states), u (inputs), d (disturbances), p (parameters), c (constants), b (switches)
    and y (readings), each followed by its index, and the common subexpressions.
    """

    common: tuple[tuple[str, ast.expr], ...]
    """Name and value of each common subexpression, in an order in which they can be computed."""
    results: tuple[ast.expr, ...]


class PlantFormulas(NamedTuple):
    """All formulas of one plant in one structure, with n states, m inputs, o outputs and q unknowns."""

    n_states: int
    n_inputs: int
    n_outputs: int
    n_parameters: int
    n_unknown: int
    constants: Formulas
    switches: Formulas
    """Each is on where its result is positive; may use earlier switches."""
    rates: Formulas
    slopes: Formulas
    """Derivatives of the rates by the unknowns (n × q), then the rates again, their derivatives by the states
    (n × n) and by the inputs (n × m)."""
    outputs: Formulas
    output_slopes: Formulas
    """By the states (o × n), then by the unknowns (o × q), then by the inputs (o × m)."""
    start: Formulas
    start_slopes: Formulas
    """By the readings (n × o), then by the unknowns (n × q)."""
    quantities: Formulas


def plant_formulas(derived: Derived) -> PlantFormulas:
    """The formulas of derived equations, with exact derivatives."""
    writer = _Writer(derived)
    by_state = _derivatives(derived.rates, derived.states)
    by_input = _derivatives(derived.rates, derived.inputs)
    by_unknown = _derivatives(derived.rates, derived.unknown)
    output_slopes = [
        *_derivatives(derived.outputs, derived.states),
        *_derivatives(derived.outputs, derived.unknown),
        *_derivatives(derived.outputs, derived.inputs),
    ]
    start_slopes = [
        *_derivatives(derived.start, derived.measured),
        *_derivatives(derived.start, derived.unknown),
    ]
    return PlantFormulas(
        n_states=len(derived.states),
        n_inputs=len(derived.inputs),
        n_outputs=len(derived.outputs),
        n_parameters=len(derived.parameters),
        n_unknown=len(derived.unknown),
        rates=writer.formulas(derived.rates),
        slopes=writer.formulas([*by_unknown, *derived.rates, *by_state, *by_input]),
        outputs=writer.formulas(derived.outputs),
        output_slopes=writer.formulas(output_slopes),
        start=writer.formulas(derived.start),
        start_slopes=writer.formulas(start_slopes),
        quantities=writer.formulas(derived.quantities.values()),
        switches=writer.formulas(derived.conditions, shared=False),
        constants=writer.constants(),  # the last, when all are known
    )


def _derivatives(
    expressions: Iterable[Expression], symbols: Sequence[Expression]
) -> list[Expression]:
    """Of each expression by each symbol, row by row."""
    return [expression.diff(symbol) for expression in expressions for symbol in symbols]


class _Writer:
    def __init__(self, derived: Derived) -> None:
        import sympy  # noqa: PLC0415
        from sympy.printing.pycode import PythonCodePrinter  # noqa: PLC0415

        self._sympy = sympy
        self._printer = PythonCodePrinter({"fully_qualified_modules": True})
        self._constants: dict[Expression, Expression] = {}
        symbols_of_kinds = {
            "x": derived.states,
            "u": derived.inputs,
            "d": derived.disturbances,
            "p": derived.parameters,
            "b": derived.switches,
            "y": derived.measured,
        }
        self._names = {}
        for kind, symbols in symbols_of_kinds.items():
            for i, symbol in enumerate(symbols):
                self._names[symbol] = sympy.Symbol(f"{kind}{i}", real=True)

    def formulas(
        self, expressions: Iterable[Expression], *, shared: bool = True
    ) -> Formulas:
        """The formulas of expressions in the plant's symbols; common subexpressions apart if `shared`."""
        named = [
            self._with_constants(self._sympy.sympify(e).xreplace(self._names))
            for e in expressions
        ]
        return (
            self._written(named)
            if shared
            else Formulas((), tuple(map(self._tree, named)))
        )

    def constants(self) -> Formulas:
        """The formulas of all constants used so far."""
        return self._written(list(self._constants))

    def _written(self, expressions: list[Expression]) -> Formulas:
        common, reduced = self._sympy.cse(
            expressions, symbols=self._sympy.numbered_symbols("t"), order="none"
        )
        return Formulas(
            tuple((str(name), self._tree(e)) for name, e in common),
            tuple(map(self._tree, reduced)),
        )

    def _tree(self, expression: Expression) -> ast.expr:
        text: str = self._printer.doprint(expression)
        return ast.parse(text, mode="eval").body

    def _with_constants(self, expression: Expression) -> Expression:
        """The expression with every part that depends on parameters alone replaced by a constant."""
        free = expression.free_symbols
        if not free or expression.is_Symbol:
            return expression
        if all(str(s).startswith("p") for s in free):
            if expression not in self._constants:
                self._constants[expression] = self._sympy.Symbol(
                    f"c{len(self._constants)}", real=True
                )
            return self._constants[expression]
        if expression.is_Add or expression.is_Mul:
            fixed = [
                a
                for a in expression.args
                if all(str(s).startswith("p") for s in a.free_symbols)
            ]
            varying = [
                self._with_constants(a) for a in expression.args if a not in fixed
            ]
            if fixed:
                varying.append(self._with_constants(expression.func(*fixed)))
            return expression.func(*varying)
        return expression.func(*(self._with_constants(a) for a in expression.args))
