"""The compiled halves of an observer's sample: an extended Kalman filter over states and some parameters.

The store puts this file beside `kernels`, so that it is written against one plant's functions. The joint
covariance is that of all states and, after them, of the parameters that wander.
"""

# ruff: noqa: PLR0912, PLR0917 (kernels are long and take arrays in a row)

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.dynamics.derived import (
    N_STATES,
    N_UNKNOWN,
    held,
    output,
    output_slopes,
    packed,
    prepare,
    row,
    unpack,
)
from twinmatch.dynamics.kernels import tick_with_tangents
from twinmatch.signals import FloatArray

__all__ = ["correct", "predict"]


@compiled
def correct(
    vector: FloatArray, x: FloatArray, covariance: FloatArray, y: float, d: FloatArray, noise: float,
    limit: float, which: NDArray[np.int64], bounds: FloatArray,
) -> tuple[float, float]:  # fmt: skip
    """Correct by a reading, in place; return the innovation and its expected variance.

    `which`, shape (2, m), holds the indices of the wandering parameters among those with tangents and among
    all; `bounds`, shape (2, m), limits them. Innovations are clipped at `limit` standard deviations.
    """
    size = covariance.shape[0]
    hx, hp = np.zeros(N_STATES), np.zeros(N_UNKNOWN)
    slope, reach, gain = np.zeros(size), np.zeros(size), np.zeros(size)
    kept, way = np.zeros((size, size)), np.zeros((size, size))
    p = held(vector)
    c = prepare(p)
    at, given = packed(x), row(d.reshape((1, d.size)), 0)
    innovation = y - output(at, given, p, c)
    output_slopes(at, given, p, c, hx, hp)
    for i in range(size):
        slope[i] = hx[i] if i < N_STATES else hp[which[0, i - N_STATES]]
    variance = noise * noise
    for i in range(size):
        for j in range(size):
            reach[i] += covariance[i, j] * slope[j]
        variance += slope[i] * reach[i]
    most = limit * np.sqrt(variance)
    # With a reduced gain the reading is less informative; Joseph's form is correct for any gain.
    weight = most / abs(innovation) if abs(innovation) > most else 1.0
    for i in range(size):
        gain[i] = weight * reach[i] / variance
        if i < N_STATES:
            x[i] += gain[i] * innovation
        else:
            j = i - N_STATES
            moved = vector[which[1, j]] + gain[i] * innovation
            vector[which[1, j]] = min(max(moved, bounds[0, j]), bounds[1, j])
    for i in range(size):
        for j in range(size):
            kept[i, j] = (1.0 if i == j else 0.0) - gain[i] * slope[j]
    for i in range(size):
        for j in range(size):
            for q in range(size):
                way[i, j] += kept[i, q] * covariance[q, j]
    for i in range(size):
        for j in range(i + 1):
            total = noise * noise * gain[i] * gain[j]
            for q in range(size):
                total += way[i, q] * kept[j, q]
            covariance[i, j] = total
            covariance[j, i] = total
    return innovation, variance


@compiled
def predict(
    vector: FloatArray, x: FloatArray, covariance: FloatArray, strayed: FloatArray, u: float, d: FloatArray,
    period: float, steps: int, which: NDArray[np.int64], columns: FloatArray,
) -> None:  # fmt: skip
    """Predict states and joint covariance one period ahead; `strayed`, shape (n + m,), adds to its diagonal.

    `columns`, shape (n, m + n + 1), is filled with the derivatives of the states by the m parameters
    which[0], by the states and by the drive.
    """
    m = which.shape[1]
    size = N_STATES + m
    du, way = np.zeros(size + 1), np.zeros((size, size))
    p = held(vector)
    c = prepare(p)
    columns[:] = 0.0
    for i in range(N_STATES):
        columns[i, m + i] = 1.0
    du[size] = 1.0
    there = tick_with_tangents(
        packed(x), u, row(d.reshape((1, d.size)), 0), p, c, period, steps, which[0], columns, du,
        np.zeros((4, N_STATES, N_UNKNOWN)),
    )  # fmt: skip
    unpack(there, x)
    for j in range(size):
        for i in range(N_STATES):
            for q in range(size):
                way[i, j] += columns[i, m + q if q < N_STATES else q - N_STATES] * covariance[q, j]
        for i in range(N_STATES, size):
            way[i, j] = covariance[i, j]
    for i in range(size):
        for j in range(i + 1):
            total = strayed[i] if i == j else 0.0
            if j < N_STATES:
                for q in range(size):
                    total += way[i, q] * columns[j, m + q if q < N_STATES else q - N_STATES]
            else:
                total += way[i, j]
            covariance[i, j] = total
            covariance[j, i] = total
