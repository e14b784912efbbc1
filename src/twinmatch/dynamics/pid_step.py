"""One sample of the PID, compiled."""

# ruff: noqa: PLR0917 (kernels take arrays in a row)

from __future__ import annotations

from typing import NamedTuple

from twinmatch.compiled import compiled
from twinmatch.signals import FloatArray

__all__ = ["Gains", "loop_step", "pid_step"]


class Gains(NamedTuple):
    """The values of `PidGains`, for compiled code."""

    proportional: float
    integral: float
    derivative: float
    back_calculation: float
    period: float
    low: float
    high: float
    on_measurement: bool


@compiled
def pid_step(
    gains: Gains, integral: float, previous: float, reference: float, output: float
) -> tuple[float, float, float]:
    """Command u of one sample, and the controller's new state: integral and differentiated signal."""
    error = reference - output
    moved = -output if gains.on_measurement else error
    unlimited = gains.proportional * error + integral + gains.derivative * (moved - previous) / gains.period
    u = min(max(unlimited, gains.low), gains.high)
    integral += gains.period * (gains.integral * error + gains.back_calculation * (u - unlimited))
    return u, integral, moved


@compiled(innermost=True)
def loop_step(
    gains: Gains, integral: float, previous_error: float, reference: float, y: float, dy: FloatArray,
    d_integral: FloatArray, d_error: FloatArray, du: FloatArray, n: int,
) -> tuple[float, float, float, float]:  # fmt: skip
    """The controller's step with the derivatives of its state; d_error is that of `previous_error`."""
    u, after, error = pid_step(gains, integral, previous_error, reference, y)
    per_second = gains.derivative / gains.period
    free = 1.0 if gains.low < u < gains.high else 0.0
    for j in range(n):
        unlimited = d_integral[j] - (gains.proportional + per_second) * dy[j] - per_second * d_error[j]
        du[j] = free * unlimited
        d_integral[j] += gains.period * (
            gains.back_calculation * (du[j] - unlimited) - gains.integral * dy[j]
        )
        d_error[j] = -dy[j]
    return u, after, error, free
