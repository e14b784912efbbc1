"""One sample of the PID, compiled."""

from __future__ import annotations

from typing import NamedTuple

from twinmatch.compiled import compiled

__all__ = ["Gains", "pid_step"]


class Gains(NamedTuple):
    """The numbers of `PidGains`, for compiled code."""

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
    """Command u of one sample, and the integral and the differentiated signal the controller keeps."""
    error = reference - output
    moved = -output if gains.on_measurement else error
    wanted = gains.proportional * error + integral + gains.derivative * (moved - previous) / gains.period
    u = min(max(wanted, gains.low), gains.high)
    integral += gains.period * (gains.integral * error + gains.back_calculation * (u - wanted))
    return u, integral, moved
