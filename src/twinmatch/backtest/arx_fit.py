"""Least squares for the two equations of a sampled loop: plant and controller, each on its past.

    y[k] = a₀ + Σ (a y[k−i] + b u[k−i] + c r[k−i]) + e           i = 1 … p
    u[k] = d₀ + f r[k] + g y[k] + Σ (the same of the past) + v

A drive at its limit violates the controller's equation. Those samples are kept nevertheless: without them the
fit has the least data on steps, and forecasts these worse. All orders up to the highest are fitted at once:
the columns are ordered by lag, so that every lower order is a leading block of one triangular factor.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from twinmatch.signals import FloatArray

__all__ = ["Equation", "equations", "input_equations"]

_RIDGE = 1e-4
"""Ridge weight of a coefficient, for residuals in units of the noise: it affects only what the data leave
open, such as the coefficient of a set-point that never moved."""


class Equation(NamedTuple):
    """One of the two equations, at one order p."""

    constant: float
    direct: FloatArray
    """Coefficients of r[k] and y[k]; empty in the plant's equation."""
    past: FloatArray
    """Coefficients of past y, u and, in closed loop, r, one row per lag, shape (p, signals)."""
    variance: float
    """Variance of the residuals."""
    bic: float
    """Schwarz (1978), up to a constant: N ln V + m ln N with m coefficients."""


def equations(
    reference: FloatArray, output: FloatArray, entry: FloatArray, highest: int
) -> list[tuple[Equation, Equation]]:
    """The plant's and the controller's equation at every order from 1 to `highest`.

    Args:
        reference: set-points r, shape (N,), like y in units of the output's noise and relative to a level.
        output: outputs y, shape (N,).
        entry: inputs u, shape (N,), in units of the drive's noise.
        highest: highest order, at least 1 and less than N.
    """
    count = output.size - highest
    lags = [
        signal[highest - lag :][:count]
        for lag in range(1, highest + 1)
        for signal in (output, entry, reference)
    ]
    y, u, r = (signal[highest:] for signal in (output, entry, reference))
    plant = np.column_stack([np.ones(count), *lags])
    controller = np.column_stack([np.ones(count), r, y, *lags])
    found = _nested(plant, y, highest, direct=0), _nested(controller, u, highest, direct=2)
    return list(zip(*found, strict=True))


def input_equations(output: FloatArray, entry: FloatArray, highest: int) -> list[Equation]:
    """The equation of a plant whose loop is not known, y on the past of y and u alone; see `equations`."""
    count = output.size - highest
    lags = [signal[highest - lag :][:count] for lag in range(1, highest + 1) for signal in (output, entry)]
    columns = np.column_stack([np.ones(count), *lags])
    return _nested(columns, output[highest:], highest, direct=0, signals=2)


def _nested(
    columns: FloatArray, target: FloatArray, highest: int, direct: int, signals: int = 3
) -> list[Equation]:
    count = columns.shape[1]
    held = np.vstack([np.column_stack([columns, target]), _RIDGE * np.eye(count, count + 1)])
    factor = np.asarray(np.linalg.qr(held, mode="r"), dtype=np.float64)
    samples = max(target.size, 1)
    found = []
    for order in range(1, highest + 1):
        m = 1 + direct + signals * order
        solved = np.asarray(np.linalg.solve(factor[:m, :m], factor[:m, -1]), dtype=np.float64)
        left = float(np.sum(factor[m:, -1] ** 2))
        variance = max(left / samples, _RIDGE**2)
        bic = samples * math.log(variance) + m * math.log(samples)
        constant, now, past = np.split(solved, [1, 1 + direct])
        found.append(Equation(float(constant[0]), now, past.reshape(order, signals), variance, bic))
    return found
