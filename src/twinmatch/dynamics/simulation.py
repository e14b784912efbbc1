"""Simulation of a plant: in closed loop, driven by a given input, or one sample at a time.

All three use the same compiled tick, so that a twin stepped live and a simulation of the whole run agree
to the last bit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.dynamics.declarations import PlantError
from twinmatch.dynamics.laws import NO_LAW, LawCode
from twinmatch.dynamics.loop import Law, PidGains, state_of
from twinmatch.dynamics.plant import Parameters, Plant
from twinmatch.dynamics.sensor import Sensor, SensorRealisation
from twinmatch.signals import FloatArray, Window, column_of, finite, only

_MOST_PARTS: Final = 4096
"""Most parts of a time for which a plant is simulated at once; each may take 2000 steps."""
SKIPPED = 2
"""A closed-loop twin starts at a window's third sample, where the controller's state is known."""


class FromPlantFile(Enum):
    """Placeholder for the plant file's controller, which may be unknown."""

    LOOP = "plant file"


FROM_PLANT_FILE: Final = FromPlantFile.LOOP

LoopLaw = Law | FromPlantFile | None
"""A controller; `FROM_PLANT_FILE`; or None if the loop is not known: the recorded input drives the twin."""


def law_for(
    plant: type[Plant], period: float, law: LoopLaw = FROM_PLANT_FILE
) -> Law | None:
    """The controller of a closed-loop twin at a sample time, s; None for a driven twin.

    Raises:
        PlantError: the plant file's holds at another sample time only.
    """
    if not isinstance(law, FromPlantFile):
        return law
    try:
        return plant.loop and plant.loop.at_period(period)
    except PlantError as error:
        raise PlantError(f"plant {plant.name}: {error}, or set loop: unknown") from None


def law_of(plant: type[Plant], period: float) -> Law:
    """The plant's controller at a sample time, s.

    Raises:
        PlantError: the plant's controller is not known.
    """
    law = law_for(plant, period)
    if law is None:
        raise PlantError(
            f"plant {plant.name}: its controller is not known; use the driven twin"
        )
    return law


def law_code(
    law: Law | None, state: ArrayLike | None = None
) -> tuple[LawCode, FloatArray]:
    """The law for compiled code (without a loop: the references are the commands), and its state, by default
    zero."""
    if law is None:
        return NO_LAW, np.zeros(0)
    return law.code, state_of(law, state)


def n_references(plant: type[Plant], loop: Law | None) -> int:
    """Number of set-points of a loop around a plant; of a driven plant, its inputs.

    Raises:
        PlantError: the controller is one for another number of outputs or inputs, or reads an output that its
            own command changes at once.
    """
    if loop is None:
        return len(plant.drives)
    if _has_instant(plant, tuple(plant.structures)):
        raise PlantError(
            f"plant {plant.name}: an output depends on a drive at the same instant, so a controller reads "
            "what its command changes; leave out the loop (its input drives the twin), or add a state between"
        )
    sizes = loop.n_outputs, loop.n_inputs
    if sizes != (len(plant.outputs), len(plant.drives)):
        raise PlantError(
            f"plant {plant.name}: a controller for {sizes[0]} outputs and {sizes[1]} inputs is given; the "
            f"plant has {len(plant.outputs)} and {len(plant.drives)}"
        )
    return loop.n_references


@cache
def _has_instant(plant: type[Plant], structures: tuple[str, ...]) -> bool:
    """Whether an output depends on a drive at the same instant in one of a plant's structures."""
    return any(plant.model(name).instant for name in structures)


def pid_of(plant: type[Plant]) -> PidGains:
    """The plant's controller at 1 s, where only a PID will do.

    Raises:
        PlantError: it is not known, or another law.
    """
    law = law_of(plant, 1.0)
    if not isinstance(law, PidGains):
        raise PlantError(
            f"plant {plant.name}: its controller is a {type(law).__name__}; this needs a PID"
        )
    return law


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """Result of a simulation, sample by sample."""

    outputs: FloatArray
    """y, shape (N, o); the sensor's readings, if there is one."""
    inputs: FloatArray
    """u, shape (N, m)."""
    states: FloatArray
    """States at every sample and one period after the last, shape (N + 1, n)."""
    steps: int
    """Runge–Kutta steps per sample."""

    def alone(self, k: int) -> Response:
        """Its k-th output and input; of fewer the last."""
        return replace(
            self, outputs=column_of(self.outputs, k), inputs=column_of(self.inputs, k)
        )

    @property
    def output(self) -> FloatArray:
        """y of a plant with one output, shape (N,)."""
        return only("output", self.outputs)

    @property
    def input(self) -> FloatArray:
        """u of a plant with one input, shape (N,)."""
        return only("input", self.inputs)


def begin(
    parameters: Parameters,
    output: ArrayLike,
    *,
    input: ArrayLike | None = None,
    disturbances: FloatArray | None = None,
    starts: Mapping[str, float] | None = None,
) -> FloatArray:
    """Initial states, shape (n,), of a plant of which only the outputs, shape (o,), the inputs until then
    (default: the drives at rest), shape (m,), and `starts` are known. A single value may be a number.

    Raises:
        PlantError: a name in `starts` is not a state, or a value is not finite.
    """
    model = parameters.model
    y = model.row_of("outputs", output)
    before = model.row_of("inputs", model.rest if input is None else input)
    row = model.disturbance_row(disturbances)
    states, _, _ = model.kernels.begin(parameters.vector, y, before, row)
    for name, value in (starts or {}).items():
        if name not in model.states:
            raise PlantError(
                f"{model.title}: no state {name!r}; it has {', '.join(model.states)}"
            )
        states[model.states.index(name)] = value
    if not finite(states):
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
        window.outputs[SKIPPED],
        input=window.inputs[SKIPPED - (not parameters.model.instant)],
        disturbances=window.disturbances[SKIPPED],
        starts=starts,
    )


def advance(
    parameters: Parameters,
    states: FloatArray,
    input: ArrayLike,
    period: float,
    disturbances: FloatArray | None = None,
) -> FloatArray:
    """States, shape (n,), one period (s) later under inputs, shape (m,), bit for bit as in the simulations.

    Raises:
        PlantError: an input is not finite, the period invalid, or the plant too fast for it.
    """
    model = parameters.model
    u = model.row_of("inputs", input)
    row = model.disturbance_row(disturbances)
    after = model.kernels.advance(
        parameters.vector, states, u, row, float(period), parameters.steps(period)
    )
    return np.asarray(after, dtype=np.float64)


def advance_long(
    parameters: Parameters,
    states: FloatArray,
    input: ArrayLike,
    time: float,
    disturbances: FloatArray | None = None,
) -> FloatArray:
    """States, shape (n,), after a time (s) of any length under inputs, shape (m,), that do not change.

    As `advance` if the plant is slow enough for that; else in equal parts, as few as 1, 2, 4, … allow.

    Raises:
        PlantError: as `advance`, of parts far shorter than a sample of any plant.
    """
    parts = 1
    while parts < _MOST_PARTS and not parameters.can_step(time / parts):
        parts *= 2
    for _ in range(parts):
        states = advance(parameters, states, input, time / parts, disturbances)
    return states


def advance_side_by_side(
    plants: Sequence[Parameters],
    states: FloatArray,
    input: ArrayLike,
    period: float,
    disturbances: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """States, shape (k, n), of several plants of one model one period (s) later, and their outputs, (k, o).

    In one call, since a call costs more than a step does; otherwise as `advance`.

    Raises:
        PlantError: as `advance`.
    """
    model = plants[0].model
    u = model.row_of("inputs", input)
    row = model.disturbance_row(disturbances)
    vectors = np.array([plant.vector for plant in plants])
    steps = max(plant.steps(period) for plant in plants)
    after, outputs = model.kernels.advance_side_by_side(
        vectors, states, u, row, float(period), steps
    )
    return after, outputs


def read(
    parameters: Parameters,
    states: FloatArray,
    disturbances: FloatArray | None = None,
    input: ArrayLike | None = None,
) -> float:
    """The output y of a plant with one output, at some states, shape (n,); see `readings`."""
    return float(only("output", readings(parameters, states, disturbances, input)))


def readings(
    parameters: Parameters,
    states: FloatArray,
    disturbances: FloatArray | None = None,
    input: ArrayLike | None = None,
) -> FloatArray:
    """The outputs y, shape (o,), at some states, shape (n,), and inputs (default: the drives at rest), which
    count where an output depends on them at once."""
    model = parameters.model
    row = model.disturbance_row(disturbances)
    u = model.rest if input is None else model.row_of("inputs", input)
    outputs: FloatArray = model.kernels.outputs_at(parameters.vector, states, u, row)[0]
    return outputs


def quantities(
    parameters: Parameters,
    states: FloatArray,
    input: ArrayLike,
    disturbances: FloatArray | None = None,
) -> dict[str, float]:
    """The plant's other quantities (currents, heat flows) at some states and input, by name."""
    model = parameters.model
    row = model.disturbance_row(disturbances)
    u = model.row_of("inputs", input)
    _, values = model.kernels.outputs_at(parameters.vector, states, u, row)
    return dict(zip(model.kernels.QUANTITIES, values.tolist(), strict=True))


def simulate_closed_loop(
    parameters: Parameters,
    reference: ArrayLike,
    *,
    states: FloatArray,
    controller: ArrayLike | None = None,
    law: Law | None = None,
    disturbances: ArrayLike | None = None,
    sensor: SensorRealisation | None = None,
) -> Response:
    """Run plant, sensor and controller over set-points, shape (N,) or (N, r), from `states` on.

    `controller` is the controller's state before the first sample; the default `law` is that of the plant
    file, at 1 s. Disturbances have shape (N, d). Without a sensor the controller gets the outputs themselves.

    Raises:
        PlantError: a signal is invalid, or the plant is too fast for the period.
    """
    law = law or law_of(parameters.model.plant, 1.0)
    return _run(
        parameters,
        "reference",
        reference,
        states,
        law,
        controller,
        disturbances,
        sensor,
        law.period,
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
    """Run the plant under given inputs, shape (N,) or (N, m), each held for `period` seconds.

    Raises:
        PlantError: as `simulate_closed_loop`.
    """
    return _run(
        parameters, "input", input, states, None, None, disturbances, sensor, period
    )


def simulate_window(
    parameters: Parameters,
    window: Window,
    *,
    law: LoopLaw = FROM_PLANT_FILE,
    sensor: Sensor | None = None,
    seed: int = 0,
    starts: Mapping[str, float] | None = None,
) -> Response:
    """Simulate a window from its measured start: the closed loop on its reference, or, without a law, the
    plant under its input; shape (N − 2,).

    It starts at the third sample: the first two give the controller's state. A sensor is realised with
    `seed`.

    Raises:
        PlantError: the window has fewer than three samples, or as `simulate_closed_loop`.
    """
    if len(window) <= SKIPPED:
        msg = f"window: it has {len(window)} samples; the twin starts at the third, give at least three"
        raise PlantError(msg)
    loop = law_for(parameters.model.plant, window.period, law)
    states = begin_window(parameters, window, starts)
    realisation = (
        None
        if sensor is None
        else sensor.realise(len(window) - SKIPPED, window.period, seed)
    )
    name = "input"
    signal = window.inputs
    state = None
    period = window.period
    if loop is not None:
        name = "reference"
        signal = window.references
        state = loop.state(window)
        period = loop.period
    disturbances = window.disturbances[SKIPPED:]
    return _run(
        parameters,
        name,
        signal[SKIPPED:],
        states,
        loop,
        state,
        disturbances,
        realisation,
        period,
    )


def _run(  # noqa: PLR0917
    parameters: Parameters,
    name: str,
    signal: ArrayLike,
    states: FloatArray,
    loop: Law | None,
    controller: ArrayLike | None,
    disturbances: ArrayLike | None,
    sensor: SensorRealisation | None,
    period: float,
) -> Response:
    """Simulate the loop on set-points or, without one, the plant under its inputs."""
    model = parameters.model
    references = signal_rows(model.title, name, signal, n_references(model.plant, loop))
    size = len(references)
    measured = len(model.plant.outputs)
    code, memory = law_code(loop, controller)
    noise = np.zeros((size, measured))
    frozen = np.zeros(size, dtype=np.bool_)
    resolution = 0.0
    if sensor is not None:
        if len(sensor) != size:
            msg = f"{model.title}: the sensor is realised for {len(sensor)} samples; realise it for {size}"
            raise PlantError(msg)
        noise[:] = sensor.noise if sensor.noise.ndim == 2 else sensor.noise[:, None]
        frozen = np.array(sensor.frozen)
        resolution = float(sensor.resolution)
    steps = parameters.steps(period)
    outputs, inputs, state_rows = model.kernels.run(
        parameters.vector,
        np.array(states, dtype=np.float64),
        code,
        memory,
        references,
        model.disturbance_rows(disturbances, size),
        noise,
        frozen,
        resolution,
        float(period),
        steps,
    )
    return Response(outputs, inputs, state_rows, steps)


def signal_rows(
    title: str, name: str, values: ArrayLike | None, columns: int
) -> FloatArray:
    """A signal as rows of a sample each, shape (N, columns); of one column also given as shape (N,).

    Raises:
        PlantError: it has another shape, or a value is not finite.
    """
    array = np.array(values, dtype=np.float64)
    rows = array[:, None] if array.ndim == 1 and columns == 1 else array
    if rows.ndim != 2 or rows.shape[1] != columns:
        per_sample = "one value" if columns == 1 else f"{columns} values"
        raise PlantError(
            f"{title}: {name} has shape {array.shape}; give {per_sample} per sample"
        )
    if not finite(rows):
        bad = int(np.argmin(np.isfinite(rows).all(axis=1)))
        shown = rows[bad, 0] if columns == 1 else rows[bad]
        raise PlantError(
            f"{title}: {name} is {shown} at sample {bad}; only finite values can be used"
        )
    return np.ascontiguousarray(rows)
