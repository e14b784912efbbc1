"""Writes derived equations as Python source, in the form of `derived.py`.

Expressions of the parameters alone are computed once per run and kept in an array of constants; common
subexpressions are computed once per call.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from twinmatch.dynamics.equations import Derived

__all__ = ["derived_source"]

Expression = Any


def derived_source(derived: Derived) -> str:
    """The source text that replaces `derived.py` in the kernels of this plant."""
    return _Writer(derived).text()


class _Writer:
    def __init__(self, derived: Derived) -> None:
        import sympy  # noqa: PLC0415
        from sympy.printing.pycode import PythonCodePrinter  # noqa: PLC0415

        self._sympy = sympy
        self._printer = PythonCodePrinter({"fully_qualified_modules": True})
        self._derived = derived
        self._names: dict[Expression, Expression] = {}
        self._places: dict[str, str] = {}
        for array, symbols in (
            ("x", derived.states),
            ("d", derived.disturbances),
            ("p", derived.parameters),
            ("b", derived.switches),
        ):
            for i, symbol in enumerate(symbols):
                self._name(symbol, f"{array}{i}", f"{array}[{i}]")
        self._name(derived.drive, "u", "")
        self._name(derived.measured, "y", "")
        self._constants: dict[Expression, Expression] = {}

    def _name(self, symbol: Expression, name: str, place: str) -> None:
        self._names[symbol] = self._sympy.Symbol(name, real=True)
        self._places[name] = place

    def text(self) -> str:
        """All functions; `prepare` is written last, when its constants are known."""
        d = self._derived
        rates = list(d.rates)
        by_state = [e.diff(s) for e in d.rates for s in d.states]
        by_drive = [e.diff(d.drive) for e in d.rates]
        by_parameter = {
            f"fp[stage, {i}, {j}]": e.diff(s) for i, e in enumerate(d.rates) for j, s in enumerate(d.unknown)
        }
        start_slopes = {f"xy[{i}]": e.diff(d.measured) for i, e in enumerate(d.start)}
        start_slopes |= {
            f"xp[{i}, {j}]": e.diff(s) for i, e in enumerate(d.start) for j, s in enumerate(d.unknown)
        }
        n, known = len(d.states), "x, u, d, p, c, b"
        functions = [
            self._row(),
            self._function(f"rates({known})", {}, [rates]),
            self._function(
                f"rates_and_slopes({known}, fp, stage)", by_parameter, [rates, by_state, by_drive]
            ),
            self._function("output(x, d, p, c)", {}, d.output),
            self._function(
                "output_slopes(x, d, p, c, hx, hp)",
                {f"hx[{j}]": d.output.diff(s) for j, s in enumerate(d.states)}
                | {f"hp[{j}]": d.output.diff(s) for j, s in enumerate(d.unknown)},
            ),
            self._function("start(y, u, d, p, c, x)", {f"x[{i}]": e for i, e in enumerate(d.start)}),
            self._function("start_slopes(y, u, d, p, c, xy, xp)", start_slopes),
            self._function(
                f"quantities({known}, q)", {f"q[{i}]": e for i, e in enumerate(d.quantities.values())}
            ),
            self._switches(),
            _tuple_functions(n, len(d.switches), len(d.parameters)),
            self._tangents(by_state, by_drive),
        ]
        functions.append(self._function("prepare(p)", {}, [list(self._constants)], keep=False))
        counts = {
            "N_STATES": n,
            "N_UNKNOWN": len(d.unknown),
            "N_QUANTITIES": len(d.quantities),
            "N_SWITCHES": len(d.switches),
        }
        head = "\n".join(f"{name} = {value}" for name, value in counts.items())
        return head + "\n\n\n" + "\n\n\n".join(functions)

    def _row(self) -> str:
        row = _tuple(f"disturbances[k, {i}]" for i in range(len(self._derived.disturbances)))
        return f"@compiled(innermost=True)\ndef row(disturbances, k):\n    return {row}"

    def _switches(self) -> str:
        """The function that sets the switches in order: a condition may use earlier switches."""
        lines = ["@compiled(innermost=True)", "def switches(x, u, d, p, c):"]
        conditions = [self._with_constants(e.xreplace(self._names)) for e in self._derived.conditions]
        used = set().union(*(e.free_symbols for e in conditions)) if conditions else set()
        lines += self._loads(s for s in used if not str(s).startswith("b"))
        for i, condition in enumerate(conditions):
            lines.append(f"    b{i} = 1.0 if {self._printer.doprint(condition)} > 0.0 else 0.0")
        lines.append(f"    return {_tuple(f'b{i}' for i in range(len(conditions)))}")
        return "\n".join(lines)

    def _tangents(self, by_state: Sequence[Expression], by_drive: Sequence[Expression]) -> str:
        """The Runge–Kutta step of every column of derivatives, without terms that are always zero."""
        n = self._derived.n_states
        depends = [any(e.diff(s) != 0 for s in self._derived.unknown) for e in self._derived.rates]
        text = [
            "@compiled(innermost=True)",
            "def tangents(columns, du, fp, which, h, fx1, fu1, fx2, fu2, fx3, fu3, fx4, fu4):",
        ]
        for columns, with_parameter in (("which.size", True), ("du.size", False)):
            first = "" if with_parameter else "which.size, "
            text.append(f"    for j in range({first}{columns}):")
            text.append("        g = du[j]")
            if with_parameter:
                text.append("        q = which[j]")
            text += [f"        t{i} = columns[{i}, j]" for i in range(n)]
            for stage in range(1, 5):
                for i in range(n):
                    terms = []
                    for m in range(n):
                        if by_state[i * n + m] != 0:
                            at = f"t{m}" if stage == 1 else f"s{m}_{stage}"
                            terms.append(f"fx{stage}[{i * n + m}] * {at}")
                    if by_drive[i] != 0:
                        terms.append(f"fu{stage}[{i}] * g")
                    if with_parameter and depends[i]:
                        terms.append(f"fp[{stage - 1}, {i}, q]")
                    text.append(f"        r{i}_{stage} = {' + '.join(terms) or '0.0'}")
                if stage < 4:
                    step = "0.5 * h" if stage < 3 else "h"
                    text += [f"        s{i}_{stage + 1} = t{i} + {step} * r{i}_{stage}" for i in range(n)]
            text += [
                f"        columns[{i}, j] = t{i} + h / 6.0 * (r{i}_1 + 2.0 * r{i}_2 + 2.0 * r{i}_3 + r{i}_4)"
                for i in range(n)
            ]
        return "\n".join(text)

    def _function(
        self,
        head: str,
        targets: Mapping[str, Expression],
        returned: Expression | None = None,
        *,
        keep: bool = True,
    ) -> str:
        """A function that assigns to its targets, except those always zero, and returns expressions.

        `returned` is one expression, or a list of lists, each of which becomes a tuple.
        """
        groups = returned if isinstance(returned, list) else [] if returned is None else [[returned]]
        results = [e for group in groups for e in group]
        places = [t for t, e in targets.items() if e != 0]
        expressions = [targets[t] for t in places] + [self._sympy.sympify(e) for e in results]
        if keep:
            expressions = [self._with_constants(e.xreplace(self._names)) for e in expressions]
        common, reduced = self._sympy.cse(
            expressions, symbols=self._sympy.numbered_symbols("t"), order="none"
        )
        used = set().union(*(e.free_symbols for e in expressions)) if expressions else set()
        lines = ["@compiled(innermost=True)", f"def {head}:", *self._loads(used)]
        lines += [f"    {name} = {self._printer.doprint(e)}" for name, e in common]
        codes = [self._printer.doprint(e if e.free_symbols else self._sympy.Float(e)) for e in reduced]
        for place, code in zip(places, codes, strict=False):
            lines.append(f"    {self._places.get(place, place)} = {code}")
        rest = codes[len(places) :]
        if isinstance(returned, list):
            tuples = []
            for group in groups:
                tuples.append(_tuple(rest[: len(group)]))
                rest = rest[len(group) :]
            lines.append(f"    return {', '.join(tuples)}")
        elif rest:
            lines.append(f"    return {rest[0]}")
        if len(lines) == 2:
            lines.append("    pass")
        return "\n".join(lines)

    def _loads(self, used: Iterable[Expression]) -> list[str]:
        lines = []
        for name in sorted(map(str, used)):
            place = self._places.get(name, "")
            if place:
                lines.append(f"    {name} = {place}")
        return lines

    def _with_constants(self, expression: Expression) -> Expression:
        """The expression with every part that depends on parameters alone replaced by a constant."""
        free = expression.free_symbols
        if not free or expression.is_Symbol:
            return expression
        if all(str(s).startswith("p") for s in free):
            if expression not in self._constants:
                constant = self._sympy.Symbol(f"c{len(self._constants)}", real=True)
                self._places[str(constant)] = f"c[{len(self._constants)}]"
                self._constants[expression] = constant
            return self._constants[expression]
        if expression.is_Add or expression.is_Mul:
            fixed = [a for a in expression.args if all(str(s).startswith("p") for s in a.free_symbols)]
            varying = [self._with_constants(a) for a in expression.args if a not in fixed]
            if fixed:
                varying.append(self._with_constants(expression.func(*fixed)))
            return expression.func(*varying)
        return expression.func(*(self._with_constants(a) for a in expression.args))


def _tuple(entries: Iterable[str]) -> str:
    listed = list(entries)
    return f"({', '.join(listed)}{',' if len(listed) == 1 else ''})"


def _tuple_functions(n: int, switches: int, parameters: int) -> str:
    """The functions on tuples of states, written out because numba does not unroll loops over tuples."""
    packed = _tuple(f"array[{i}]" for i in range(n))
    shifted = _tuple(f"x[{i}] + h * k[{i}]" for i in range(n))
    weighed = "k1[{0}] + 2.0 * k2[{0}] + 2.0 * k3[{0}] + k4[{0}]"
    combined = _tuple(f"x[{i}] + h / 6.0 * ({weighed.format(i)})" for i in range(n))
    sides = _tuple(f"float(code >> {i} & 1)" for i in range(switches))
    values = _tuple(f"vector[{i}]" for i in range(parameters))
    unpacked = "\n".join(f"    array[{i}] = x[{i}]" for i in range(n))
    lines = [
        "@compiled(innermost=True)\ndef parameters(vector):\n    return " + values,
        "@compiled(innermost=True)\ndef branch(code):\n    return " + sides,
        "@compiled(innermost=True)\ndef packed(array):\n    return " + packed,
        "@compiled(innermost=True)\ndef shifted(x, k, h):\n    return " + shifted,
        "@compiled(innermost=True)\ndef combined(x, k1, k2, k3, k4, h):\n    return " + combined,
        "@compiled(innermost=True)\ndef unpack(x, array):\n" + unpacked,
    ]
    return "\n\n\n".join(lines)
