"""Weighted residuals of a run and their normal equations, as in the compiled runs."""

from __future__ import annotations

import numpy as np

from twinmatch.signals import FloatArray

__all__ = ["cost_of", "normal_of"]


def _weighted(
    simulated: FloatArray, measured: FloatArray, weights: FloatArray, robust: bool
) -> tuple[FloatArray, FloatArray, float]:
    """Residuals, squared weights, and total cost, as in `add_row`."""
    count = len(simulated)
    left = simulated - measured[:count]
    square = np.square(weights[:count])
    lost = square * left * left
    if robust:
        root = np.sqrt(1.0 + lost)
        return left, square / root, float(np.sum(2.0 * (root - 1.0)))
    return left, square, float(np.sum(lost))


def cost_of(simulated: FloatArray, measured: FloatArray, weights: FloatArray, robust: bool) -> float:
    """Sum of the squared weighted residuals, or of their robust cost if `robust`."""
    return _weighted(simulated, measured, weights, robust)[2]


def normal_of(
    simulated: FloatArray, by: FloatArray, measured: FloatArray, weights: FloatArray, robust: bool
) -> FloatArray:
    """[J r]ᵀ[J r] with the sum of the costs in its last entry, shape (n + 1, n + 1)."""
    left, square, cost = _weighted(simulated, measured, weights, robust)
    rows = np.concatenate([by, left[:, :, None]], axis=2).reshape(-1, by.shape[2] + 1)
    normal = np.asarray(np.einsum("ki,k,kj->ij", rows, square.ravel(), rows))
    normal[-1, -1] = cost
    return normal
