"""The one-step predictor of a given model on given data."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twinmatch.compiled import compiled
from twinmatch.fitting.delayed import solve_triangle, triangularise
from twinmatch.fitting.filters import all_pole_into, copy_into, fir_into
from twinmatch.signals import FloatArray

__all__ = ["Polynomials", "errors_of", "smallest_errors"]


class Polynomials(NamedTuple):
    """A model as coefficients of q⁻¹; C, D and F monic, B with its leading zeros."""

    B: FloatArray
    C: FloatArray
    D: FloatArray
    F: FloatArray


@compiled
def errors_of(u: FloatArray, y: FloatArray, model: Polynomials, m: FloatArray) -> FloatArray:
    """Prediction errors for the given initial conditions m of the predictor; shape (N,)."""
    rest, driven, e = np.empty(y.size), np.empty(y.size), np.empty(y.size)
    fir_into(model.F, y, rest)
    fir_into(model.B, u, driven)
    for t in range(y.size):
        rest[t] -= driven[t]
    fir_into(model.D, rest, e)
    for t in range(min(m.size, e.size)):
        e[t] += m[t]
    all_pole_into(model.C, e, e)
    all_pole_into(model.F, e, e)
    return e


@compiled
def smallest_errors(u: FloatArray, y: FloatArray, model: Polynomials, count: int) -> FloatArray:
    """Prediction errors for the best `count` initial conditions of the predictor; shape (N,)."""
    signals = np.zeros((2, count + u.size))
    impulse = signals[0, count:]
    impulse[0] = 1.0
    all_pole_into(model.C, impulse, impulse)
    all_pole_into(model.F, impulse, impulse)
    copy_into(errors_of(u, y, model, np.zeros(0)), signals[1, count:])
    spans = np.array(((0, 0, count), (1, 0, 1)))
    return errors_of(u, y, model, solve_triangle(triangularise(signals, count, spans)))
