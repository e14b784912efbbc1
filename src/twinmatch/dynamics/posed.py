"""A window as compiled code takes it, and one row of its least squares."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.dynamics.pid_step import Gains
from twinmatch.signals import FloatArray

__all__ = ["Posed", "add_row"]


class Posed(NamedTuple):
    """What a run and its normal equations need besides the values of the unknowns."""

    base: FloatArray
    """Values of all parameters, shape (n,); those of the unknown ones do not matter."""
    which: NDArray[np.int64]
    """Unknown parameters, counted among those with tangents, shape (m,)."""
    places: NDArray[np.int64]
    """The same counted among all parameters."""
    started: NDArray[np.int64]
    """States whose start is unknown."""
    first: float
    """Output measured at the start."""
    closed: bool
    gains: Gains
    reference: FloatArray
    measured: FloatArray
    """Output and input, shape (2, N)."""
    weights: FloatArray
    """Of their residuals, shape (2, N)."""
    robust: bool
    disturbances: FloatArray
    """Shape (N, number of disturbances)."""
    usual: FloatArray
    """Their defaults."""
    corners: FloatArray
    """Where the fastest rate is looked for: states, shape (k, number of states), and drives."""
    drives: FloatArray
    integral: float
    previous: float
    """The controller's memory."""
    period: float
    rate_limit: float
    """Longest Runge–Kutta step in units of the fastest time constant."""
    expected: FloatArray
    """What is known of the unknowns beforehand, shape (m + starts,)."""
    pull: FloatArray
    """How much of the cost their square distance from it makes; zero where nothing is known."""


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
