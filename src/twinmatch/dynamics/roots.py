"""Roots of quantities that can reach zero, such as the outflow a·√h of a tank that runs empty.

The derivative of a root is infinite at zero: the plant would be infinitely fast there, and no match could use
its derivatives. So √x of a quantity that can become zero or negative within the declared ranges becomes
x/(x² + δ²)^¼, with δ a thousandth of the largest x there; likewise other powers between 0 and 1. At 10 δ the
difference is 0.25 %, at 100 δ 0.0025 %. Below zero the root changes its sign: what runs empty fills again.
Modelica does the same (`Modelica.Fluid.Utilities.regRoot`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from twinmatch.dynamics.plant import Plant

__all__ = ["Roots"]

Expression = Any

_SHARE: Final = 1e-3
"""δ as a share of the largest value."""
_MOST_CORNERS: Final = 4096
"""Corners of the declared ranges at which that value is sought."""


class Roots:
    """Makes roots smooth at zero; knows the declared ranges of the plant's quantities."""

    def __init__(self, plant: Plant) -> None:
        kind = type(plant)  # an instance gives symbols, its class the declarations
        ranges: dict[str, tuple[float, ...]] = {name: state.span for name, state in kind.states.items()}
        ranges[kind.drive.name] = kind.drive.limits
        ranges[kind.output.name] = kind.output.span
        ranges |= {name: (disturbance.default,) for name, disturbance in kind.disturbances.items()}
        self._ranges: Mapping[Expression, tuple[float, ...]] = {
            getattr(plant, name): ends for name, ends in ranges.items()
        }
        self._defaults = {
            getattr(plant, name): parameter.default for name, parameter in kind.parameters.items()
        }

    def smooth(self, expression: Expression) -> Expression:
        """The expression with every root of a varying quantity smooth at zero."""
        import sympy  # noqa: PLC0415

        if not expression.args:
            return expression
        args = [self.smooth(a) for a in expression.args]
        if isinstance(expression, sympy.Pow):
            base, power = args
            if power.is_number and 0 < power < 1 and base.free_symbols & self._ranges.keys():
                values = self._values(base)
                if min(values) <= 0.0:
                    near = sympy.Float(_SHARE * (max(map(abs, values)) or 1.0))
                    return base * (base**2 + near**2) ** ((power - 1) / 2)
        if all(new is old for new, old in zip(args, expression.args, strict=True)):
            return expression
        if isinstance(expression, sympy.Max | sympy.Min | sympy.Abs):
            return expression.func(*args, evaluate=False)
        return expression.func(*args)

    def _values(self, base: Expression) -> list[float]:
        """Values of a quantity at the corners of the declared ranges; zero if it has none there."""
        import sympy  # noqa: PLC0415

        varying = sorted(base.free_symbols & self._ranges.keys(), key=str)
        value = sympy.lambdify([*varying, *self._defaults], base, modules="math")
        corners = itertools.islice(itertools.product(*(self._ranges[s] for s in varying)), _MOST_CORNERS)
        found = []
        for corner in corners:
            try:
                found.append(float(value(*corner, *self._defaults.values())))
            except (ArithmeticError, TypeError, ValueError):
                continue  # such a corner lies outside the range in which the equations hold
        return [v for v in found if math.isfinite(v)] or [0.0]
