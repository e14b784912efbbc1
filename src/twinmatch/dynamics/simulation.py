"""Simulation of a plant: in closed loop, driven by a given input, or one sample at a time.

All three use the same compiled tick, so that a twin stepped live and a simulation of the whole run agree
to the last bit.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.dynamics.declarations import PlantError
from twinmatch.dynamics.loop import PidGains, PidState, Sensor, SensorRealisation, controller_state
from twinmatch.dynamics.plant import Parameters, Plant
from twinmatch.signals import FloatArray, Window

SKIPPED = 2
"""A closed-loop twin starts at a window's third sample, where the controller's state is known."""
NO_GAINS = PidGains(0.0, 0.0, 0.0, 0.0, -1.0, 1.0)
"""Placeholder where a compiled run takes gains that it will not use."""


class FromPlantFile(Enum):
    """Placeholder for the plant file's controller, which may be unknown."""

    LOOP = "plant file"


FROM_PLANT_FILE: Final = FromPlantFile.LOOP

LoopGains = PidGains | FromPlantFile | None
"""A controller; `FROM_PLANT_FILE`; or None if the loop is not known: the recorded input drives the twin."""


def gains_for(plant: type[Plant], period: float, gains: LoopGains = FROM_PLANT_FILE) -> PidGains | None:
    """The controller of a closed-loop twin at a sample time, s; None for a driven twin."""
    if not isinstance(gains, FromPlantFile):
        return gains
    loop = plant.loop
    return loop if loop is None or loop.period == period else dataclasses.replace(loop, period=period)


def gains_of(plant: type[Plant], period: float) -> PidGains:
    """The plant's controller at a sample time, s.

    Raises:
        PlantError: the plant's controller is not known.
    """
    gains = gains_for(plant, period)
    if gains is None:
        msg = f"plant {plant.name}: its controller is not known; use the driven twin"
        raise PlantError(msg)
    return gains


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """Result of a simulation, sample by sample."""

    output: FloatArray
    """y, shape (N,); the sensor's readings, if there is one."""
    input: FloatArray
    """u, shape (N,)."""
    states: FloatArray
    """States at every sample and one period after the last, shape (N + 1, n)."""
    steps: int
    """Runge–Kutta steps per sample."""


def begin(
    parameters: Parameters,
    output: float,
    *,
    input: float | None = None,
    disturbances: FloatArray | None = None,
    starts: Mapping[str, float] | None = None,
) -> FloatArray:
    """Initial states, shape (n,), of a plant of which only the output, the input until then (default: the
    drive at rest) and `starts` are known.

    Raises:
        PlantError: a name in `starts` is not a state, or a value is not finite.
    """
    model = parameters.model
    before = model.plant.drive.rest if input is None else input
    row = model.disturbance_row(disturbances)
    states, _, _ = model.kernels.begin(parameters.vector, float(output), float(before), row)
    for name, value in (starts or {}).items():
        if name not in model.states:
            msg = f"{model.title}: no state {name!r}; it has {', '.join(model.states)}"
            raise PlantError(msg)
        states[model.states.index(name)] = value
    if not np.isfinite(states).all():
        raise PlantError(
            f"{model.title}: its initial states are {states.tolist()}; only finite values can be used"
        )
    return np.asarray(states, dtype=np.float64)


def begin_window(
    parameters: Parameters, window: Window, starts: Mapping[str, float] | None = None
) -> FloatArray:
    """Initial states, shape (n,), at the third sample of a window, where its simulations start.

    Raises:
        PlantError: as `begin`.
    """
    return begin(
        parameters,
        float(window.output[SKIPPED]),
        input=float(window.input[SKIPPED - 1]),
        disturbances=window.disturbances[SKIPPED],
        starts=starts,
    )


def advance(
    parameters: Parameters,
    states: FloatArray,
    input: float,
    period: float,
    disturbances: FloatArray | None = None,
) -> FloatArray:
    """States, shape (n,), one period (s) later, bit for bit as in the simulations.

    Raises:
        PlantError: the input is not finite, the period invalid, or the plant too fast for it.
    """
    model = parameters.model
    if not math.isfinite(input):
        raise PlantError(f"{model.title}: the input is {input}; the plant takes only finite values")
    row = model.disturbance_row(disturbances)
    after = model.kernels.advance(
        parameters.vector, states, float(input), row, float(period), parameters.steps(period)
    )
    return np.asarray(after, dtype=np.float64)


def read(parameters: Parameters, states: FloatArray, disturbances: FloatArray | None = None) -> float:
    """The output y at some states, shape (n,)."""
    model = parameters.model
    row = model.disturbance_row(disturbances)
    return float(model.kernels.outputs_at(parameters.vector, states, model.plant.drive.rest, row)[0])


def quantities(
    parameters: Parameters, states: FloatArray, input: float, disturbances: FloatArray | None = None
) -> dict[str, float]:
    """The plant's other quantities (currents, heat flows) at some states and input, by name."""
    model = parameters.model
    row = model.disturbance_row(disturbances)
    values = model.kernels.outputs_at(parameters.vector, states, float(input), row)[1]
    return dict(zip(model.kernels.QUANTITIES, values.tolist(), strict=True))


def simulate_closed_loop(
    parameters: Parameters,
    reference: ArrayLike,
    *,
    states: FloatArray,
    controller: PidState | None = None,
    gains: PidGains | None = None,
    disturbances: ArrayLike | None = None,
    sensor: SensorRealisation | None = None,
) -> Response:
    """Run plant, sensor and controller over a reference, shape (N,), from `states` on.

    `controller` is the PID's state before the first sample; default `gains` are those of the plant file, at
    1 s. Disturbances have shape (N, m). Without a sensor the controller gets the output itself.

    Raises:
        PlantError: a signal is invalid, or the plant is too fast for the period.
    """
    model = parameters.model
    gains = gains or gains_of(model.plant, 1.0)
    values = _signal(model.title, "reference", reference)
    return _run(
        parameters,
        values,
        states,
        controller=controller,
        gains=gains,
        disturbances=disturbances,
        sensor=sensor,
    )


def simulate_driven(
    parameters: Parameters,
    input: ArrayLike,
    *,
    states: FloatArray,
    period: float = 1.0,
    disturbances: ArrayLike | None = None,
    sensor: SensorRealisation | None = None,
) -> Response:
    """Run the plant under a given input, shape (N,), each value held for `period` seconds.

    Raises:
        PlantError: as `simulate_closed_loop`.
    """
    values = _signal(parameters.model.title, "input", input)
    return _run(parameters, values, states, disturbances=disturbances, sensor=sensor, period=period)


def simulate_window(
    parameters: Parameters,
    window: Window,
    *,
    gains: LoopGains = FROM_PLANT_FILE,
    sensor: Sensor | None = None,
    seed: int = 0,
    starts: Mapping[str, float] | None = None,
) -> Response:
    """Simulate a window from its measured start: the closed loop on its reference, or, without gains, the
    plant under its input; shape (N − 2,).

    It starts at the third sample: the first two give the controller's state. A sensor is realised with
    `seed`.

    Raises:
        PlantError: the window has fewer than three samples, or as `simulate_closed_loop`.
    """
    if len(window) <= SKIPPED:
        msg = f"window: it has {len(window)} samples; the twin starts at the third, give at least three"
        raise PlantError(msg)
    reference, disturbances = window.reference[SKIPPED:], window.disturbances[SKIPPED:]
    loop = gains_for(parameters.model.plant, window.period, gains)
    states = begin_window(parameters, window, starts)
    seen = None if sensor is None else sensor.realise(reference.size, window.period, seed)
    if loop is None:
        return simulate_driven(
            parameters,
            window.input[SKIPPED:],
            states=states,
            period=window.period,
            disturbances=disturbances,
            sensor=seen,
        )
    return simulate_closed_loop(
        parameters,
        reference,
        states=states,
        controller=controller_state(window, loop),
        gains=loop,
        disturbances=disturbances,
        sensor=seen,
    )


def _run(
    parameters: Parameters,
    signal: FloatArray,
    states: FloatArray,
    *,
    controller: PidState | None = None,
    gains: PidGains | None = None,
    disturbances: ArrayLike | None,
    sensor: SensorRealisation | None,
    period: float = 1.0,
) -> Response:
    """Simulate the loop on a reference if there are gains, otherwise the plant under an input."""
    model = parameters.model
    size, controller = signal.size, controller or PidState()
    closed = gains is not None
    gains = gains or NO_GAINS
    period = gains.period if closed else period
    if sensor is None:
        noise, frozen, resolution = np.zeros(size), np.zeros(size, dtype=np.bool_), 0.0
    elif len(sensor) == size:
        noise, frozen, resolution = np.array(sensor.noise), np.array(sensor.frozen), float(sensor.resolution)
    else:
        msg = f"{model.title}: the sensor is realised for {len(sensor)} samples; realise it for {size}"
        raise PlantError(msg)
    steps = parameters.steps(period)
    output, input_, passed = model.kernels.run(
        parameters.vector, np.array(states, dtype=np.float64), closed, gains.constants, signal, signal,
        model.disturbance_rows(disturbances, size), noise, frozen, resolution, float(controller.integral),
        float(controller.previous), float(period), steps,
    )  # fmt: skip
    return Response(output, input_, passed, steps)


def _signal(title: str, name: str, values: ArrayLike) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    if array.ndim != 1:
        raise PlantError(f"{title}: {name} has shape {array.shape}; give one value per sample")
    finite = np.isfinite(array)
    if not finite.all():
        bad = int(np.argmin(finite))
        msg = f"{title}: {name} is {array[bad]} at sample {bad}; only finite values can be used"
        raise PlantError(msg)
    return array
