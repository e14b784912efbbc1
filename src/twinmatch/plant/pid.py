"""The rig's PID: parallel form, forward Euler, back-calculation against windup."""

from __future__ import annotations

import math
from dataclasses import dataclass

from twinmatch.plant import kernels
from twinmatch.plant.parameters import PlantError
from twinmatch.signals import Window

__all__ = ["Pid", "PidGains", "PidState", "controller_state"]

PWM_LIMIT = 255.0

_MOST_AMPLIFICATION = 1e3


@dataclass(frozen=True, slots=True)
class PidGains:
    """Numbers of the controller; the defaults are the rig's.

    Raises:
        PlantError: a value is not finite, or the period or limit is not positive.
    """

    proportional: float = 38.57
    """PWM per °C."""
    integral: float = 1.46877
    """PWM per °C and second."""
    derivative: float = 6.66875
    """PWM per °C/s."""
    back_calculation: float = 1.0
    """Rate Kb at which the integral is pulled back while the output is limited, 1/s."""
    period: float = 1.0
    """Sample time Ts, s."""
    limit: float = PWM_LIMIT
    """Largest magnitude of the output, PWM."""

    def __post_init__(self) -> None:
        if not all(math.isfinite(value) for value in self.constants):
            msg = f"PID gains: {self} holds a value that is not finite"
            raise PlantError(msg)
        if self.period <= 0 or self.limit <= 0:
            msg = f"PID gains: period {self.period} s and limit {self.limit} must both be positive"
            raise PlantError(msg)

    @property
    def constants(self) -> kernels.Gains:
        """The same numbers for the compiled kernels."""
        return kernels.Gains(
            float(self.proportional),
            float(self.integral),
            float(self.derivative),
            float(self.back_calculation),
            float(self.period),
            float(self.limit),
        )


@dataclass(frozen=True, slots=True)
class PidState:
    """What the controller remembers between two samples."""

    integral: float = 0.0
    """Integral part x of the next output, PWM."""
    previous_error: float = 0.0
    """Error e = r − y of the last sample, °C."""


class Pid:
    """A controller in operation.

    At each sample e = r − y, v = P·e + x + D·(e − e_prev)/Ts, u = clip(v, ±limit), and then
    x += Ts·(I·e + Kb·(u − v)). It starts with x = 0 and e_prev = 0, as the rig does.
    """

    def __init__(self, gains: PidGains | None = None, state: PidState | None = None) -> None:
        self.gains = gains or PidGains()
        self.state = state or PidState()
        self._constants = self.gains.constants

    def step(self, reference: float, output: float) -> float:
        """Compute the input of one sample from set-point and output (on the rig PWM, °C and °C).

        Raises:
            PlantError: reference or output is not finite; the state is left as it was.
        """
        _require_finite(reference=reference, output=output)
        computed, integral, error = kernels.pid_step(
            self._constants,
            float(self.state.integral),
            float(self.state.previous_error),
            float(reference),
            float(output),
        )
        self.state = PidState(integral, error)
        return computed

    def follow(self, reference: float, output: float, input: float) -> None:
        """Adopt the state after a sample whose input another controller of the same gains computed.

        With Kb·Ts = 1 the sample and the error before it fix the new state. Otherwise they do so when
        the output was not limited; when it was, this controller's own integral is carried through the
        back-calculation, which forgets by the factor 1 − Kb·Ts each sample.

        Raises:
            PlantError: a value is not finite; the state is left as it was.
        """
        _require_finite(reference=reference, output=output, input=input)
        error = reference - output
        consistent = _consistent_integral(self.gains, error, self.state.previous_error, input)
        inside = abs(input) < self.gains.limit
        before = consistent if inside else self.state.integral
        self.state = PidState(_next_integral(self.gains, before, consistent, error), error)


def controller_state(window: Window, gains: PidGains | None = None) -> PidState:
    """State of the controller after the window's second sample, found from the recorded signals.

    With Kb·Ts = 1 (the rig) it follows exactly from the first two samples. Otherwise it is exact when
    the second sample is not limited; else it is traced back from the first sample that is not, unless
    that would magnify rounding more than a thousandfold or there is none: then the least state that
    explains the limited sample is taken.

    Raises:
        PlantError: the window holds fewer than two samples.
    """
    gains = gains or PidGains()
    if len(window) < 2:
        msg = f"controller state: the window holds {len(window)} sample; two are needed"
        raise PlantError(msg)
    error = window.reference - window.output
    kept = 1.0 - gains.back_calculation * gains.period
    free = next((k for k in range(1, len(window)) if abs(window.input[k]) < gains.limit), None)

    def consistent(k: int) -> float:
        return _consistent_integral(gains, float(error[k]), float(error[k - 1]), float(window.input[k]))

    integral = consistent(1)
    if free is not None and free > 1 and abs(kept) ** (free - 1) * _MOST_AMPLIFICATION >= 1:
        integral = consistent(free)
        for k in range(free - 1, 0, -1):
            integral += (1 - kept) * (integral - consistent(k)) / kept
            integral -= gains.period * gains.integral * float(error[k]) / kept
    return PidState(_next_integral(gains, integral, consistent(1), float(error[1])), float(error[1]))


def _consistent_integral(gains: PidGains, error: float, previous_error: float, computed: float) -> float:
    """The integral with which the controller, unlimited, computes just this input."""
    return computed - gains.proportional * error - gains.derivative * (error - previous_error) / gains.period


def _next_integral(gains: PidGains, integral: float, consistent: float, error: float) -> float:
    # u − v = consistent − integral; with Kb·Ts = 1 the integral before the sample drops out.
    excess = gains.back_calculation * gains.period * (consistent - integral)
    return integral + excess + gains.period * gains.integral * error


def _require_finite(**signals: float) -> None:
    for name, value in signals.items():
        if not math.isfinite(value):
            msg = f"PID: {name} is {value}; the controller takes only finite values"
            raise PlantError(msg)
