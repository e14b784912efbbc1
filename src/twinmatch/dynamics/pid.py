"""The PID that runs a plant: parallel form, forward Euler, back-calculation against windup."""

from __future__ import annotations

import math
from dataclasses import dataclass

from twinmatch.dynamics.errors import PlantError
from twinmatch.dynamics.pid_step import Gains, pid_step
from twinmatch.signals import Window

__all__ = ["Pid", "PidGains", "PidState", "controller_state"]

_MOST_AMPLIFICATION = 1e3


@dataclass(frozen=True, slots=True)
class PidGains:
    """Gains and limits of the controller, in units of the plant's input u and output y.

    Raises:
        PlantError: a value is not finite, the period is not positive, or the limits are not in order.
    """

    proportional: float
    """u per y."""
    integral: float
    """u per y and second."""
    derivative: float
    """u per y/s."""
    back_calculation: float
    """Back-calculation gain Kb, by which the integral tracks the limited u, 1/s."""
    low: float
    """Least u."""
    high: float
    """Greatest u."""
    period: float = 1.0
    """Sample time Ts, s."""
    on_measurement: bool = False
    """Whether the derivative is that of −y, which avoids derivative kick at set-point steps."""

    def __post_init__(self) -> None:
        if not all(math.isfinite(value) for value in self.constants):
            msg = f"PID gains: {self} holds a value that is not finite"
            raise PlantError(msg)
        if self.period <= 0 or not self.low < self.high:
            msg = (
                f"PID gains: the period {self.period} s must be positive and the limits {self.low} and "
                f"{self.high} in increasing order"
            )
            raise PlantError(msg)

    @property
    def constants(self) -> Gains:
        """The same numbers for compiled code."""
        return Gains(
            float(self.proportional),
            float(self.integral),
            float(self.derivative),
            float(self.back_calculation),
            float(self.period),
            float(self.low),
            float(self.high),
            bool(self.on_measurement),
        )

    def saturates(self, u: float) -> bool:
        """Whether a command is on a limit."""
        return not self.low < u < self.high


@dataclass(frozen=True, slots=True)
class PidState:
    """State of the controller between two samples."""

    integral: float = 0.0
    """Integral part of the next u, in its unit."""
    previous: float = 0.0
    """The differentiated signal at the last sample: e = r − y, or −y."""


class Pid:
    """A controller in operation.

    At each sample e = r − y, v = P·e + x + D·(e − e_prev)/Ts, u = clip(v, low, high), and then
    x += Ts·(I·e + Kb·(u − v)). It starts with x = 0 and e_prev = 0.
    """

    def __init__(self, gains: PidGains, state: PidState | None = None) -> None:
        self.gains = gains
        self.state = state or PidState()
        self._constants = self.gains.constants

    def step(self, reference: float, output: float) -> float:
        """Compute u of one sample from set-point and output.

        Raises:
            PlantError: reference or output is not finite; the state is unchanged.
        """
        _require_finite(reference=reference, output=output)
        u, integral, previous = pid_step(
            self._constants,
            float(self.state.integral),
            float(self.state.previous),
            float(reference),
            float(output),
        )
        self.state = PidState(integral, previous)
        return u

    def follow(self, reference: float, output: float, u: float) -> None:
        """Adopt the state after a sample whose u was computed by another controller with the same gains.

        With Kb·Ts = 1 the sample and the one before it determine the new state. Otherwise they do so if
        u was not limited; if it was, this controller's own integral is updated by the back-calculation,
        which forgets by the factor 1 − Kb·Ts each sample.

        Raises:
            PlantError: a value is not finite; the state is unchanged.
        """
        _require_finite(reference=reference, output=output, input=u)
        error = reference - output
        moved = -output if self.gains.on_measurement else error
        consistent = _consistent_integral(self.gains, error, moved - self.state.previous, u)
        before = self.state.integral if self.gains.saturates(u) else consistent
        self.state = PidState(_next_integral(self.gains, before, consistent, error), moved)


def controller_state(window: Window, gains: PidGains) -> PidState:
    """State of the controller after the window's second sample, found from the recorded signals.

    With Kb·Ts = 1 it follows exactly from the first two samples. Otherwise it is exact if the second
    sample is not limited; if it is, the state is computed backwards from the first sample that is not
    limited, unless there is none or that would amplify rounding more than a thousandfold: then the
    smallest state that explains the limited sample is used.

    Raises:
        PlantError: the window holds fewer than two samples.
    """
    if len(window) < 2:
        msg = f"controller state: the window holds {len(window)} sample; give at least two"
        raise PlantError(msg)
    error = window.reference - window.output
    moved = -window.output if gains.on_measurement else error
    kept = 1.0 - gains.back_calculation * gains.period
    free = next((k for k in range(1, len(window)) if not gains.saturates(float(window.input[k]))), None)

    def consistent(k: int) -> float:
        change = float(moved[k] - moved[k - 1])
        return _consistent_integral(gains, float(error[k]), change, float(window.input[k]))

    integral = consistent(1)
    if free is not None and free > 1 and abs(kept) ** (free - 1) * _MOST_AMPLIFICATION >= 1:
        integral = consistent(free)
        for k in range(free - 1, 0, -1):
            integral += (1 - kept) * (integral - consistent(k)) / kept
            integral -= gains.period * gains.integral * float(error[k]) / kept
    return PidState(_next_integral(gains, integral, consistent(1), float(error[1])), float(moved[1]))


def _consistent_integral(gains: PidGains, error: float, change: float, u: float) -> float:
    """The integral with which the unlimited controller gives exactly this u."""
    return u - gains.proportional * error - gains.derivative * change / gains.period


def _next_integral(gains: PidGains, integral: float, consistent: float, error: float) -> float:
    # u − v = consistent − integral; with Kb·Ts = 1 the integral before the sample drops out.
    excess = gains.back_calculation * gains.period * (consistent - integral)
    return integral + excess + gains.period * gains.integral * error


def _require_finite(**signals: float) -> None:
    for name, value in signals.items():
        if not math.isfinite(value):
            msg = f"PID: {name} is {value}; the controller takes only finite values"
            raise PlantError(msg)
