"""Equilibrium of a plant at an operating point, and its linearisation there."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.dynamics.declarations import PlantError
from twinmatch.dynamics.loop import LinearLaw
from twinmatch.dynamics.plant import Model, Parameters
from twinmatch.signals import FloatArray, only

MAX_STEPS = 60
STEADY = 1e-9
"""Newton step, in units of the states' spans and the drive's range, below which the equilibrium is found."""


class Rest(NamedTuple):
    """An equilibrium."""

    states: FloatArray
    """States, shape (n,)."""
    inputs: FloatArray
    """Shape (m,)."""

    @property
    def input(self) -> float:
        """The input of a plant with one."""
        return float(only("input", self.inputs))


class Linear(NamedTuple):
    """x[k+1] = A·x[k] + B·u[k], y[k] = C·x[k], as deviations from `rest`: exact for small deviations."""

    A: FloatArray
    """Shape (n, n)."""
    B: FloatArray
    """Shape (n, m)."""
    C: FloatArray
    """Shape (o, n)."""
    period: float
    """Sample time, s."""
    rest: Rest
    """The point of linearisation: an equilibrium or, for `linearised_at`, a point that is passed through."""


def loop_matrix(plant: Linear, law: LinearLaw) -> FloatArray:
    """How the states of a plant and a law around it deviate one sample later, shape (n + q, n + q)."""
    free = np.block(
        [[plant.A, np.zeros((len(plant.A), len(law.A)))], [law.B @ plant.C, law.A]]
    )
    commands = np.hstack([law.D @ plant.C, law.C])
    with np.errstate(over="ignore", invalid="ignore"):
        # the caller looks whether it is finite
        return np.asarray(
            free + np.vstack([plant.B, law.G]) @ commands, dtype=np.float64
        )


def largest_eigenvalue(matrix: FloatArray) -> float:
    """Size of the largest eigenvalue of a square matrix; infinite where one of its values is not finite."""
    return (
        float(np.abs(np.linalg.eigvals(matrix)).max())
        if np.isfinite(matrix).all()
        else math.inf
    )


def rest_at(
    parameters: Parameters, output: ArrayLike, disturbances: ArrayLike | None = None
) -> Rest:
    """The states and the inputs of the equilibrium with these outputs, shape (o,), or a number.

    Raises:
        PlantError: no inputs within the drives' limits hold it there, or the plant has another number of
            inputs than of outputs.
    """
    model = parameters.model
    row = model.disturbance_row(disturbances)
    drives = model.plant.drives
    y = model.row_of("outputs", output)
    if len(drives) != y.size:
        raise PlantError(
            f"{model.title}: it has {len(drives)} inputs and {y.size} outputs; only as many inputs as "
            "outputs hold it at given outputs"
        )
    states, _, _ = model.kernels.begin(parameters.vector, y, model.rest, row)
    low, high = np.array(
        [state.span for state in model.declared_states], dtype=np.float64
    ).T
    least, most = np.array(
        [drive.limits for drive in drives.values()], dtype=np.float64
    ).T
    scales = np.append(high - low, most - least)
    n = states.size
    u = model.rest
    for _ in range(MAX_STEPS):
        step = _newton_step(parameters, Rest(states, u), y, row, scales)
        if step is None:
            break
        # Outside the plant's range its equations may be invalid: move by at most half the range per step.
        states = np.clip(
            states + step[:n], states - 0.5 * scales[:n], states + 0.5 * scales[:n]
        )
        u = np.clip(u + step[n:], least - scales[n:], most + scales[n:])
        if np.max(np.abs(step) / scales) <= STEADY:
            if (least <= u).all() and (u <= most).all():
                return Rest(states, u)
            break
    raise _not_held(model, y)


def _newton_step(
    parameters: Parameters,
    guess: Rest,
    y: FloatArray,
    row: FloatArray,
    scales: FloatArray,
) -> FloatArray | None:
    """The step of states and inputs after which the linearised rates are zero and the outputs y; None if no
    such step is determined."""
    kernels = parameters.model.kernels
    rates, fx, fu, _, hx, _, hu = kernels.slopes_at(
        parameters.vector, guess.states, guess.inputs, row
    )
    outputs = kernels.outputs_at(parameters.vector, guess.states, guess.inputs, row)[0]
    slopes = np.block([[fx, fu], [hx, hu]]) * scales
    size = np.max(np.abs(slopes), axis=1)
    if not (np.isfinite(slopes).all() and (size > 0).all()):
        return None
    slopes = slopes / size[:, None]
    if np.linalg.matrix_rank(slopes) < scales.size:
        return None
    return np.asarray(
        np.linalg.solve(slopes, -np.append(rates, outputs - y) / size) * scales
    )


def _not_held(model: Model, y: FloatArray) -> PlantError:
    drives = model.plant.drives.values()
    ranges = []
    for drive in drives:
        name = (len(drives) == 1 and drive.unit) or drive.name
        low, high = drive.limits
        ranges.append(f"{name} between {low:g} and {high:g}")
    outputs = zip(y, model.plant.outputs.values(), strict=True)
    levels = ", ".join(f"{level:g} {output.unit}".rstrip() for level, output in outputs)
    return PlantError(
        f"{model.title}: no {', '.join(ranges)} holds it at {levels}; give an operating point at which it "
        "can be held"
    )


def linearised(
    parameters: Parameters,
    output: ArrayLike,
    period: float,
    disturbances: ArrayLike | None = None,
) -> Linear:
    """The plant sampled with a period (s), linearised at the equilibrium with these outputs.

    Raises:
        PlantError: as `rest_at`, or the plant is too fast for the period.
    """
    rest_point = rest_at(parameters, output, disturbances)
    return linearised_at(
        parameters, rest_point.states, rest_point.inputs, period, disturbances
    )


def linearised_at(
    parameters: Parameters,
    states: FloatArray,
    input: ArrayLike,
    period: float,
    disturbances: ArrayLike | None = None,
) -> Linear:
    """The plant sampled with a period (s), linearised at given states, shape (n,), and inputs, shape (m,).

    Raises:
        PlantError: the plant is too fast for the period.
    """
    model = parameters.model
    row = model.disturbance_row(disturbances)
    n = states.size
    u = model.row_of("inputs", input)
    slopes = model.kernels.predict(
        parameters.vector,
        states.copy(),
        np.zeros((n, n)),
        np.zeros(n),
        u,
        row,
        float(period),
        parameters.steps(period),
        np.zeros((2, 0), dtype=np.int64),
    )
    *_, hx, _, hu = model.kernels.slopes_at(parameters.vector, states, u, row)
    A = slopes[:, :n].copy()
    B = slopes[:, n:].copy()
    m = u.size
    if hu.any():
        # What acts at once is read before the next command: the inputs of the sample before are states.
        A = np.block([[A, np.zeros((n, m))], [np.zeros((m, n + m))]])
        B = np.vstack([B, np.eye(m)])
        hx = np.hstack([hx, hu])
        states = np.append(states, u)
    return Linear(A, B, hx, period, Rest(states, u))
