"""The compiled arithmetic of the plant: one tick of the Peltier plate, of the camera and of the PID.

All of it is in this one file on purpose. numba's disk cache looks only at the file of the function that
is called from Python, so a kernel split over files could silently keep running old physics.

Between two ticks the bridge voltage V is constant. The current is I = (−V − α(T_B − T_A))/(R + R_bridge),
clipped to ±L, so a plate on a held sink follows, with x = T_A − T_B,

    C·dx/dt = −α·T_A·I + ½I²R − K·x,

a Riccati equation with constant coefficients while |I| < L and a linear equation while the limiter acts.
Both have closed solutions. The equation is scalar and autonomous, hence x is monotone over a tick and
passes each limiter threshold at most once; the moments it does so are closed expressions too.
"""

# ruff: noqa: PLR0917 (kernels take scalars in a row)

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

from twinmatch.signals import KELVIN, FloatArray

__all__ = [
    "Constants",
    "Gains",
    "closed_loop",
    "driven",
    "heat_flows",
    "module_current",
    "noise_sensitivity",
    "pid_step",
    "reading",
    "riccati_arrival",
    "riccati_flow",
    "tick",
]

_Function = TypeVar("_Function", bound=Callable[..., object])


def _compiled(function: _Function) -> _Function:
    # No fastmath: live and replay must agree to the last bit. Division follows IEEE, it does not raise.
    return cast(_Function, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


class Constants(NamedTuple):
    """Everything about rig and driver that one tick needs; units as in `RigParameters` and `Driver`."""

    seebeck: float
    resistance: float
    loop_resistance: float
    conductance: float
    heat_capacity: float
    ambient: float
    sink_heat_capacity: float
    sink_convection: float
    volts_per_count: float
    current_limit: float
    period: float
    substeps: int


class Gains(NamedTuple):
    """The PID's numbers in the order of `PidGains`."""

    proportional: float
    integral: float
    derivative: float
    back_calculation: float
    period: float
    limit: float


@_compiled
def riccati_flow(quadratic: float, slope: float, speed: float, time: float) -> float:
    """How far y' = quadratic·y² + slope·y + speed has come from y(0) = 0 after `time`.

    Written in E = (1 − exp(−s·time))/s with s² the discriminant, so that double roots, a vanishing
    quadratic term and long times need no special case.
    """
    discriminant = slope * slope - 4.0 * quadratic * speed
    if discriminant >= 0.0:
        s = math.sqrt(discriminant)
        e = time if s * time == 0.0 else -math.expm1(-s * time) / s
        gap = s - slope if slope <= 0.0 else -4.0 * quadratic * speed / (s + slope)
        return 2.0 * speed * e / (gap * e + 2.0 * math.exp(-s * time))
    angle = 0.5 * math.sqrt(-discriminant) * time
    sine = 0.5 * time * (1.0 if angle == 0.0 else math.sin(angle) / angle)
    return 2.0 * speed * sine / (math.cos(angle) - slope * sine)


@_compiled
def riccati_arrival(quadratic: float, slope: float, speed: float, distance: float) -> float:
    """When the same solution reaches `distance`, s: 0 if it lies behind, infinite if it is never reached."""
    ratio = distance / speed
    if not ratio > 0.0:
        return 0.0
    discriminant = slope * slope - 4.0 * quadratic * speed
    if discriminant >= 0.0:
        s = math.sqrt(discriminant)
        gap = s - slope if slope <= 0.0 else -4.0 * quadratic * speed / (s + slope)
        rest = 1.0 - 0.5 * gap * ratio
        if not rest > 0.0:
            return math.inf
        growth = s * ratio / rest
        return ratio / rest if growth == 0.0 else math.log1p(growth) / s
    omega = math.sqrt(-discriminant)
    return 2.0 * math.atan2(0.5 * omega * ratio, 1.0 + 0.5 * slope * ratio) / omega


@_compiled
def module_current(rig: Constants, volts: float, plate: float, sink: float) -> float:
    """Current before the limiter, A; positive cools the plate."""
    return (-volts - rig.seebeck * (sink - plate)) / rig.loop_resistance


@_compiled
def _regime(rig: Constants, current: float) -> int:
    if current > rig.current_limit:
        return 1
    return -1 if current < -rig.current_limit else 0


@_compiled
def heat_flows(rig: Constants, current: float, plate: float, sink: float) -> tuple[float, float]:
    """Heat Q_A and Q_B that the module draws from plate and sink, W.

    The paper prints its equation 2 with +α·T_B·I; energy balances only with the minus sign used here.
    """
    half_joule = 0.5 * current * current * rig.resistance
    conducted = rig.conductance * (plate - sink)
    return (
        rig.seebeck * plate * current - half_joule + conducted,
        -rig.seebeck * sink * current - half_joule - conducted,
    )


@_compiled
def _held_sink_tick(rig: Constants, plate: float, sink: float, volts: float) -> float:
    a, r, limit = rig.seebeck, rig.resistance, rig.current_limit
    gain = a / rig.loop_resistance
    offset = -volts / rig.loop_resistance
    # C·x' = second·x² + first·x + zeroth while the limiter rests.
    second = -a * gain * (1.0 - 0.5 * r / rig.loop_resistance) / rig.heat_capacity
    first = (
        -(a * offset * (1.0 - r / rig.loop_resistance) + a * sink * gain + rig.conductance)
        / rig.heat_capacity
    )
    zeroth = offset * (0.5 * r * offset - a * sink) / rig.heat_capacity
    x = plate - sink
    regime = _regime(rig, gain * x + offset)
    left = rig.period
    for _ in range(4):
        if regime == 0:
            quadratic = second
            slope = 2.0 * second * x + first
            speed = (second * x + first) * x + zeroth
        else:
            current = regime * limit
            quadratic = 0.0
            slope = -(a * current + rig.conductance) / rig.heat_capacity
            speed = slope * x + current * (0.5 * r * current - a * sink) / rig.heat_capacity
        if speed == 0.0:
            break
        direction = 1 if speed > 0.0 else -1
        edge, leaving = x, math.inf
        if gain > 0.0 and regime != direction:
            threshold = limit if 2 * regime + direction > 0 else -limit
            edge = (threshold - offset) / gain
            leaving = riccati_arrival(quadratic, slope, speed, edge - x)
        if not leaving < left:
            x += riccati_flow(quadratic, slope, speed, left)
            break
        x = edge
        left -= leaving
        regime += direction
    return sink + x


@_compiled
def _rates(rig: Constants, volts: float, regime: int, plate: float, sink: float) -> tuple[float, float]:
    current = regime * rig.current_limit if regime != 0 else module_current(rig, volts, plate, sink)
    from_plate, from_sink = heat_flows(rig, current, plate, sink)
    convected = rig.sink_convection * (sink - rig.ambient)
    return -from_plate / rig.heat_capacity, -(from_sink + convected) / rig.sink_heat_capacity


@_compiled
def _runge_kutta(
    rig: Constants, volts: float, regime: int, plate: float, sink: float, h: float
) -> tuple[float, float]:
    a1, b1 = _rates(rig, volts, regime, plate, sink)
    a2, b2 = _rates(rig, volts, regime, plate + 0.5 * h * a1, sink + 0.5 * h * b1)
    a3, b3 = _rates(rig, volts, regime, plate + 0.5 * h * a2, sink + 0.5 * h * b2)
    a4, b4 = _rates(rig, volts, regime, plate + h * a3, sink + h * b3)
    return (
        plate + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4),
        sink + h / 6.0 * (b1 + 2.0 * b2 + 2.0 * b3 + b4),
    )


@_compiled
def _moving_sink_tick(rig: Constants, plate: float, sink: float, volts: float) -> tuple[float, float]:
    """One tick of plate and sink: Runge–Kutta of order 4, never stepping across a limiter threshold.

    A step across the kink of the limiter would drop to order 2, so its moment is bisected.
    """
    regime = _regime(rig, module_current(rig, volts, plate, sink))
    for _ in range(rig.substeps):
        left = rig.period / rig.substeps
        for _ in range(4):
            p, s = _runge_kutta(rig, volts, regime, plate, sink, left)
            if _regime(rig, module_current(rig, volts, p, s)) == regime:
                plate, sink = p, s
                break
            before, after = 0.0, left
            for _ in range(48):
                middle = 0.5 * (before + after)
                p, s = _runge_kutta(rig, volts, regime, plate, sink, middle)
                if _regime(rig, module_current(rig, volts, p, s)) == regime:
                    before = middle
                else:
                    after = middle
            plate, sink = _runge_kutta(rig, volts, regime, plate, sink, after)
            regime = _regime(rig, module_current(rig, volts, plate, sink))
            left -= after
    return plate, sink


@_compiled
def tick(rig: Constants, plate: float, sink: float, pwm: float) -> tuple[float, float]:
    """Plate and sink temperature (K) one period later, the PWM held constant."""
    volts = pwm * rig.volts_per_count
    if rig.sink_heat_capacity == math.inf:
        return _held_sink_tick(rig, plate, sink, volts), sink
    return _moving_sink_tick(rig, plate, sink, volts)


@_compiled
def reading(plate: float, noise: float, frozen: bool, resolution: float, last: float) -> float:
    """What the camera says, °C: the plate with noise, quantised; the last reading while it is frozen."""
    if frozen:
        return last
    value = plate - KELVIN + noise
    return math.floor(value / resolution + 0.5) * resolution if resolution > 0.0 else value


@_compiled
def pid_step(
    gains: Gains, integral: float, previous_error: float, reference: float, temperature: float
) -> tuple[float, float, float]:
    """Command u of one sample, and the integral and error the controller keeps."""
    error = reference - temperature
    wanted = (
        gains.proportional * error + integral + gains.derivative * (error - previous_error) / gains.period
    )
    pwm = min(max(wanted, -gains.limit), gains.limit)
    integral += gains.period * (gains.integral * error + gains.back_calculation * (pwm - wanted))
    return pwm, integral, error


@_compiled
def closed_loop(
    rig: Constants,
    gains: Gains,
    reference: FloatArray,
    noise: FloatArray,
    frozen: NDArray[np.bool_],
    resolution: float,
    plate: float,
    sink: float,
    integral: float,
    previous_error: float,
) -> tuple[FloatArray, FloatArray]:
    """Temperature (°C) and PWM of plate, camera and PID in a loop over the reference."""
    temperature = np.empty(reference.size)
    pwm = np.empty(reference.size)
    last = 0.0
    for k in range(reference.size):
        last = reading(plate, noise[k], frozen[k] and k > 0, resolution, last)
        temperature[k] = last
        pwm[k], integral, previous_error = pid_step(gains, integral, previous_error, reference[k], last)
        plate, sink = tick(rig, plate, sink, pwm[k])
    return temperature, pwm


@_compiled
def noise_sensitivity(
    rig: Constants,
    gains: Gains,
    reference: FloatArray,
    step: float,
    plate: float,
    sink: float,
    integral: float,
    previous_error: float,
) -> FloatArray:
    """Derivative of every temperature and PWM by the camera's noise at every sample, shape (N, 2, N)."""
    size = reference.size
    derivative = np.zeros((size, 2, size))
    for k in range(size):
        ahead, sink_ahead, x, e = plate, sink, integral, previous_error
        quiet, quiet_sink, quiet_x, quiet_e = plate, sink, integral, previous_error
        for j in range(k, size):
            noisy = ahead - KELVIN + (step if j == k else 0.0)
            u, x, e = pid_step(gains, x, e, reference[j], noisy)
            calm = quiet - KELVIN
            v, quiet_x, quiet_e = pid_step(gains, quiet_x, quiet_e, reference[j], calm)
            derivative[k, 0, j] = (noisy - calm) / step
            derivative[k, 1, j] = (u - v) / step
            ahead, sink_ahead = tick(rig, ahead, sink_ahead, u)
            quiet, quiet_sink = tick(rig, quiet, quiet_sink, v)
            if j == k:
                plate, sink, integral, previous_error = quiet, quiet_sink, quiet_x, quiet_e
    return derivative


@_compiled
def driven(rig: Constants, pwm: FloatArray, plate: float, sink: float) -> FloatArray:
    """Temperature (°C) at each tick of a plate that follows a given PWM."""
    temperature = np.empty(pwm.size)
    for k in range(pwm.size):
        temperature[k] = plate - KELVIN
        plate, sink = tick(rig, plate, sink, pwm[k])
    return temperature
