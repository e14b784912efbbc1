"""Arithmetic in a map: `v * 10**f`, `duty * (mode == 1)`, `rate(pulses) / 450`.

It is a small part of what Python writes: numbers, names, + - * / ** %, comparisons, `and`, `or`, `not`,
`a if b else c`, and the functions abs, min, max and rate. It is read and computed here; nothing else runs.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from functools import lru_cache, reduce
from typing import Any, Final, NamedTuple

import numpy as np

from twinmatch.sampling.channels import SamplingError
from twinmatch.signals import FloatArray

_LONGEST: Final = 300
"""Longest formula, characters."""
_RATE: Final = "rate"
_OPERATIONS: Final[Mapping[type[ast.AST], Callable[..., Any]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: np.divide,
    ast.Pow: np.power,
    ast.Mod: np.mod,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Not: lambda value: 1.0 * (value == 0.0),
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
_FUNCTIONS: Final[Mapping[str, Callable[..., Any]]] = {
    "abs": np.abs,
    "min": lambda *values: reduce(np.minimum, values),
    "max": lambda *values: reduce(np.maximum, values),
}
_FORM: Final = (
    "a formula has numbers, names, + - * / ** %, comparisons, and, or, not, 'a if b else c', "
    "abs(), min(), max() and rate()"
)


class MapFormula:
    """A formula that was read."""

    def __init__(self, text: str) -> None:
        """Read a formula.

        Raises:
            SamplingError: it has something else in it.
        """
        self.text = text
        self.names: tuple[str, ...] = ()
        """The names in it, in the order in which they come."""
        self.has_rate = False
        """Whether a rate is computed, for which the value before is needed."""
        self._body = _parsed(text)
        try:
            self._check(self._body)
        except RecursionError:
            raise SamplingError(
                f"{text[:40]!r} is nested too deeply; {_FORM}"
            ) from None

    def values(
        self, arguments: Mapping[str, FloatArray], seconds: FloatArray
    ) -> FloatArray:
        """The formula's values, shape (N,); nan where an argument is nan or the result is not finite.

        Args:
            arguments: values of each name, shape (N,).
            seconds: their times, s, shape (N,).
        """
        with np.errstate(all="ignore"):
            computed = _Arguments(arguments, seconds).result(self._body)
        result = np.broadcast_to(np.asarray(computed, dtype=float), seconds.shape)
        is_complete = np.isfinite(result)
        for name in self.names:
            is_complete = is_complete & np.isfinite(arguments[name])
        return np.where(is_complete, result, np.nan)

    def _check(self, node: ast.AST) -> None:
        """Note names and rates of a part.

        Raises:
            SamplingError: it is not one of those that are allowed.
        """
        if isinstance(node, ast.Name):
            self.names = tuple(dict.fromkeys((*self.names, node.id)))
        elif isinstance(node, ast.Call):
            self._check_call(node)
        elif not _is_allowed(node):
            raise SamplingError(f"{self.text!r} is not a formula of a map; {_FORM}")
        else:
            for part in ast.iter_child_nodes(node):
                if not isinstance(
                    part, ast.operator | ast.unaryop | ast.cmpop | ast.boolop
                ):
                    self._check(part)

    def _check_call(self, node: ast.Call) -> None:
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        counts = {"abs": 1, _RATE: 1}
        has_arguments = len(node.args) == counts.get(name, max(len(node.args), 1))
        if name not in (*_FUNCTIONS, _RATE) or node.keywords or not has_arguments:
            raise SamplingError(f"{self.text!r} is not a formula of a map; {_FORM}")
        self.has_rate = self.has_rate or name == _RATE
        for argument in node.args:
            self._check(argument)


class _Arguments:
    """The arguments of a formula, with which parts of it are computed."""

    def __init__(self, values: Mapping[str, FloatArray], seconds: FloatArray) -> None:
        self._values = values
        self._seconds = seconds

    def result(self, node: ast.AST) -> Any:
        """The values of a part, a number or shape (N,)."""
        by_kind: Mapping[type[ast.AST], Callable[[Any], Any]] = {
            ast.Constant: lambda part: float(part.value),
            ast.Name: lambda part: np.asarray(self._values[part.id], dtype=float),
            ast.BinOp: self._operation,
            ast.UnaryOp: lambda part: _OPERATIONS[type(part.op)](
                self.result(part.operand)
            ),
            ast.Compare: self._comparison,
            ast.BoolOp: self._logic,
            ast.IfExp: self._choice,
            ast.Call: self._call,
        }
        return by_kind[type(node)](node)

    def _operation(self, node: ast.BinOp) -> Any:
        return _OPERATIONS[type(node.op)](
            self.result(node.left), self.result(node.right)
        )

    def _comparison(self, node: ast.Compare) -> Any:
        return 1.0 * _OPERATIONS[type(node.ops[0])](
            self.result(node.left), self.result(node.comparators[0])
        )

    def _logic(self, node: ast.BoolOp) -> Any:
        truths = [np.not_equal(self.result(part), 0.0) for part in node.values]
        joined = np.logical_and if isinstance(node.op, ast.And) else np.logical_or
        return 1.0 * reduce(joined, truths)

    def _choice(self, node: ast.IfExp) -> Any:
        is_so = np.not_equal(self.result(node.test), 0.0)
        return np.where(is_so, self.result(node.body), self.result(node.orelse))

    def _call(self, node: ast.Call) -> Any:
        arguments = [self.result(argument) for argument in node.args]
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        if name == _RATE:
            return _rate(
                np.broadcast_to(arguments[0], self._seconds.shape), self._seconds
            )
        return _FUNCTIONS[name](*arguments)


def _parsed(text: str) -> ast.expr:
    """The tree of a formula, of which nothing is run.

    Raises:
        SamplingError: it is not an expression.
    """
    if len(text) > _LONGEST:
        raise SamplingError(
            f"a formula of {len(text)} characters is too long; at most {_LONGEST} are read"
        )
    try:
        return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise SamplingError(f"{text!r} is not a formula; {_FORM}") from None


def _is_allowed(node: ast.AST) -> bool:
    """Whether a part is one that formulas may have, without its own parts."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float) and not isinstance(node.value, bool)
    if isinstance(node, ast.BinOp | ast.UnaryOp):
        return type(node.op) in _OPERATIONS
    if isinstance(node, ast.Compare):
        return len(node.ops) == 1 and type(node.ops[0]) in _OPERATIONS
    return isinstance(node, ast.BoolOp | ast.IfExp)


def _rate(values: FloatArray, seconds: FloatArray) -> FloatArray:
    """Growth per second since the value before, shape (N,); nan at the first and where it is negative."""
    rates = np.full(values.shape, np.nan)
    growth = np.diff(values)
    rates[1:] = np.where(growth >= 0.0, growth / np.diff(seconds), np.nan)
    return rates


@lru_cache(maxsize=64)
def formula_of(text: str) -> MapFormula:
    """A formula, read once.

    Raises:
        SamplingError: it is not one.
    """
    return MapFormula(text)


class _Moment(NamedTuple):
    arguments: Mapping[str, float]
    seconds: float
    interval: float
    """Since the moment before, s; 0 at the first."""
    value: float


class Computing:
    """Computes a formula message by message; a rate is that since the message before."""

    _AT_ONCE: Final = 0.1
    """Share of an interval in which a message is one that was sent again, and has no rate of its own."""
    _FIRST_AT_ONCE: Final = 0.05
    """The same before there is an interval, s."""

    def __init__(self, formula: MapFormula) -> None:
        """Begin before the first message."""
        self._formula = formula
        self._before: _Moment | None = None

    def value(self, arguments: Mapping[str, float], seconds: float) -> float:
        """The value with these arguments at a time (s); nan if there is none, as at the first of a rate."""
        before = self._before
        if before is None or not self._formula.has_rate:
            moments = [(arguments, seconds)]
        else:
            shortest = self._AT_ONCE * before.interval or self._FIRST_AT_ONCE
            if 0.0 <= seconds - before.seconds < shortest:
                return before.value
            moments = [(before.arguments, before.seconds), (arguments, seconds)]
        series = {
            name: np.array([values[name] for values, _ in moments])
            for name in self._formula.names
        }
        times = np.array([moment_seconds for _, moment_seconds in moments])
        value = float(self._formula.values(series, times)[-1])
        interval = seconds - before.seconds if before is not None else 0.0
        self._before = _Moment(dict(arguments), seconds, max(interval, 0.0), value)
        return value
