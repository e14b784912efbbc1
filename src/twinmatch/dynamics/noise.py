"""Effect of the sensor's noise on a loop, through controller and plant."""

# ruff: noqa: PLR0912, PLR0917 (a kernel is long and takes arrays in a row)

from __future__ import annotations

import numpy as np

from twinmatch.compiled import compiled
from twinmatch.dynamics.experiment import Experiment, Tangents
from twinmatch.dynamics.pid_step import Gains
from twinmatch.signals import FloatArray

__all__ = ["around_loop", "noise_scores"]


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
        noise_u = around_loop(gains, closed, free[k], seen[k], by_state[k], by_drive[k], a, b, of_u)
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
        squares += out_y * out_y + out_u * out_u + _form(power, b)
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
def around_loop(
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
def _form(power: FloatArray, b: FloatArray) -> float:
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
