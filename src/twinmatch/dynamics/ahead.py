"""Forecasts: the loop simulated beyond the newest sample, with the variances of output and input."""

# ruff: noqa: PLR0917 (a kernel takes arrays in a row)

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.compiled import compiled
from twinmatch.dynamics.closing import gains_of
from twinmatch.dynamics.errors import PlantError
from twinmatch.dynamics.noise import around_loop
from twinmatch.dynamics.parameters import Parameters
from twinmatch.dynamics.pid import PidGains, PidState
from twinmatch.dynamics.pid_step import Gains
from twinmatch.dynamics.simulation import NO_GAINS
from twinmatch.signals import FloatArray

__all__ = ["Foretold", "foretell"]


class Foretold(NamedTuple):
    """Forecast of the N samples after the newest one, shape (N,) each."""

    output: FloatArray
    """y simulated from the mean states and parameters, without noise."""
    input: FloatArray
    """u of the same run."""
    output_variance: FloatArray
    """Variance of the sensor's reading, including its noise."""
    input_variance: FloatArray
    """Variance of the command that the controller computes from such readings; zero if inputs are given."""


def foretell(
    parameters: Parameters,
    *,
    states: FloatArray,
    covariance: ArrayLike,
    input: float,
    drift: ArrayLike,
    unsure: Sequence[str] = (),
    reference: ArrayLike | None = None,
    controller: PidState | None = None,
    gains: PidGains | None = None,
    inputs: ArrayLike | None = None,
    period: float = 1.0,
    disturbances: ArrayLike | None = None,
    noise: float | None = None,
) -> Foretold:
    """Simulate the closed loop, or a plant under known inputs, beyond the newest sample.

    The mean is that of `advance` and `simulate_closed_loop` (or `simulate_driven`). The variances are those
    of small deviations from it, exact around the loop; where u is on a limit, its variance is zero. They
    include the uncertainty of states and parameters, the drift of the states, and the sensor's noise as it
    circulates in the loop.

    Args:
        parameters: the plant.
        states: states at the newest sample, corrected by its reading, shape (n,).
        covariance: covariance of states and the m parameters `unsure`, shape (n + m, n + m); symmetric.
        input: u of the newest sample, which acts until the next.
        drift: standard deviation of the drift of each state from the equations per second, shape (n,).
        unsure: names of the parameters in the covariance.
        reference: set-points from the next sample on, shape (N,): the closed loop.
        controller: state of the PID after the newest sample.
        gains: gains of the controller; default: the plant file's, at 1 s.
        inputs: u from the next sample on, shape (N,), instead of a reference: the driven plant.
        period: sample time of a driven plant, s; for the loop the controller's is used.
        disturbances: constant, shape (d,), or from the newest sample on, shape (N + 1, d).
        noise: standard deviation of a reading; default: the plant file's.

    Raises:
        PlantError: a signal or a name is invalid, the controller is not known, or the plant is too fast.
    """
    model = parameters.model
    if (reference is None) == (inputs is None):
        raise PlantError(
            f"{model.title}: a forecast takes set-points ahead or inputs ahead; give one of the two"
        )
    unknown = [name for name in unsure if name not in model.names]
    if unknown:
        raise PlantError(f"{model.title}: no parameter {unknown[0]!r}; there are {', '.join(model.names)}")
    closed, n, m = reference is not None, len(model.states), len(unsure)
    held = (gains or gains_of(model.plant, 1.0)) if closed else NO_GAINS
    signal = _fit(model.title, "set-points" if closed else "inputs", reference if closed else inputs, None)
    at, joint = (
        _fit(model.title, name, values, shape)
        for name, values, shape in (("states", states, (n,)), ("covariance", covariance, (n + m, n + m)))
    )
    noise = model.plant.output.noise if noise is None else noise
    u, noise = _fit(model.title, "newest input and noise", (input, noise), (2,)).tolist()
    period = float(held.period if closed else period)
    strayed = np.zeros(n + m)
    strayed[:n] = np.square(_fit(model.title, "drift", drift, (n,))) * period
    if disturbances is not None and np.ndim(disturbances) == 1:
        disturbances = np.tile(model.disturbance_row(disturbances), (signal.size + 1, 1))
    rows, steps = model.disturbance_rows(disturbances, signal.size + 1), parameters.steps(period)
    kernels, vector = model.kernels_by(unsure), parameters.vector
    which = np.array([[kernels.UNKNOWN.index(name) for name in unsure]] * 2, dtype=np.int64).reshape(2, m)
    begun = kernels.advance(vector, at, u, rows[0], period, steps)
    kernels.predict(vector, at, joint, strayed, u, rows[0], period, steps, which, np.zeros((n, m + n + 1)))
    memory = controller or PidState()
    ahead = (float(memory.integral), float(memory.previous), period, steps)
    loop, size = (closed, held.constants, signal, signal, rows[1:]), signal.size
    still = (np.zeros(size), np.zeros(size, dtype=np.bool_), 0.0)
    # The mean is simulated without derivatives, like every simulation: derivatives share subexpressions with
    # the rates, which then round differently.
    output, commanded, _ = kernels.run(vector, begun, *loop, *still, *ahead)
    columns, compared = np.eye(n, m + n, m), np.zeros((2, size))
    _, _, by, by_state, by_drive, free, seen, _ = kernels.run_with_tangents(
        vector, which[0], begun, columns, *loop, *ahead, compared, compared, False, True, np.inf
    )
    variances = _variances(
        joint, by, by_state, by_drive, free, seen, held.constants, closed, noise * noise, strayed
    )
    return Foretold(output, commanded, *variances)


def _fit(title: str, name: str, values: ArrayLike | None, shape: tuple[int, ...] | None) -> FloatArray:
    """Copy values into an array for the compiled code, and check shape and values."""
    array = np.array(values, dtype=np.float64)
    wanted = (array.size,) if shape is None else shape
    if array.shape != wanted or not np.isfinite(array).all():
        what = "one finite value per sample" if shape is None else f"finite values of shape {wanted}"
        bad = f"of shape {array.shape}" if array.shape != wanted else "with a value that is not finite"
        raise PlantError(f"{title}: {name} {bad} given; give {what}")
    return array


@compiled
def _variances(
    joint: FloatArray, by: FloatArray, by_state: FloatArray, by_drive: FloatArray, free: FloatArray,
    seen: FloatArray, gains: Gains, closed: bool, noise: float, strayed: FloatArray,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Variances of output and input, shape (N,) each.

    `by`, shape (2, N, m + n), holds their derivatives by parameters and states at the first sample, `joint`
    the covariance of states and parameters there, and `noise` is a variance. Later noise and drift enter the
    covariance of the loop's own state: plant states, integral, error.
    """
    size, nx = seen.shape
    both, m = joint.shape[0], nx + 2
    of_output, of_input = np.zeros(size), np.zeros(size)
    a, b, of_u = np.zeros((m, m)), np.zeros(m), np.zeros(m)
    later, way, of_y = np.zeros((m, m)), np.zeros((m, m)), np.zeros(m)
    first = np.zeros((both, both))  # in the order of `by`
    for i in range(both):
        for j in range(both):
            first[i, j] = joint[(i + nx) % both, (j + nx) % both]
    for k in range(size):
        noise_u = around_loop(gains, closed, free[k], seen[k], by_state[k], by_drive[k], a, b, of_u)
        for i in range(nx):
            of_y[i] = seen[k, i]
        y = noise + _form(first, by[0, k]) + _form(later, of_y)
        u = noise_u * noise_u * noise + _form(first, by[1, k]) + _form(later, of_u)
        of_output[k], of_input[k] = max(y, 0.0), max(u, 0.0)
        for i in range(m):
            for j in range(m):
                total = 0.0
                for q in range(m):
                    total += a[i, q] * later[q, j]
                way[i, j] = total
        for i in range(m):
            for j in range(i + 1):
                total = noise * b[i] * b[j] + (strayed[i] if i == j and i < nx else 0.0)
                for q in range(m):
                    total += way[i, q] * a[j, q]
                later[i, j] = total
                later[j, i] = total
    return of_output, of_input


@compiled(innermost=True)
def _form(of: FloatArray, b: FloatArray) -> float:
    """bᵀ·of·b for a symmetric matrix `of`."""
    total = 0.0
    for i in range(b.size):
        side = 0.0
        for j in range(i):
            side += of[i, j] * b[j]
        total += b[i] * (2.0 * side + of[i, i] * b[i])
    return total
