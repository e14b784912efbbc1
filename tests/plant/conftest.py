"""An independent integrator of the plant's equations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from twinmatch.plant import PlantState, RigParameters

SUPPLY, BRIDGE, LIMIT = 12.0, 0.1, 5.0

Integrator = Callable[[RigParameters, PlantState, float, float], PlantState]


def seebeck_at(rig: RigParameters, temperature: float) -> float:
    """Seebeck coefficient of the material at one place, V/K."""
    return rig.seebeck + rig.seebeck_slope * (temperature - 298.15)


def free_current(rig: RigParameters, pwm: float, plate: float, sink: float) -> float:
    """Current if there were no limiter, A: the Seebeck voltage is the integral of α over temperature."""
    voltage = (seebeck_at(rig, plate) + seebeck_at(rig, sink)) / 2 * (sink - plate)
    return (-SUPPLY * pwm / 255.0 - voltage) / (rig.resistance + BRIDGE)


@pytest.fixture(scope="session")
def integrated() -> Integrator:
    """One tick by scipy's integrator, restarted wherever the limiter switches."""

    def integrate(rig: RigParameters, start: PlantState, pwm: float, period: float) -> PlantState:
        def rates(_t: float, state: np.ndarray, regime: int) -> list[float]:
            plate, sink, sensor = state
            current = regime * LIMIT if regime else free_current(rig, pwm, plate, sink)
            # Mean square of a current that is +V/R_loop higher for a share `duty` of the time.
            duty = abs(pwm) / 255.0
            swing = duty * (1 - duty) * (SUPPLY / (rig.resistance + BRIDGE)) ** 2
            joule = (current**2 + rig.drive_ripple * swing) * rig.resistance / 2
            # Thomson heat: the integral of T·dα/dT from plate to sink, half of it taken from either side.
            thomson = rig.seebeck_slope * (sink**2 - plate**2) / 2 * current / 2
            conducted = rig.conductance * (plate - sink)
            from_plate = seebeck_at(rig, plate) * plate * current - joule + conducted + thomson
            from_sink = -seebeck_at(rig, sink) * sink * current - joule - conducted + thomson
            lost = rig.sink_convection * (sink - rig.ambient)
            seen = (plate - sensor) / rig.sensor_lag if rig.sensor_lag else 0.0
            return [-from_plate / rig.heat_capacity, -(from_sink + lost) / rig.sink_heat_capacity, seen]

        def upper(_t: float, state: np.ndarray, _regime: int) -> float:
            return free_current(rig, pwm, state[0], state[1]) - LIMIT

        def lower(_t: float, state: np.ndarray, _regime: int) -> float:
            return free_current(rig, pwm, state[0], state[1]) + LIMIT

        upper.terminal = lower.terminal = True  # type: ignore[attr-defined]
        now, state = 0.0, np.array([start.plate, start.sink, start.sensor])
        current = free_current(rig, pwm, start.plate, start.sink)
        regime = int(current > LIMIT) - int(current < -LIMIT)
        while True:
            # From a threshold the first event is the departure itself: watch only the others.
            watch = [f for f in (upper, lower) if abs(f(0.0, state, 0)) > 1e-9]
            run = solve_ivp(
                rates, (now, period), state, "DOP853", rtol=1e-12, atol=1e-12, events=watch, args=(regime,)
            )
            now, state = float(run.t[-1]), run.y[:, -1]
            if run.status != 1:
                seen = state[2] if rig.sensor_lag else state[0]
                return PlantState(float(state[0]), float(state[1]), float(seen))
            met = watch[next(i for i, times in enumerate(run.t_events) if times.size)]
            edge = 1 if met is upper else -1
            regime = 0 if regime == edge else edge

    return integrate
