"""Forecasts of the loop beyond the newest sample, and the effect of the sensor's noise around the loop."""

# ruff: noqa: PLR0912, PLR0917 (kernels are long and take arrays in a row)

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinmatch.compiled import compiled
from twinmatch.dynamics.declarations import PlantError
from twinmatch.dynamics.experiment import Experiment, Tangents
from twinmatch.dynamics.filters import predict
from twinmatch.dynamics.kernels import Code, advance
from twinmatch.dynamics.loop import Gains, PidGains, PidState
from twinmatch.dynamics.plant import Parameters
from twinmatch.dynamics.runs import run, run_with_tangents
from twinmatch.dynamics.simulation import NO_GAINS, gains_of
from twinmatch.signals import FloatArray


class LoopForecast(NamedTuple):
    """Forecast of the N samples after the newest one, shape (N,) each; variances only where asked for."""

    output: FloatArray
    """y simulated from the mean states and parameters, without noise."""
    input: FloatArray
    """u of the same run."""
    output_variance: FloatArray
    """Variance of the sensor's reading, including its noise."""
    input_variance: FloatArray
    """Variance of the command that the controller computes from such readings; zero if inputs are given."""


def forecast_loop(
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
    banded: bool = True,
) -> LoopForecast:
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
        banded: whether the variances are wanted, two thirds of the work; without, they are empty.

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
    loop_gains = (gains or gains_of(model.plant, 1.0)) if closed else NO_GAINS
    signal = _fit(model.title, "set-points" if closed else "inputs", reference if closed else inputs, None)
    at, joint = (
        _fit(model.title, name, values, shape)
        for name, values, shape in (("states", states, (n,)), ("covariance", covariance, (n + m, n + m)))
    )
    noise = model.plant.output.noise if noise is None else noise
    u, noise = _fit(model.title, "newest input and noise", (input, noise), (2,)).tolist()
    period = float(loop_gains.period if closed else period)
    process_noise = np.zeros(n + m)
    process_noise[:n] = np.square(_fit(model.title, "drift", drift, (n,))) * period
    if disturbances is not None and np.ndim(disturbances) == 1:
        disturbances = np.tile(model.disturbance_row(disturbances), (signal.size + 1, 1))
    rows, steps = model.disturbance_rows(disturbances, signal.size + 1), parameters.steps(period)
    kernels, vector = model.kernels_by(unsure), parameters.vector
    which = np.array([[kernels.UNKNOWN.index(name) for name in unsure]] * 2, dtype=np.int64).reshape(2, m)
    memory, constants = controller or PidState(), loop_gains.constants
    whole = (
        vector, which, at, joint, process_noise, u, closed, constants, signal, rows,
        float(memory.integral), float(memory.previous), period, steps,
    )  # fmt: skip
    return LoopForecast._make(kernels.call(foresee, *whole, noise * noise, banded))


@compiled
def foresee(
    code: Code, vector: FloatArray, which: NDArray[np.int64], x: FloatArray, joint: FloatArray,
    process_noise: FloatArray, u: float, closed: bool, gains: Gains, signal: FloatArray,
    disturbances: FloatArray, integral: float, previous: float, period: float, steps: int, noise: float,
    banded: bool,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Output, input and their variances; `x` and `joint` are those at the newest sample, and are changed."""
    size, n, m, d = signal.size, x.size, which.shape[1], disturbances[1:]
    begun = advance(code, vector, x, u, disturbances[0], period, steps)
    still, never = np.zeros(size), np.zeros(size, dtype=np.bool_)
    # The mean is simulated without derivatives, like every simulation: derivatives share subexpressions with
    # the rates, which then round differently.
    output, commanded, _ = run(
        code, vector, begun, closed, gains, signal, signal, d, still, never, 0.0,
        integral, previous, period, steps,
    )  # fmt: skip
    if not banded:
        return output, commanded, np.zeros(0), np.zeros(0)
    columns, compared = np.zeros((n, m + n + 1)), np.zeros((2, size))
    predict(code, vector, x, joint, process_noise, u, disturbances[0], period, steps, which, columns)
    _, _, by, by_state, by_drive, free, seen, _ = run_with_tangents(
        code, vector, which[0], begun, np.eye(n, m + n, m), closed, gains, signal, signal, d,
        integral, previous, period, steps, compared, compared, False, True, np.inf,
    )  # fmt: skip
    of_output, of_input = _variances(
        joint, by, by_state, by_drive, free, seen, gains, closed, noise, process_noise
    )
    return output, commanded, of_output, of_input


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
    seen: FloatArray, gains: Gains, closed: bool, noise: float, process_noise: FloatArray,
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
        noise_u = _around_loop(gains, closed, free[k], seen[k], by_state[k], by_drive[k], a, b, of_u)
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
                total = noise * b[i] * b[j] + (process_noise[i] if i == j and i < nx else 0.0)
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


def noise_scores(
    experiment: Experiment, tangents: Tangents, weighed: FloatArray, weights: tuple[float, float]
) -> tuple[FloatArray, float]:
    """Effect of white noise in the readings on the sums Σ_j weighed_j·residual_j.

    Args:
        experiment: the experiment.
        tangents: its run.
        weighed: rows of the weighed residuals' Jacobian, shape (2, N, n).
        weights: weights of the residuals of output and input, for noise of 1 in the readings.

    Returns:
        The sums caused by noise of size 1 at each sample alone, shape (N, n), and the mean squared
        residual caused by all of them. Noise of the first reading also shifts the twin's start. For a
        driven twin, noise enters only through the readings it is compared with, and its start.
    """
    return _noise_scores(
        np.ascontiguousarray(tangents.by_state),
        np.ascontiguousarray(tangents.by_drive),
        tangents.free,
        np.ascontiguousarray(tangents.seen),
        experiment.start_slope,
        np.ascontiguousarray(weighed),
        float(weights[0]),
        float(weights[1]) if experiment.closed else 0.0,
        experiment.gains.constants,
        experiment.closed,
    )


@compiled
def _noise_scores(
    by_state: FloatArray,
    by_drive: FloatArray,
    free: FloatArray,
    seen: FloatArray,
    started: FloatArray,
    weighed: FloatArray,
    weight_y: float,
    weight_u: float,
    gains: Gains,
    closed: bool,
) -> tuple[FloatArray, float]:
    """Backwards through the linearised loop, whose state is z = (states, integral, previous).

    `ahead` holds the gradients of the sums by the state one sample later, `power` the quadratic form
    of a disturbed state that gives the sum of the squared residuals from then on.
    """
    size, n, nx = weighed.shape[1], weighed.shape[2], by_state.shape[1]
    m = nx + 2
    scores, squares = np.empty((size, n)), 0.0
    ahead, power = np.zeros((m, n)), np.zeros((m, m))
    a, b, of_u = np.zeros((m, m)), np.zeros(m), np.zeros(m)
    for k in range(size - 1, -1, -1):
        noise_u = _around_loop(gains, closed, free[k], seen[k], by_state[k], by_drive[k], a, b, of_u)
        out_y, out_u = weight_y, weight_u * noise_u
        if k == 0:
            # The twin starts at the first reading, so its noise shifts both, and only the plant's own
            # movement afterwards differs.
            out_y, out_u = 0.0, 0.0
            for i in range(m):
                b[i] = 0.0
                if i < nx:
                    for j in range(nx):
                        b[i] -= by_state[k, i, j] * started[j]
        for p in range(n):
            score = out_y * weighed[0, k, p] + out_u * weighed[1, k, p]
            for i in range(m):
                score += b[i] * ahead[i, p]
            scores[k, p] = score
        squares += out_y * out_y + out_u * out_u + _power_form(power, b)
        moved = np.zeros((m, n))
        for p in range(n):
            for j in range(m):
                total = weight_u * weighed[1, k, p] * of_u[j]
                if j < nx:
                    total += weight_y * weighed[0, k, p] * seen[k, j]
                for i in range(m):
                    total += a[i, j] * ahead[i, p]
                moved[j, p] = total
        ahead = moved
        power = _congruent(power, a)
        for i in range(m):
            for j in range(m):
                power[i, j] += weight_u * weight_u * of_u[i] * of_u[j]
                if i < nx and j < nx:
                    power[i, j] += weight_y * weight_y * seen[k, i] * seen[k, j]
    outputs = 2.0 if weight_u != 0.0 else 1.0
    return scores, squares / (outputs * size)


@compiled(innermost=True)
def _around_loop(
    gains: Gains, closed: bool, free: float, seen: FloatArray, by_state: FloatArray, by_drive: FloatArray,
    a: FloatArray, b: FloatArray, of_u: FloatArray,
) -> float:  # fmt: skip
    """One sample of the linear loop; its state z holds the plant's states, the integral and the error.

    With v, the noise of the reading: u = of_u·z + noise_u·v, next z = a·z + b·v; returns noise_u. `seen`
    holds the derivatives of the output by the plant's states.
    """
    nx = seen.size
    per_second = gains.derivative / gains.period
    by_reading = -gains.proportional - per_second if closed else 0.0
    limited = free if closed else 0.0
    wind = gains.period * gains.back_calculation * (limited - 1.0)
    for i in range(nx):
        of_u[i] = limited * by_reading * seen[i]
    of_u[nx], of_u[nx + 1] = limited, -limited * per_second
    noise_u = limited * by_reading
    for i in range(nx):
        for j in range(nx + 2):
            a[i, j] = by_drive[i] * of_u[j] + (by_state[i, j] if j < nx else 0.0)
        b[i] = by_drive[i] * noise_u
    leak = wind * by_reading - gains.period * gains.integral
    for i in range(nx):
        a[nx, i] = leak * seen[i]
        a[nx + 1, i] = -seen[i]
    a[nx, nx], a[nx, nx + 1] = 1.0 + wind, -wind * per_second
    b[nx], b[nx + 1] = leak, -1.0
    return noise_u


@compiled
def _power_form(power: FloatArray, b: FloatArray) -> float:
    """bᵀ·power·b."""
    total = 0.0
    for i in range(b.size):
        for j in range(b.size):
            total += power[i, j] * b[i] * b[j]
    return total


@compiled
def _congruent(power: FloatArray, a: FloatArray) -> FloatArray:
    """aᵀ·power·a."""
    m = power.shape[0]
    way, found = np.zeros((m, m)), np.zeros((m, m))
    for i in range(m):
        for j in range(m):
            for q in range(m):
                way[i, j] += power[i, q] * a[q, j]
    for i in range(m):
        for j in range(m):
            for q in range(m):
                found[i, j] += a[q, i] * way[q, j]
    return found
