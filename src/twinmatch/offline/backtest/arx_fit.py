"""Least squares for the two equations of a sampled loop: plant and controller, each on its past.

    y[k] = a₀ + Σ (a y[k−i] + b u[k−i] + c r[k−i] + h d[k−i]) + e           i = 1 … p
    u[k] = d₀ + f r[k] + g y[k] + Σ (the same of the past) + v

with the measured disturbances d, if there are any.

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
    """Coefficients of past y, u, in closed loop r, and the disturbances, one row per lag, shape
    (p, signals)."""
    variance: float
    """Variance of the residuals."""
    bic: float
    """Schwarz (1978), up to a constant: N ln V + m ln N with m coefficients."""


def equations(
    reference: FloatArray, output: FloatArray, entry: FloatArray, highest: int, *others: FloatArray
) -> list[tuple[Equation, Equation]]:
    """The plant's and the controller's equation at every order from 1 to `highest`.

    Args:
        reference: set-points r, shape (N,), like y in units of the output's noise and relative to a level.
        output: outputs y, shape (N,).
        entry: inputs u, shape (N,), in units of the drive's noise.
        highest: highest order, at least 1 and less than N.
        others: measured disturbances, shape (N,) each, in any unit and relative to a level.
    """
    past = (output, entry, reference, *others)
    y, u, r = (signal[highest:] for signal in (output, entry, reference))
    lags, one = _lags(past, highest), np.ones(y.size)
    plant, controller = np.column_stack([one, lags]), np.column_stack([one, r, y, lags])
    found = (
        _nested(plant, y, highest, direct=0, signals=len(past)),
        _nested(controller, u, highest, direct=2, signals=len(past)),
    )
    return list(zip(*found, strict=True))


def input_equations(
    output: FloatArray, entry: FloatArray, highest: int, *others: FloatArray
) -> list[Equation]:
    """The equation of a plant whose loop is not known: y on the past of y, u and the disturbances; see
    `equations`."""
    past = (output, entry, *others)
    columns = np.column_stack([np.ones(output.size - highest), _lags(past, highest)])
    return _nested(columns, output[highest:], highest, direct=0, signals=len(past))


def _lags(signals: tuple[FloatArray, ...], highest: int) -> FloatArray:
    """The signals' past, lag by lag, shape (N − highest, highest · signals)."""
    count = signals[0].size - highest
    return np.column_stack([s[highest - lag :][:count] for lag in range(1, highest + 1) for s in signals])


def _nested(
    columns: FloatArray, target: FloatArray, highest: int, direct: int, signals: int
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
