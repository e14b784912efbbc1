"""Formulas for initial states, in terms of the plant's quantities, such as `temperature + 273.15`."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from typing import Any, Final

from twinmatch.fmu.errors import FmuError

__all__ = ["Formula"]

_BINARY: Final[dict[type, Callable[[float, float], float]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
LONGEST: Final = 500


class Formula:
    """Sums, differences, products and quotients of numbers and names.

    Raises:
        FmuError: the text is not such a formula.
    """

    def __init__(self, place: str, text: str) -> None:
        """Parse a formula; `place` starts the error message."""
        self.text, self._place = text, place
        try:
            if len(text) > LONGEST:
                raise SyntaxError("too long")
            self._tree = ast.parse(text.strip(), mode="eval").body
            self.names = tuple(sorted({n.id for n in ast.walk(self._tree) if isinstance(n, ast.Name)}))
            self._of(self._tree, dict.fromkeys(self.names, 1.0))
        except ZeroDivisionError:
            pass
        except (SyntaxError, ValueError, RecursionError):
            msg = f"{place}: {text[:80]!r} is not a formula; use names, numbers, +, −, *, / and parentheses"
            raise FmuError(msg) from None

    def __call__(self, values: Mapping[str, float]) -> float:
        """Its value; NaN if it is undefined."""
        try:
            return self._of(self._tree, values)
        except ZeroDivisionError:
            return math.nan

    def _of(self, node: Any, values: Mapping[str, float]) -> float:
        if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
            return float(node.value)
        if isinstance(node, ast.Name):
            return values[node.id]
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            return -self._of(node.operand, values)
        if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
            return _BINARY[type(node.op)](self._of(node.left, values), self._of(node.right, values))
        raise SyntaxError("not arithmetic")
