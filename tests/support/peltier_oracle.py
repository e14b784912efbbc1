"""Independent integrators of the Peltier plate's equations: closed and general."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy.integrate

solve_ivp: Any = scipy.integrate.solve_ivp
Values = Mapping[str, float]


def seebeck_at(rig: Values, temperature: float) -> float:
    """Seebeck coefficient of the material at one place, V/K."""
    return rig["seebeck"] + rig.get("seebeck_slope", 0.0) * (temperature - 298.15)


def free_current(rig: Values, pwm: float, plate: float, sink: float) -> float:
    """Current if there were no limiter, A: the Seebeck voltage is the integral of α over temperature."""
    voltage = (seebeck_at(rig, plate) + seebeck_at(rig, sink)) / 2 * (sink - plate)
    return (-rig["supply"] * pwm / 255.0 - voltage) / (
        rig["resistance"] + rig["bridge_resistance"]
    )


def ripple(rig: Values, pwm: float) -> float:
    """Mean square of the current's swing: it is +V/R_loop higher for a share `duty` of the time."""
    duty = abs(pwm) / 255.0
    swing = (
        duty
        * (1 - duty)
        * (rig["supply"] / (rig["resistance"] + rig["bridge_resistance"])) ** 2
    )
    return rig["drive_ripple"] * swing


def integrated(rig: Values, start: np.ndarray, pwm: float, period: float) -> np.ndarray:
    """One tick by scipy's integrator, restarted wherever the limiter switches.

    Start and result are [plate, sink, sensor] in K.
    """
    limit = rig["current_limit"]
    lag = rig.get("sensor_lag", 0.0)
    mass = rig.get("sink_heat_capacity", math.inf)

    def rates(_t: float, state: np.ndarray, regime: int) -> list[float]:
        plate, sink, sensor = state
        current = regime * limit if regime else free_current(rig, pwm, plate, sink)
        joule = (current**2 + ripple(rig, pwm)) * rig["resistance"] / 2
        # Thomson heat: the integral of T·dα/dT from plate to sink, half of it taken from either side.
        thomson = rig.get("seebeck_slope", 0.0) * (sink**2 - plate**2) / 2 * current / 2
        conducted = rig["conductance"] * (plate - sink)
        from_plate = (
            seebeck_at(rig, plate) * plate * current - joule + conducted + thomson
        )
        from_sink = (
            -seebeck_at(rig, sink) * sink * current - joule - conducted + thomson
        )
        lost = rig.get("sink_convection", 0.0) * (sink - rig["ambient"])
        sensor_rate = (plate - sensor) / lag if lag else 0.0
        return [
            -from_plate / rig["heat_capacity"],
            -(from_sink + lost) / mass,
            sensor_rate,
        ]

    def upper(_t: float, state: np.ndarray, _regime: int) -> float:
        return free_current(rig, pwm, state[0], state[1]) - limit

    def lower(_t: float, state: np.ndarray, _regime: int) -> float:
        return free_current(rig, pwm, state[0], state[1]) + limit

    upper.terminal = lower.terminal = True  # type: ignore[attr-defined]
    elapsed = 0.0
    state = np.array(start, dtype=float)
    current = free_current(rig, pwm, state[0], state[1])
    regime = int(current > limit) - int(current < -limit)
    while True:
        # From a threshold the first event is the departure itself: watch only the others.
        watch = [f for f in (upper, lower) if abs(f(0.0, state, 0)) > 1e-9]
        run = solve_ivp(
            rates,
            (elapsed, period),
            state,
            "DOP853",
            rtol=1e-12,
            atol=1e-12,
            events=watch,
            args=(regime,),
        )
        elapsed = float(run.t[-1])
        state = run.y[:, -1]
        if run.status != 1:
            return np.array([state[0], state[1], state[2] if lag else state[0]])
        met = watch[next(i for i, times in enumerate(run.t_events) if times.size)]
        edge = 1 if met is upper else -1
        regime = 0 if regime == edge else edge


def riccati_flow(quadratic: float, slope: float, speed: float, time: float) -> float:
    """How far y' = quadratic·y² + slope·y + speed has come from y(0) = 0: the closed solution."""
    discriminant = slope * slope - 4.0 * quadratic * speed
    if discriminant >= 0.0:
        s = math.sqrt(discriminant)
        e = time if s * time == 0.0 else -math.expm1(-s * time) / s
        gap = s - slope if slope <= 0.0 else -4.0 * quadratic * speed / (s + slope)
        return 2.0 * speed * e / (gap * e + 2.0 * math.exp(-s * time))
    angle = 0.5 * math.sqrt(-discriminant) * time
    sine = 0.5 * time * (1.0 if angle == 0.0 else math.sin(angle) / angle)
    return 2.0 * speed * sine / (math.cos(angle) - slope * sine)


def riccati_arrival(
    quadratic: float, slope: float, speed: float, distance: float
) -> float:
    """When the same solution reaches `distance`, s: 0 if it lies behind, infinite if it is never reached."""
    ratio = distance / speed
    if not ratio > 0.0:
        return 0.0
    discriminant = slope * slope - 4.0 * quadratic * speed
    if discriminant >= 0.0:
        s = math.sqrt(discriminant)
        gap = s - slope if slope <= 0.0 else -4.0 * quadratic * speed / (s + slope)
        denominator = 1.0 - 0.5 * gap * ratio
        if not denominator > 0.0:
            return math.inf
        growth = s * ratio / denominator
        return ratio / denominator if growth == 0.0 else math.log1p(growth) / s
    omega = math.sqrt(-discriminant)
    return 2.0 * math.atan2(0.5 * omega * ratio, 1.0 + 0.5 * slope * ratio) / omega


def closed_tick(rig: Values, plate: float, pwm: float, period: float) -> float:
    """Plate (K) one tick later on a held sink, in closed form, the limiter's switching included.

    With x = T_A − T_B the plate follows C·dx/dt = −α·T_A·I + ½I²R − K·x, a Riccati equation with constant
    coefficients while the limiter rests and a linear one while it acts; x is monotone over a tick.
    """
    a, r, k, c = (
        rig[name] for name in ("seebeck", "resistance", "conductance", "heat_capacity")
    )
    sink = rig["ambient"]
    limit = rig["current_limit"]
    total = r + rig["bridge_resistance"]
    gain = a / total
    offset = -rig["supply"] * pwm / 255.0 / total
    heat = ripple(rig, pwm) * r / 2
    second = -a * gain * (1.0 - 0.5 * r / total) / c
    first = -(a * offset * (1.0 - r / total) + a * sink * gain + k) / c
    zeroth = (offset * (0.5 * r * offset - a * sink) + heat) / c
    x = plate - sink
    time_left = period
    current = gain * x + offset
    regime = int(current > limit) - int(current < -limit)
    for _ in range(4):
        if regime == 0:
            quadratic = second
            slope = 2.0 * second * x + first
            speed = (second * x + first) * x + zeroth
        else:
            limited_current = regime * limit
            quadratic = 0.0
            slope = -(a * limited_current + k) / c
            speed = (
                slope * x
                + (limited_current * (0.5 * r * limited_current - a * sink) + heat) / c
            )
        if speed == 0.0:
            break
        direction = 1 if speed > 0.0 else -1
        edge = x
        leaving = math.inf
        if gain > 0.0 and regime != direction:
            threshold = limit if 2 * regime + direction > 0 else -limit
            edge = (threshold - offset) / gain
            leaving = riccati_arrival(quadratic, slope, speed, edge - x)
        if not leaving < time_left:
            x += riccati_flow(quadratic, slope, speed, time_left)
            break
        x = edge
        time_left = time_left - leaving
        regime = regime + direction
    return sink + x
