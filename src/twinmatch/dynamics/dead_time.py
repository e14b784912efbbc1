"""Dead time: a signal that takes effect some seconds later, such as a flow that first has to pass a pipe.

An exact delay is not a differential equation with finitely many states. Used instead is the Padé
approximation of order [n−1/n] of e^(−θs), whose step response has no jump. Its states are the coefficients
of the signal's last θ seconds in normalised Legendre polynomials, so that all have the signal's unit, and are
zero, apart from the first, while the signal is constant.

Source: Voelker and Eliasmith, Neural Computation 30 (2018) 569–609, eqs. 4 and 6, with each coefficient i
divided by √(2i + 1).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple, overload

from twinmatch.dynamics.declarations import State
from twinmatch.dynamics.errors import PlantError
from twinmatch.dynamics.numbers import require_range

__all__ = ["DeadTime", "DelayLine", "Delayed"]

Expression = Any

_ORDERS: Final = range(1, 9)
_MARGIN: Final = 0.5
"""By how much of its range the approximation may overshoot the signal's span."""


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

    def after(self, signal: Expression, dead_time: Expression, start: Expression = None) -> Delayed:
        """Delay a signal.

        Args:
            signal: the drive, a disturbance, a state or an expression.
            dead_time: θ, s: usually a parameter with positive bounds.
            start: value of the signal until the start; needed if the signal depends on states. Default: the
                signal.
        """
        import sympy  # noqa: PLC0415 (slow; needed only to derive equations)

        n = len(self._states)
        root = [sympy.sqrt(2 * i + 1) for i in range(n)]
        rates = {
            state: root[i]
            * (
                (-1) ** i * signal
                - sum((1 if i < j else (-1) ** (i - j)) * root[j] * self._states[j] for j in range(n))
            )
            / dead_time
            for i, state in enumerate(self._states)
        }
        value = sum(root[i] * state for i, state in enumerate(self._states))
        first, *others = self._states
        return Delayed(value, rates, {first: signal if start is None else start, **dict.fromkeys(others, 0)})


class DeadTime:
    """Declaration of a dead time; it adds `order` states to the plant, `name_0`, `name_1` …

    Raises:
        PlantError: an invalid span or order.
    """

    def __init__(self, *, span: tuple[float, float], unit: str = "", text: str = "", order: int = 4) -> None:
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
        self.span, self.unit, self.text, self.order = span, unit, text, order
        self.name = ""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name
        low, high = self.span
        wide = _MARGIN * (high - low)
        for i in range(self.order):
            own = f"{name}_{i}"
            if own in vars(owner):
                msg = f"plant {owner.__name__}: {own!r} is a state of the dead time {name!r}; rename it"
                raise PlantError(msg)
            state = State(
                unit=self.unit,
                span=(low - wide, high + wide) if i == 0 else (low - high - wide, high - low + wide),
                scale=0.1 * (high - low),
                text=f"{self.text or name}: {'mean' if i == 0 else f'shape {i}'} over the dead time",
            )
            state.__set_name__(owner, own)
            setattr(owner, own, state)

    @overload
    def __get__(self, plant: None, owner: type) -> DeadTime: ...
    @overload
    def __get__(self, plant: object, owner: type) -> DelayLine: ...
    def __get__(self, plant: object | None, owner: type) -> DeadTime | DelayLine:
        if plant is None:
            return self
        return DelayLine(tuple(getattr(plant, f"{self.name}_{i}") for i in range(self.order)))
