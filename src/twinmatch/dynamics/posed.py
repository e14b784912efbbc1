"""A window in the form that compiled code takes, and one row of its least squares."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.dynamics.pid_step import Gains
from twinmatch.signals import FloatArray

__all__ = ["Posed", "add_row"]


class Posed(NamedTuple):
    """Input of a run and its normal equations, except the values of the unknowns."""

    base: FloatArray
    """Values of all parameters, shape (n,); those of the unknown ones are ignored."""
    which: NDArray[np.int64]
    """Indices of the unknown parameters among those with tangents, shape (m,)."""
    places: NDArray[np.int64]
    """Their indices among all parameters."""
    started: NDArray[np.int64]
    """Indices of the states with unknown initial value."""
    first: float
    """Output measured at the start."""
    driven: float
    """Input until the start."""
    closed: bool
    gains: Gains
    reference: FloatArray
    measured: FloatArray
    """Output and input, shape (2, N)."""
    weights: FloatArray
    """Weights of their residuals, shape (2, N)."""
    robust: bool
    disturbances: FloatArray
    """Shape (N, number of disturbances)."""
    usual: FloatArray
    """Defaults of the disturbances."""
    corners: FloatArray
    """States at which the fastest rate is searched, shape (k, number of states); `drives` likewise."""
    drives: FloatArray
    integral: float
    previous: float
    """The controller's state, with `integral`."""
    period: float
    rate_limit: float
    """Longest Runge–Kutta step in units of the fastest time constant."""
    expected: FloatArray
    """Prior values of the unknowns, shape (m + starts,)."""
    pull: FloatArray
    """Weight of their squared distance from it in the cost; zero without prior."""


@compiled(innermost=True)
def add_row(normal: FloatArray, of: FloatArray, weight: float, robust: bool) -> None:
    """Add one residual, the last entry of `of`, and its derivatives to the lower half of the equations."""
    if weight == 0.0:
        return
    n = of.size - 1
    square = weight * weight
    left = square * of[n] * of[n]
    lost = left
    if robust:
        root = np.sqrt(1.0 + left)
        square, lost = square / root, 2.0 * (root - 1.0)
    for i in range(n):
        scaled = square * of[i]
        for j in range(i + 1):
            normal[i, j] += scaled * of[j]
    scaled = square * of[n]
    for j in range(n):
        normal[n, j] += scaled * of[j]
    normal[n, n] += lost
