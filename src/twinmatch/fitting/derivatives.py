"""First and second derivatives of the prediction errors, exact."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twinmatch.compiled import compiled
from twinmatch.fitting.delayed import COUNT, DELAY, cholesky, corners_of, correlate, triangularise
from twinmatch.fitting.filters import all_pole_into, copy_into, dot, fir_into
from twinmatch.fitting.prediction import (
    AT_ZERO,
    BY_B,
    BY_C,
    BY_D,
    BY_F,
    BY_M,
    ERROR,
    OF_INPUT,
    OF_PROCESS,
    Place,
    Task,
)
from twinmatch.signals import FloatArray

__all__ = ["curvature", "linearise"]

UNFILTERED, THROUGH_C, THROUGH_F = range(3)
"""Filters applied to e, backwards in time."""


class SecondDerivative(NamedTuple):
    """∂²e by the coefficients of two groups: one signal of a place, delayed by both delays."""

    one: int
    other: int
    error: int
    """`UNFILTERED`, `THROUGH_C` or `THROUGH_F`: the filter that is moved from the signal onto e."""
    signal: int
    factor: int


SECOND_DERIVATIVES = (
    SecondDerivative(BY_B, BY_C, THROUGH_C, BY_B, -1),
    SecondDerivative(BY_B, BY_D, UNFILTERED, OF_INPUT, -1),
    SecondDerivative(BY_B, BY_F, THROUGH_F, BY_B, -1),
    SecondDerivative(BY_M, BY_C, THROUGH_C, BY_M, -1),
    SecondDerivative(BY_M, BY_F, THROUGH_F, BY_M, -1),
    SecondDerivative(BY_C, BY_C, THROUGH_C, BY_C, -2),
    SecondDerivative(BY_C, BY_D, THROUGH_C, BY_D, -1),
    SecondDerivative(BY_C, BY_F, THROUGH_C, BY_F, -1),
    SecondDerivative(BY_D, BY_F, THROUGH_F, OF_PROCESS, 1),
    SecondDerivative(BY_F, BY_F, THROUGH_F, BY_F, -2),
)
"""All second derivatives that are not zero."""


@compiled
def linearise(task: Task, place: Place, exact: bool) -> FloatArray:
    """QR triangle of the derivatives of e by (b, m, c, d, f), with the rotated e as last column.

    Fills the signals from `BY_C` to `ERROR`; the others are those set by `evaluate`.
    """
    model, e, signals, pad = place.model, place.errors, place.signals, task.pad
    by_c, by_d, by_f = signals[BY_C, pad:], signals[BY_D, pad:], signals[BY_F, pad:]
    at_zero = signals[AT_ZERO, pad:]
    driven = np.empty(e.size)
    fir_into(model.B, task.u, driven)
    fir_into(model.F, task.y, by_d)
    for t in range(e.size):
        by_f[t] = at_zero[t] - e[t]  # (D y − C e)/C
        by_c[t] = -e[t]
        by_d[t] -= driven[t]
    all_pole_into(model.F, by_f, by_f)
    all_pole_into(model.C, by_c, by_c)
    all_pole_into(model.C, by_d, by_d)
    all_pole_into(model.F, by_d, by_d)
    copy_into(e, signals[ERROR, pad:])
    if exact:
        return triangularise(signals, pad, task.spans)
    return cholesky(correlate(signals, pad, task.spans))


@compiled
def curvature(task: Task, place: Place, R: FloatArray) -> FloatArray:
    """Half the second derivative of Σ e² by θ = (c, d, f), with x = (b, m) following as its minimiser.

    Signals are those set by `linearise`, R is the triangle. Every ∂²e is one signal filtered once more by 1/C
    or 1/F and delayed by both delays; in the sum over e that filter is moved onto e, backwards in time.
    """
    model, signals, pad, spans = place.model, place.signals, task.pad, task.spans
    driven = signals[OF_INPUT, pad:]
    all_pole_into(model.C, task.u, driven)
    all_pole_into(model.F, driven, driven)
    fir_into(model.B, driven, signals[OF_PROCESS, pad:])
    errors = np.empty((3, place.errors.size))
    copy_into(place.errors, errors[UNFILTERED])
    backwards_into(model.C, place.errors, errors[THROUGH_C])
    backwards_into(model.F, place.errors, errors[THROUGH_F])
    corners = corners_of(spans)
    S = np.zeros((corners[ERROR], corners[ERROR]))
    for second in SECOND_DERIVATIVES:
        one, other, filtered = second.one, second.other, errors[second.error]
        for i in range(spans[one, COUNT]):
            for j in range(spans[other, COUNT]):
                row, column = corners[one] + i, corners[other] + j
                if i == 0 or j == spans[other, COUNT] - 1:
                    delayed = pad - spans[one, DELAY] - spans[other, DELAY] - i - j
                    S[row, column] = second.factor * dot(filtered, signals[second.signal, delayed:])
                else:
                    S[row, column] = S[row - 1, column + 1]
    return eliminate_linear(S, R, corners[BY_C])


@compiled(inside=True)
def backwards_into(denominator: FloatArray, e: FloatArray, out: FloatArray) -> None:
    """Filter e by 1/denominator from its end to its beginning."""
    for t in range(e.size):
        out[t] = e[e.size - 1 - t]
    all_pole_into(denominator, out, out)
    for t in range(e.size // 2):
        out[t], out[e.size - 1 - t] = out[e.size - 1 - t], out[t]


@compiled(inlined=True)
def eliminate_linear(S: FloatArray, R: FloatArray, linear: int) -> FloatArray:
    """Schur complement over the first `linear` unknowns of RᵀR + S, S upper and zero among those."""
    size = S.shape[0] - linear
    K = np.zeros((linear, size))  # R_xx⁻ᵀ S_xθ
    for i in range(linear):
        if R[i, i] == 0.0:
            continue
        for j in range(size):
            total = S[i, linear + j]
            for k in range(i):
                total -= R[k, i] * K[k, j]
            K[i, j] = total / R[i, i]
    H = np.zeros((size, size))
    for a in range(size):
        for b in range(a, size):
            total = S[linear + a, linear + b]
            for k in range(linear):
                total -= K[k, a] * K[k, b] + R[k, linear + a] * K[k, b] + K[k, a] * R[k, linear + b]
            for k in range(a + 1):
                total += R[linear + k, linear + a] * R[linear + k, linear + b]
            H[a, b] = total
            H[b, a] = total
    return H
