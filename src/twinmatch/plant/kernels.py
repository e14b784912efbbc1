"""The compiled arithmetic of the plant: one tick of the Peltier plate, of the camera and of the PID.

All of it is in this one file on purpose. numba's disk cache looks only at the file of the function that
is called from Python, so a kernel split over files could silently keep running old physics.

Between two ticks the bridge voltage V is constant. The current is I = (−V − α(T_B − T_A))/(R + R_bridge),
clipped to ±L, so a plate on a held sink follows, with x = T_A − T_B,

    C·dx/dt = −α·T_A·I + ½I²R − K·x,

a Riccati equation with constant coefficients while |I| < L and a linear equation while the limiter acts.
Both have closed solutions. The equation is scalar and autonomous, hence x is monotone over a tick and
passes each limiter threshold at most once; the moments it does so are closed expressions too.

A sink with mass, or a Seebeck coefficient that depends on temperature, leaves no closed solution: those
are integrated by Runge–Kutta. A coefficient α(T) = α + β·(T − T₀) enters with everything that belongs to
it: the Seebeck voltage is ∫α dT = α(T̄)·(T_B − T_A) with T̄ the mean of both sides, the Peltier heats are
α(T_A)·T_A·I and −α(T_B)·T_B·I, and half of the Thomson heat I·∫T dα goes to either side. Together
that is α(T̄)·T·I ± ¼·β·(T_B − T_A)²·I, and energy balances.

Where nothing smooths the bridge's output, the current at duty cycle D swings by V/(R + R_bridge) about its
mean, the module being shorted between two pulses. That leaves the mean as it is and adds a Joule heat of
R·D(1 − D)·(V/(R + R_bridge))², a constant of the tick, half of it to either side.

What the camera sees follows the plate with a time constant τ. Between two points of the solution the
plate is taken as the cubic through both temperatures and both rates, and the lag of that is exact.
"""

# ruff: noqa: PLR0917 (kernels take scalars in a row)

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.plant.parameters import SEEBECK_REFERENCE
from twinmatch.signals import KELVIN, FloatArray

__all__ = [
    "Constants",
    "Gains",
    "closed_loop",
    "driven",
    "heat_flows",
    "lagged",
    "module_current",
    "noise_sensitivity",
    "pid_step",
    "reading",
    "riccati_arrival",
    "riccati_flow",
    "ripple_heat",
    "seebeck_between",
    "tick",
]


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
    sensor_lag: float
    seebeck_slope: float
    drive_ripple: float
    supply: float
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


@compiled
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


@compiled
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


@compiled
def seebeck_between(rig: Constants, plate: float, sink: float) -> float:
    """Seebeck coefficient at the mean of both temperatures, V/K: what module voltage and heats go by."""
    return rig.seebeck + rig.seebeck_slope * (0.5 * (plate + sink) - SEEBECK_REFERENCE)


@compiled
def module_current(rig: Constants, volts: float, plate: float, sink: float) -> float:
    """Current before the limiter, A; positive cools the plate."""
    return (-volts - seebeck_between(rig, plate, sink) * (sink - plate)) / rig.loop_resistance


@compiled
def _regime(rig: Constants, current: float) -> int:
    if current > rig.current_limit:
        return 1
    return -1 if current < -rig.current_limit else 0


@compiled
def ripple_heat(rig: Constants, volts: float) -> float:
    """Joule heat of the current's swing about its mean that goes to each side, W."""
    swing = abs(volts) * max(rig.supply - abs(volts), 0.0) / (rig.loop_resistance * rig.loop_resistance)
    return 0.5 * rig.resistance * rig.drive_ripple * swing


@compiled
def heat_flows(
    rig: Constants, current: float, ripple: float, plate: float, sink: float
) -> tuple[float, float]:
    """Heat Q_A and Q_B that the module draws from plate and sink, W; `ripple` as `ripple_heat` says.

    The paper prints its equation 2 with +α·T_B·I; energy balances only with the minus sign used here.
    """
    seebeck = seebeck_between(rig, plate, sink)
    half_joule = 0.5 * current * current * rig.resistance + ripple
    conducted = rig.conductance * (plate - sink)
    uneven = 0.25 * rig.seebeck_slope * (sink - plate) * (sink - plate) * current
    return (
        seebeck * plate * current - half_joule + conducted + uneven,
        -seebeck * sink * current - half_joule - conducted - uneven,
    )


@compiled
def lagged(
    lag: float, sensor: float, plate: float, rate: float, plate_after: float, rate_after: float, time: float
) -> float:
    """Where a sensor of time constant `lag` is after `time`, the plate moving along a cubic.

    With z = time/lag it needs the moments m_k = ∫ z·exp(−z(1−s))·s^k ds over 0 to 1. Their recursion
    m_k = 1 − (k/z)·m_{k−1} is run upwards for large z and downwards, from a series, for small.
    """
    z = time / lag
    if z > 1.0:
        m0 = -math.expm1(-z)
        m1 = 1.0 - m0 / z
        m2 = 1.0 - 2.0 * m1 / z
        m3 = 1.0 - 3.0 * m2 / z
    else:
        term = 0.25 * z
        m3 = term
        for j in range(5, 20):
            term *= -z / j
            m3 += term
        m2 = (1.0 - m3) * z / 3.0
        m1 = (1.0 - m2) * z / 2.0
        m0 = (1.0 - m1) * z
    way, begin, end = plate_after - plate, rate * time, rate_after * time
    second = 3.0 * way - 2.0 * begin - end
    third = begin + end - 2.0 * way
    return sensor + m0 * (plate - sensor) + m1 * begin + m2 * second + m3 * third


@compiled
def _held_sink_step(
    rig: Constants, plate: float, sink: float, sensor: float, volts: float, ripple: float, time: float
) -> tuple[float, float]:
    a, r, limit = rig.seebeck, rig.resistance, rig.current_limit
    gain = a / rig.loop_resistance
    offset = -volts / rig.loop_resistance
    # C·x' = second·x² + first·x + zeroth while the limiter rests.
    second = -a * gain * (1.0 - 0.5 * r / rig.loop_resistance) / rig.heat_capacity
    first = (
        -(a * offset * (1.0 - r / rig.loop_resistance) + a * sink * gain + rig.conductance)
        / rig.heat_capacity
    )
    zeroth = (offset * (0.5 * r * offset - a * sink) + ripple) / rig.heat_capacity
    x = plate - sink
    regime = _regime(rig, gain * x + offset)
    left = time
    for _ in range(4):
        if regime == 0:
            quadratic = second
            slope = 2.0 * second * x + first
            speed = (second * x + first) * x + zeroth
        else:
            current = regime * limit
            quadratic = 0.0
            slope = -(a * current + rig.conductance) / rig.heat_capacity
            speed = slope * x + (current * (0.5 * r * current - a * sink) + ripple) / rig.heat_capacity
        before, spent, direction = x, left, 0
        if speed != 0.0:
            direction = 1 if speed > 0.0 else -1
            edge, leaving = x, math.inf
            if gain > 0.0 and regime != direction:
                threshold = limit if 2 * regime + direction > 0 else -limit
                edge = (threshold - offset) / gain
                leaving = riccati_arrival(quadratic, slope, speed, edge - x)
            if leaving < left:
                x, spent = edge, leaving
            else:
                x += riccati_flow(quadratic, slope, speed, left)
        if rig.sensor_lag > 0.0:
            way = x - before
            rate = (quadratic * way + slope) * way + speed
            sensor = lagged(rig.sensor_lag, sensor, sink + before, speed, sink + x, rate, spent)
        if not spent < left:
            break
        left -= spent
        regime += direction
    return sink + x, sensor


@compiled
def _rates(
    rig: Constants, volts: float, ripple: float, regime: int, plate: float, sink: float
) -> tuple[float, float]:
    current = regime * rig.current_limit if regime != 0 else module_current(rig, volts, plate, sink)
    from_plate, from_sink = heat_flows(rig, current, ripple, plate, sink)
    convected = rig.sink_convection * (sink - rig.ambient)
    return -from_plate / rig.heat_capacity, -(from_sink + convected) / rig.sink_heat_capacity


@compiled
def _runge_kutta(
    rig: Constants, volts: float, ripple: float, regime: int, plate: float, sink: float, h: float
) -> tuple[float, float]:
    a1, b1 = _rates(rig, volts, ripple, regime, plate, sink)
    a2, b2 = _rates(rig, volts, ripple, regime, plate + 0.5 * h * a1, sink + 0.5 * h * b1)
    a3, b3 = _rates(rig, volts, ripple, regime, plate + 0.5 * h * a2, sink + 0.5 * h * b2)
    a4, b4 = _rates(rig, volts, ripple, regime, plate + h * a3, sink + h * b3)
    return (
        plate + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4),
        sink + h / 6.0 * (b1 + 2.0 * b2 + 2.0 * b3 + b4),
    )


@compiled
def _integrated_step(
    rig: Constants, plate: float, sink: float, sensor: float, volts: float, ripple: float, time: float
) -> tuple[float, float, float]:
    """Plate, sink and sensor: Runge–Kutta of order 4, never stepping across a limiter threshold.

    A step across the kink of the limiter would drop to order 2, so its moment is bisected.
    """
    regime = _regime(rig, module_current(rig, volts, plate, sink))
    left = time
    for _ in range(4):
        spent, last = left, True
        p, s = _runge_kutta(rig, volts, ripple, regime, plate, sink, left)
        if _regime(rig, module_current(rig, volts, p, s)) != regime:
            before, after = 0.0, left
            for _ in range(48):
                middle = 0.5 * (before + after)
                p, s = _runge_kutta(rig, volts, ripple, regime, plate, sink, middle)
                if _regime(rig, module_current(rig, volts, p, s)) == regime:
                    before = middle
                else:
                    after = middle
            p, s = _runge_kutta(rig, volts, ripple, regime, plate, sink, after)
            spent, last = after, False
        if rig.sensor_lag > 0.0:
            rate, _ = _rates(rig, volts, ripple, regime, plate, sink)
            rate_after, _ = _rates(rig, volts, ripple, regime, p, s)
            sensor = lagged(rig.sensor_lag, sensor, plate, rate, p, rate_after, spent)
        plate, sink = p, s
        if last:
            break
        regime = _regime(rig, module_current(rig, volts, plate, sink))
        left -= spent
    return plate, sink, sensor


@compiled
def tick(rig: Constants, plate: float, sink: float, sensor: float, pwm: float) -> tuple[float, float, float]:
    """Temperature (K) of plate, sink and sensor one period later, the PWM held constant."""
    volts = pwm * rig.volts_per_count
    ripple = ripple_heat(rig, volts)
    closed = rig.sink_heat_capacity == math.inf and rig.seebeck_slope == 0.0
    time = rig.period / rig.substeps
    for _ in range(rig.substeps):
        if closed:
            plate, sensor = _held_sink_step(rig, plate, sink, sensor, volts, ripple, time)
        else:
            plate, sink, sensor = _integrated_step(rig, plate, sink, sensor, volts, ripple, time)
    return plate, sink, sensor if rig.sensor_lag > 0.0 else plate


@compiled
def reading(seen: float, noise: float, frozen: bool, resolution: float, last: float) -> float:
    """What the camera says, °C, of what it sees, K: noisy, quantised; the last reading while it is frozen."""
    if frozen:
        return last
    value = seen - KELVIN + noise
    return math.floor(value / resolution + 0.5) * resolution if resolution > 0.0 else value


@compiled
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


@compiled
def closed_loop(
    rig: Constants,
    gains: Gains,
    reference: FloatArray,
    noise: FloatArray,
    frozen: NDArray[np.bool_],
    resolution: float,
    plate: float,
    sink: float,
    sensor: float,
    integral: float,
    previous_error: float,
) -> tuple[FloatArray, FloatArray]:
    """Temperature (°C) and PWM of plate, camera and PID in a loop over the reference."""
    temperature = np.empty(reference.size)
    pwm = np.empty(reference.size)
    last = 0.0
    for k in range(reference.size):
        last = reading(sensor, noise[k], frozen[k] and k > 0, resolution, last)
        temperature[k] = last
        pwm[k], integral, previous_error = pid_step(gains, integral, previous_error, reference[k], last)
        plate, sink, sensor = tick(rig, plate, sink, sensor, pwm[k])
    return temperature, pwm


@compiled
def noise_sensitivity(
    rig: Constants,
    gains: Gains,
    reference: FloatArray,
    step: float,
    plate: float,
    sink: float,
    sensor: float,
    integral: float,
    previous_error: float,
) -> FloatArray:
    """Derivative of every temperature and PWM by the camera's noise at every sample, shape (N, 2, N)."""
    size = reference.size
    derivative = np.zeros((size, 2, size))
    for k in range(size):
        ahead, sink_ahead, seen_ahead, x, e = plate, sink, sensor, integral, previous_error
        quiet, quiet_sink, quiet_seen, quiet_x, quiet_e = plate, sink, sensor, integral, previous_error
        for j in range(k, size):
            noisy = seen_ahead - KELVIN + (step if j == k else 0.0)
            u, x, e = pid_step(gains, x, e, reference[j], noisy)
            calm = quiet_seen - KELVIN
            v, quiet_x, quiet_e = pid_step(gains, quiet_x, quiet_e, reference[j], calm)
            derivative[k, 0, j] = (noisy - calm) / step
            derivative[k, 1, j] = (u - v) / step
            ahead, sink_ahead, seen_ahead = tick(rig, ahead, sink_ahead, seen_ahead, u)
            quiet, quiet_sink, quiet_seen = tick(rig, quiet, quiet_sink, quiet_seen, v)
            if j == k:
                plate, sink, sensor, integral, previous_error = (
                    quiet,
                    quiet_sink,
                    quiet_seen,
                    quiet_x,
                    quiet_e,
                )
    return derivative


@compiled
def driven(rig: Constants, pwm: FloatArray, plate: float, sink: float, sensor: float) -> FloatArray:
    """Temperature (°C) that is seen at each tick of a plate that follows a given PWM."""
    temperature = np.empty(pwm.size)
    for k in range(pwm.size):
        temperature[k] = sensor - KELVIN
        plate, sink, sensor = tick(rig, plate, sink, sensor, pwm[k])
    return temperature
