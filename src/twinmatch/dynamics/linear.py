"""Equilibrium of a plant at an operating point, and its linearisation there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.dynamics.declarations import PlantError
from twinmatch.dynamics.plant import Parameters
from twinmatch.signals import FloatArray

MOST_STEPS = 60
STEADY = 1e-9
"""Newton step, in units of the states' spans and the drive's range, below which the equilibrium is found."""


class Rest(NamedTuple):
    """An equilibrium."""

    states: FloatArray
    """States, shape (n,)."""
    input: float


class Linear(NamedTuple):
    """x[k+1] = A·x[k] + B·u[k], y[k] = C·x[k], as deviations from `rest`: exact for small deviations."""

    A: FloatArray
    """Shape (n, n)."""
    B: FloatArray
    """Shape (n, 1)."""
    C: FloatArray
    """Shape (1, n)."""
    period: float
    """Sample time, s."""
    rest: Rest
    """The point of linearisation: an equilibrium or, for `linearised_at`, a point that is passed through."""


def rest_at(parameters: Parameters, output: float, disturbances: ArrayLike | None = None) -> Rest:
    """The states and the input of the equilibrium with this output.

    Raises:
        PlantError: no input within the drive's limits holds it there.
    """
    model = parameters.model
    row, drive = model.disturbance_row(disturbances), model.plant.drive
    states, _, _ = model.kernels.begin(parameters.vector, float(output), float(drive.rest), row)
    low, high = np.array([state.span for state in model.declared_states], dtype=np.float64).T
    scales = np.append(high - low, drive.limits[1] - drive.limits[0])
    u = drive.rest
    for _ in range(MOST_STEPS):
        f, fx, fu, _, hx, _ = model.kernels.slopes_at(parameters.vector, states, u, row)
        off = model.kernels.outputs_at(parameters.vector, states, u, row)[0] - output
        slopes = np.block([[fx, fu[:, None]], [hx[None, :], np.zeros((1, 1))]]) * scales
        size = np.max(np.abs(slopes), axis=1)
        if not (np.isfinite(slopes).all() and (size > 0).all()):
            break
        slopes = slopes / size[:, None]
        if np.linalg.matrix_rank(slopes) < scales.size:
            break
        step = np.linalg.solve(slopes, -np.append(f, off) / size) * scales
        # Outside the plant's range its equations may be invalid: move by at most half the range per step.
        states = np.clip(states + step[:-1], states - 0.5 * scales[:-1], states + 0.5 * scales[:-1])
        u = float(np.clip(u + step[-1], drive.limits[0] - scales[-1], drive.limits[1] + scales[-1]))
        if np.max(np.abs(step) / scales) <= STEADY:
            if drive.limits[0] <= u <= drive.limits[1]:
                return Rest(states, u)
            break
    unit, name = model.plant.output.unit, drive.unit or drive.name
    raise PlantError(
        f"{model.title}: no {name} between {drive.limits[0]:g} and {drive.limits[1]:g} holds it at "
        f"{output:g} {unit}; give an operating point at which it can be held"
    )


def linearised(
    parameters: Parameters, output: float, period: float, disturbances: ArrayLike | None = None
) -> Linear:
    """The plant sampled with a period (s), linearised at the equilibrium with this output.

    Raises:
        PlantError: as `rest_at`, or the plant is too fast for the period.
    """
    rest = rest_at(parameters, output, disturbances)
    return linearised_at(parameters, rest.states, rest.input, period, disturbances)


def linearised_at(
    parameters: Parameters,
    states: FloatArray,
    input: float,
    period: float,
    disturbances: ArrayLike | None = None,
) -> Linear:
    """The plant sampled with a period (s), linearised at given states, shape (n,), and input.

    Raises:
        PlantError: the plant is too fast for the period.
    """
    model = parameters.model
    row, steps, n = model.disturbance_row(disturbances), parameters.steps(period), states.size
    slopes, nowhere = np.zeros((n, n + 1)), np.zeros((2, 0), dtype=np.int64)
    model.kernels.predict(
        parameters.vector, states.copy(), np.zeros((n, n)), np.zeros(n), float(input), row, float(period),
        steps, nowhere, slopes,
    )  # fmt: skip
    _, _, _, _, hx, _ = model.kernels.slopes_at(parameters.vector, states, float(input), row)
    return Linear(slopes[:, :n].copy(), slopes[:, n:].copy(), hx[None, :], period, Rest(states, input))
