"""The whole rig: closed into its loop, driven by a given PWM, or one tick at a time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.plant import kernels
from twinmatch.plant.camera import Camera, CameraRealisation
from twinmatch.plant.driver import Driver
from twinmatch.plant.parameters import (
    SEEBECK_REFERENCE,
    PlantError,
    PlantState,
    RigParameters,
    require_kelvin,
)
from twinmatch.plant.pid import PidGains, PidState, controller_state
from twinmatch.signals import KELVIN, FloatArray, Window

__all__ = [
    "HeatFlows",
    "Response",
    "advance",
    "heat_flows",
    "noise_sensitivity",
    "simulate_closed_loop",
    "simulate_driven",
    "simulate_window",
]

_STEP_OF_FASTEST_RATE = 0.04
"""Runge–Kutta step in units of the fastest time constant: far inside stability, error below 1e-6 K."""
_LAGGED_STEP = 0.1
"""The same for a plate that is solved exactly and seen through a lag: a cubic fits it to 1e-5 K."""
_HOT = 400.0
"""Temperature at which the fastest rate is bounded, K."""
_MOST_SUBSTEPS = 2000
_NOISE_STEP = 1e-3
"""Finite difference of a camera reading, °C."""


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """What a simulation gives, sample by sample."""

    output: FloatArray
    """Temperature y, °C, shape (N,); as the camera reads it, if there is one."""
    input: FloatArray
    """PWM command u, −255 to 255, shape (N,)."""


@dataclass(frozen=True, slots=True)
class HeatFlows:
    """The Peltier module at one instant; `plate + sink + voltage·current + ripple = 0`."""

    current: float
    """Current I after the limiter, A; positive cools the plate."""
    voltage: float
    """The module's own terminal voltage α·(T_B − T_A) + I·R, V."""
    plate: float
    """Heat Q_A drawn from the plate, W."""
    sink: float
    """Heat Q_B drawn from the sink, W."""
    ripple: float = 0.0
    """Electrical power of the current's swing about its mean, W."""


def heat_flows(
    parameters: RigParameters, state: PlantState, pwm: float, driver: Driver | None = None
) -> HeatFlows:
    """Current, voltage and heat flows of the module (paper, equations 1 to 3, sign of 2 corrected)."""
    rig = _constants(parameters, driver or Driver(), 1.0)
    volts = pwm * rig.volts_per_count
    free = kernels.module_current(rig, volts, state.plate, state.sink)
    current = min(max(free, -rig.current_limit), rig.current_limit)
    seebeck = kernels.seebeck_between(rig, state.plate, state.sink)
    voltage = seebeck * (state.sink - state.plate) + current * rig.resistance
    ripple = kernels.ripple_heat(rig, volts)
    plate, sink = kernels.heat_flows(rig, current, ripple, state.plate, state.sink)
    return HeatFlows(current, voltage, plate, sink, 2.0 * ripple)


def simulate_closed_loop(
    parameters: RigParameters,
    reference: ArrayLike,
    *,
    plate: float,
    sink: float | None = None,
    sensor: float | None = None,
    controller: PidState | None = None,
    gains: PidGains | None = None,
    driver: Driver | None = None,
    camera: CameraRealisation | None = None,
) -> Response:
    """Run plate, camera and PID over a reference (°C, shape (N,)).

    `plate`, `sink` and `sensor` are the temperatures in kelvin at the first sample; a sink not given
    starts at ambient, a sensor not given at the plate. `controller` is the state of the PID before the
    first sample. Without a camera the controller sees the sensor's temperature itself.

    Raises:
        PlantError: a start temperature, the reference or the camera's length is unfit, or the
            parameters are too stiff.
    """
    gains = gains or PidGains()
    controller = controller or PidState()
    values = _signal("reference", reference)
    if camera is None:
        camera = CameraRealisation(np.zeros(values.size), np.zeros(values.size, dtype=np.bool_), 0.0)
    if len(camera) != values.size:
        msg = (
            f"closed loop: the camera was realised for {len(camera)} samples, the reference has {values.size}"
        )
        raise PlantError(msg)
    temperature, pwm = kernels.closed_loop(
        _constants(parameters, driver or Driver(), gains.period),
        gains.constants,
        values,
        camera.noise,
        camera.frozen,
        float(camera.resolution),
        require_kelvin("closed loop: plate", plate),
        require_kelvin("closed loop: sink", parameters.ambient if sink is None else sink),
        require_kelvin("closed loop: sensor", plate if sensor is None else sensor),
        float(controller.integral),
        float(controller.previous_error),
    )
    return Response(temperature, pwm)


def noise_sensitivity(
    parameters: RigParameters,
    reference: ArrayLike,
    *,
    plate: float,
    sink: float | None = None,
    sensor: float | None = None,
    controller: PidState | None = None,
    gains: PidGains | None = None,
    driver: Driver | None = None,
) -> FloatArray:
    """How the closed loop answers to the camera's noise: shape (N, 2, N), arguments as above.

    Element [k, 0, j] is the derivative of the reading at sample j by the noise of sample k, element
    [k, 1, j] that of the PWM in counts per °C.

    Raises:
        PlantError: as `simulate_closed_loop`.
    """
    gains = gains or PidGains()
    controller = controller or PidState()
    return kernels.noise_sensitivity(
        _constants(parameters, driver or Driver(), gains.period),
        gains.constants,
        _signal("reference", reference),
        _NOISE_STEP,
        require_kelvin("closed loop: plate", plate),
        require_kelvin("closed loop: sink", parameters.ambient if sink is None else sink),
        require_kelvin("closed loop: sensor", plate if sensor is None else sensor),
        float(controller.integral),
        float(controller.previous_error),
    )


def simulate_window(
    parameters: RigParameters,
    window: Window,
    *,
    gains: PidGains | None = None,
    camera: Camera | None = None,
    seed: int = 0,
) -> Response:
    """Run the closed loop on a window's reference, from its measured start; shape (N − 2,).

    It starts at the third sample, its plate where that was measured: the first two give the controller's
    state. A camera is realised with `seed`.

    Raises:
        PlantError: the window has fewer than three samples, or as `simulate_closed_loop`.
    """
    if len(window) < 3:
        msg = f"window: it has {len(window)} samples; the twin starts at the third, give at least three"
        raise PlantError(msg)
    reference = window.reference[2:]
    return simulate_closed_loop(
        parameters,
        reference,
        plate=float(window.output[2]) + KELVIN,
        controller=controller_state(window, gains),
        gains=gains,
        camera=None if camera is None else camera.realise(len(reference), window.period, seed),
    )


def simulate_driven(
    parameters: RigParameters,
    pwm: ArrayLike,
    *,
    plate: float,
    sink: float | None = None,
    sensor: float | None = None,
    period: float = 1.0,
    driver: Driver | None = None,
) -> Response:
    """Run the plate under a given PWM (shape (N,)), each value held for `period` seconds.

    Start temperatures as in `simulate_closed_loop`.

    Raises:
        PlantError: a start temperature, the PWM or the period is unfit, or the parameters are too stiff.
    """
    values = _signal("pwm", pwm)
    temperature = kernels.driven(
        _constants(parameters, driver or Driver(), period),
        values,
        require_kelvin("driven plant: plate", plate),
        require_kelvin("driven plant: sink", parameters.ambient if sink is None else sink),
        require_kelvin("driven plant: sensor", plate if sensor is None else sensor),
    )
    return Response(temperature, values)


def advance(
    parameters: RigParameters,
    state: PlantState,
    pwm: float,
    period: float = 1.0,
    driver: Driver | None = None,
) -> PlantState:
    """The plant one tick later; to the last bit what the simulations do between two samples.

    Raises:
        PlantError: the PWM is not finite, the period unfit, or the parameters are too stiff.
    """
    if not math.isfinite(pwm):
        msg = f"plant: pwm is {pwm}; the plant takes only finite values"
        raise PlantError(msg)
    rig = _constants(parameters, driver or Driver(), period)
    return PlantState(
        *kernels.tick(rig, float(state.plate), float(state.sink), float(state.sensor), float(pwm))
    )


def _constants(parameters: RigParameters, driver: Driver, period: float) -> kernels.Constants:
    if not (math.isfinite(period) and period > 0):
        msg = f"plant: the period is {period} s; it must be finite and positive"
        raise PlantError(msg)
    return kernels.Constants(
        seebeck=parameters.seebeck,
        resistance=parameters.resistance,
        loop_resistance=parameters.resistance + driver.bridge_resistance,
        conductance=parameters.conductance,
        heat_capacity=parameters.heat_capacity,
        ambient=parameters.ambient,
        sink_heat_capacity=parameters.sink_heat_capacity,
        sink_convection=parameters.sink_convection,
        sensor_lag=parameters.sensor_lag,
        seebeck_slope=parameters.seebeck_slope,
        drive_ripple=parameters.drive_ripple,
        supply=float(driver.supply),
        volts_per_count=driver.volts_per_count,
        current_limit=float(driver.current_limit),
        period=float(period),
        substeps=_substeps(parameters, driver, period),
    )


def _substeps(parameters: RigParameters, driver: Driver, period: float) -> int:
    """Steps per tick that Runge–Kutta, or the lag of a plate solved exactly, asks for."""
    exact = not parameters.sink_has_mass and parameters.seebeck_slope == 0.0
    if exact and parameters.sensor_lag == 0.0:
        return 1
    a = parameters.seebeck + abs(parameters.seebeck_slope) * (_HOT - SEEBECK_REFERENCE)
    module = a * driver.current_limit + parameters.conductance
    module += a * a * _HOT / (parameters.resistance + driver.bridge_resistance)
    plate_rate = module / parameters.heat_capacity
    sink_rate = (module + parameters.sink_convection) / parameters.sink_heat_capacity
    steps = math.ceil(period * (plate_rate + sink_rate) / (_LAGGED_STEP if exact else _STEP_OF_FASTEST_RATE))
    if steps > _MOST_SUBSTEPS:
        msg = (
            f"plant: a time constant of {1 / (plate_rate + sink_rate):.2g} s is too short for a period of "
            f"{period:g} s; raise heat_capacity or sink_heat_capacity, or lower conductance, convection"
        )
        raise PlantError(msg)
    return max(steps, 1)


def _signal(name: str, values: ArrayLike) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    if array.ndim != 1:
        msg = f"plant: {name} has shape {array.shape}; give one value per sample"
        raise PlantError(msg)
    bad = np.flatnonzero(~np.isfinite(array))
    if bad.size:
        msg = f"plant: {name} is {array[bad[0]]} at sample {int(bad[0])}; only finite values can be used"
        raise PlantError(msg)
    return array
