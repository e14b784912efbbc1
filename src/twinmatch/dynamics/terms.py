"""Terms of a plant's equations that need care: kinks, roots that reach zero, and dead times.

*Kinks* (`Min`, `Max`, `Abs`, `Piecewise` with inequalities) each become a *switch*, a symbol that is 1 or 0,
and a *condition*, the expression whose sign it follows; both branches then appear in the equations, weighted
by the switch and one minus it. With constant switches a plant is smooth: its derivatives are those of the
active branch, and an integrator can step exactly to the moment a condition changes sign. The equations must
be continuous there, like those of a limiter. Smooth functions (exp, sqrt) are imported from `sympy`.

*Roots*, such as the outflow a·√h of a tank that runs empty, have an infinite derivative at zero: the plant
would be infinitely fast there, and no match could use its derivatives. So √x of a quantity that can become
zero or negative within the declared ranges becomes x/(x² + δ²)^¼, with δ a thousandth of the largest x there;
likewise other powers between 0 and 1. At 10 δ the difference is 0.25 %, at 100 δ 0.0025 %. Below zero the
root changes its sign: what runs empty fills again. Modelica's `Fluid.Utilities.regRoot` does the same.

*Dead time* is a signal that takes effect some seconds later, such as a flow that first has to pass a pipe. An
exact delay is not a differential equation with finitely many states. Used instead is the Padé approximation
of order [n−1/n] of e^(−θs), whose step response has no jump. Its states are the coefficients of the
signal's last θ seconds in normalised Legendre polynomials, so that all have the signal's unit, and are
zero, apart from the first, while the signal is constant. Source: Voelker and Eliasmith, Neural Computation
30 (2018) 569–609, eqs. 4 and 6, with each coefficient i divided by √(2i + 1).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple, overload

from twinmatch.dynamics.declarations import PlantError, State, require_range
from twinmatch.dynamics.definition import Expression, PlantDefinition

_SHARE: Final = 1e-3
"""δ as a share of the largest value."""
_MAX_CORNERS: Final = 4096
"""Corners of the declared ranges at which that value is sought."""
_ORDERS: Final = range(1, 9)
_MARGIN: Final = 0.5
"""By how much of its range the approximation may overshoot the signal's span."""


def maximum(*values: Any) -> Any:
    """The greatest of some expressions."""
    import sympy  # noqa: PLC0415

    return sympy.Max(*values, evaluate=False)


def minimum(*values: Any) -> Any:
    """The least of some expressions."""
    import sympy  # noqa: PLC0415

    return sympy.Min(*values, evaluate=False)


def magnitude(value: Any) -> Any:
    """The absolute value of an expression."""
    import sympy  # noqa: PLC0415

    return sympy.Abs(value, evaluate=False)


def limited(value: Any, low: Any, high: Any) -> Any:
    """An expression limited to the range between two others."""
    return maximum(low, minimum(high, value))


def dead_zone(value: Any, width: Any) -> Any:
    """What is left of a value beyond ±`width`: the voltage that turns a motor once it has broken loose."""
    return value - limited(value, -width, width)


def dry_friction(speed: Any, force: Any, softness: Any) -> Any:
    """A force of size `force` against a speed; smooth, half of it acts at the speed `softness`."""
    return -force * speed / (softness + magnitude(speed))


class Kinks:
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
            for candidate in args[1:]:
                sign = 1 if isinstance(expression, sympy.Max) else -1
                switch = self._switch(sign * (result - candidate))
                result = switch * result + (1 - switch) * candidate
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
        # not the name of a quantity
        switch = sympy.Symbol(f"switch {len(self.switches)}", real=True)
        self.switches.append(switch)
        self.conditions.append(condition)
        return switch


class Roots:
    """Makes roots smooth at zero; knows the declared ranges of the plant's quantities."""

    def __init__(self, plant: PlantDefinition) -> None:
        kind = type(plant)  # an instance gives symbols, its class the declarations
        ranges: dict[str, tuple[float, ...]] = {
            name: state.span for name, state in kind.states.items()
        }
        ranges |= {name: drive.limits for name, drive in kind.drives.items()}
        ranges |= {name: output.span for name, output in kind.outputs.items()}
        ranges |= {
            name: (disturbance.default,)
            for name, disturbance in kind.disturbances.items()
        }
        self._ranges: Mapping[Expression, tuple[float, ...]] = {
            getattr(plant, name): ends for name, ends in ranges.items()
        }
        self._defaults = {
            getattr(plant, name): parameter.default
            for name, parameter in kind.parameters.items()
        }

    def smooth(self, expression: Expression) -> Expression:
        """The expression with every root of a varying quantity smooth at zero."""
        import sympy  # noqa: PLC0415

        if not expression.args:
            return expression
        args = [self.smooth(a) for a in expression.args]
        if isinstance(expression, sympy.Pow):
            base, power = args
            if (
                power.is_number
                and 0 < power < 1
                and base.free_symbols & self._ranges.keys()
            ):
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
        corners = itertools.islice(
            itertools.product(*(self._ranges[s] for s in varying)), _MAX_CORNERS
        )
        values = []
        for corner in corners:
            try:
                values.append(float(value(*corner, *self._defaults.values())))
            except (ArithmeticError, TypeError, ValueError):
                # such a corner lies outside the range in which the equations hold
                continue
        return [v for v in values if math.isfinite(v)] or [0.0]


class Delayed(NamedTuple):
    """A delayed signal and what it adds to a plant's equations."""

    value: Expression
    """The signal as it was one dead time ago."""
    rates: Mapping[Expression, Expression]
    """Add these to `rates` of the equations."""
    start: Mapping[Expression, Expression]
    """Add these to `start`: the signal is assumed constant until then."""


class DelayLine:
    """A declared dead time inside a plant's equations."""

    def __init__(self, states: tuple[Expression, ...]) -> None:
        """Take the symbols of its states."""
        self._states = states

    def after(
        self, signal: Expression, dead_time: Expression, start: Expression = None
    ) -> Delayed:
        """Delay a signal.

        Args:
            signal: the drive, a disturbance, a state or an expression.
            dead_time: θ, s: usually a parameter with positive bounds.
            start: value of the signal until the start; needed if the signal depends on states. Default: the
                signal.
        """
        import sympy  # noqa: PLC0415

        n = len(self._states)
        root = [sympy.sqrt(2 * i + 1) for i in range(n)]
        rates = {}
        for i, state in enumerate(self._states):
            signs = [1 if i < j else (-1) ** (i - j) for j in range(n)]
            stored = sum(signs[j] * root[j] * self._states[j] for j in range(n))
            rates[state] = root[i] * ((-1) ** i * signal - stored) / dead_time
        value = sum(root[i] * state for i, state in enumerate(self._states))
        first, *later = self._states
        return Delayed(
            value,
            rates,
            {first: signal if start is None else start, **dict.fromkeys(later, 0)},
        )


class DeadTime:
    """Declaration of a dead time; it adds `order` states to the plant, `name_0`, `name_1` …

    Raises:
        PlantError: an invalid span or order.
    """

    def __init__(
        self,
        *,
        span: tuple[float, float],
        unit: str = "",
        text: str = "",
        order: int = 4,
    ) -> None:
        """Declare it.

        Args:
            span: range of the delayed signal, in its unit.
            unit: the signal's unit.
            text: short description of the delayed signal.
            order: number of states, 1 to 8. More follow faster changes; the steps of the simulation become
                shorter with its square.
        """
        require_range("span of a dead time", span)
        if order not in _ORDERS:
            msg = f"plant: order {order!r} of a dead time ({text}); choose {_ORDERS[0]} to {_ORDERS[-1]}"
            raise PlantError(msg)
        self.span = span
        self.unit = unit
        self.text = text
        self.order = order
        self.name = ""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name
        low, high = self.span
        wide = _MARGIN * (high - low)
        for i in range(self.order):
            state_name = f"{name}_{i}"
            if state_name in vars(owner):
                msg = f"plant {owner.__name__}: {state_name!r} is a state of the dead time {name!r}; rename it"
                raise PlantError(msg)
            state = State(
                unit=self.unit,
                span=(low - wide, high + wide)
                if i == 0
                else (low - high - wide, high - low + wide),
                scale=0.1 * (high - low),
                text=f"{self.text or name}: {'mean' if i == 0 else f'shape {i}'} over the dead time",
            )
            state.__set_name__(owner, state_name)
            setattr(owner, state_name, state)

    @overload
    def __get__(self, plant: None, owner: type) -> DeadTime: ...
    @overload
    def __get__(self, plant: object, owner: type) -> DelayLine: ...
    def __get__(self, plant: object | None, owner: type) -> DeadTime | DelayLine:
        if plant is None:
            return self
        return DelayLine(
            tuple(getattr(plant, f"{self.name}_{i}") for i in range(self.order))
        )


def dead_times_of(plant: type) -> tuple[DeadTime, ...]:
    """All dead times of a plant's class: what it inherits first, and what it has replaced only once."""
    declared: dict[str, object] = {}
    for kind in reversed(plant.__mro__):
        declared |= vars(kind)
    return tuple(part for part in declared.values() if isinstance(part, DeadTime))
