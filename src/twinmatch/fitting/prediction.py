"""One-step prediction errors of a Box–Jenkins model and their exact first and second derivatives.

Multiplied out, the predictor of y = B/F u + C/D e is one difference equation,

    C F e = D F y − D B u + Σ mⱼ δ(t−j),    j < max(deg DF, deg CF, deg DB),

in which m holds the effect of everything before the window: the initial conditions of B/F and of the noise
filter together. For given θ = (c, d, f) the error e is linear in x = (b, m), so the sum of
squares is minimised over x by least squares at every θ (variable projection) and only θ is searched.
All derivatives are delayed copies of a few filtered signals:

    ∂e/∂b = −D/(CF) u                ∂e/∂m = δ/(CF)
    ∂e/∂c = −e/C    ∂e/∂d = (F y − B u)/(CF)    ∂e/∂f = (D y − C e)/(CF)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.dynamics.kernels import copy_into
from twinmatch.fitting.data import FittingError, Order
from twinmatch.fitting.delayed import (
    COUNT,
    DELAY,
    SIGNAL,
    SLACK,
    Spans,
    cholesky,
    corners_of,
    correlate,
    solve_triangle,
    substitute_back,
    triangularise,
)
from twinmatch.fitting.polynomials import (
    LARGEST_ROOT,
    all_pole_into,
    dot,
    fir_into,
    stabilise,
)
from twinmatch.signals import FloatArray

INITIALS = ("estimate", "zero")
MEMORY = 6.0
"""Predictor and noise must forget their initial conditions to e^−MEMORY by the end of the window: roots of
C and D stay below 1 − MEMORY/N. Nearer the unit circle, C and the free initial conditions fit chance
sinusoids: on the rig this lowers the loss by a few parts in a thousand and predicts the next window far
worse. And noise that never returns to its mean can describe the levels commanded by the set-point; B/F then
have a static gain of any size and sign, and the ν-gap compares two different plants."""

BY_B, BY_M, BY_C, BY_D, BY_F, ERROR, OF_INPUT, OF_PROCESS, AT_ZERO = range(9)
"""The signals of a place: derivatives by the first coefficient of each group, e, u/(CF), B u/(CF), and the
error for x = 0. The first six are also the groups of columns of the derivatives, in order."""
ROWS = 9
UNFILTERED, THROUGH_C, THROUGH_F = range(3)
"""Filters applied to e, backwards in time."""


class Polynomials(NamedTuple):
    """A model as coefficients of q⁻¹; C, D and F monic, B with its leading zeros."""

    B: FloatArray
    C: FloatArray
    D: FloatArray
    F: FloatArray


@compiled
def errors_of(
    u: FloatArray, y: FloatArray, model: Polynomials, m: FloatArray
) -> FloatArray:
    """Prediction errors for the given initial conditions m of the predictor; shape (N,)."""
    filtered = np.empty(y.size)
    driven = np.empty(y.size)
    e = np.empty(y.size)
    fir_into(model.F, y, filtered)
    fir_into(model.B, u, driven)
    for t in range(y.size):
        filtered[t] -= driven[t]
    fir_into(model.D, filtered, e)
    for t in range(min(m.size, e.size)):
        e[t] += m[t]
    all_pole_into(model.C, e, e)
    all_pole_into(model.F, e, e)
    return e


@compiled
def smallest_errors(
    u: FloatArray, y: FloatArray, model: Polynomials, count: int
) -> FloatArray:
    """Prediction errors for the best `count` initial conditions of the predictor; shape (N,)."""
    signals = np.zeros((2, count + u.size))
    impulse = signals[0, count:]
    impulse[0] = 1.0
    all_pole_into(model.C, impulse, impulse)
    all_pole_into(model.F, impulse, impulse)
    copy_into(errors_of(u, y, model, np.zeros(0)), signals[1, count:])
    spans = np.array(((0, 0, count), (1, 0, 1)))
    return errors_of(u, y, model, solve_triangle(triangularise(signals, count, spans)))


class Task(NamedTuple):
    """The data and the order of one estimate."""

    u: FloatArray
    y: FloatArray
    counts: NDArray[np.int64]
    """nb, nc, nd, nf, nk."""
    radii: FloatArray
    """Largest root magnitudes of C, D and F."""
    spans: Spans
    """Columns b, m, c, d, f and e of the derivatives."""
    pad: int
    """At least the largest delay of a second derivative, and `SLACK` more than that of a first."""


class Place(NamedTuple):
    """A point of the search: θ, the best x for it, and its errors."""

    theta: FloatArray
    """c, d, f."""
    model: Polynomials
    """θ and b as polynomials."""
    x: FloatArray
    """b, m."""
    errors: FloatArray
    """e, shape (N,)."""
    signals: FloatArray
    """Signals indexed by `BY_B` … `AT_ZERO`, each with leading zeros, shape (ROWS, pad + N)."""
    cost: float
    """Σ e²"""


def task_of(
    u: FloatArray, y: FloatArray, order: Order, initial: str = "estimate"
) -> Task:
    """The sum of squared prediction errors of one window as a function of θ = (c, d, f).

    Raises:
        FittingError: an unknown `initial`.
    """
    if initial not in INITIALS:
        raise FittingError(f'initial: {initial!r} is unknown; use "estimate" or "zero"')
    nb, nc, nd, nf, nk = order
    states = 0 if initial == "zero" else order.predictor_state
    spans = np.zeros((BY_F + 2, 3), dtype=np.int64)
    spans[BY_B] = BY_B, nk, nb
    spans[BY_M] = BY_M, 0, states
    spans[BY_C] = BY_C, 1, nc
    spans[BY_D] = BY_D, 1, nd
    spans[BY_F] = BY_F, 1, nf
    spans[ERROR] = ERROR, 0, 1
    return Task(
        u=u,
        y=y,
        counts=np.array(order, dtype=np.int64),
        radii=np.array([1.0 - MEMORY / u.size, 1.0 - MEMORY / u.size, LARGEST_ROOT]),
        spans=spans,
        # Second derivatives are delayed by the delays of both coefficients.
        pad=max(nb + nk, states, nc + 1, nd + 1, nf + 1) + max(nc, nd, nf, SLACK),
    )


def linear_size(task: Task) -> int:
    """Number of coefficients of B and initial conditions."""
    return int(task.spans[BY_B, COUNT] + task.spans[BY_M, COUNT])


def unknowns(task: Task) -> int:
    """Number of all unknowns: coefficients and initial conditions."""
    return linear_size(task) + int(task.counts[1:4].sum())


@compiled
def evaluate(task: Task, theta: FloatArray, signals: FloatArray, exact: bool) -> Place:
    """The best linear coefficients at θ, and their errors.

    Roots outside the stable region are pulled back to its boundary, and the place has the changed θ. With
    `exact` the coefficients are computed by QR instead of normal equations.
    """
    nb, nc, nd, nf, nk = task.counts
    C = np.ones(1 + nc)
    D = np.ones(1 + nd)
    F = np.ones(1 + nf)
    copy_into(theta[:nc], C[1:])
    copy_into(theta[nc : nc + nd], D[1:])
    copy_into(theta[nc + nd :], F[1:])
    C = stabilise(C, task.radii[0], np.inf)
    D = stabilise(D, task.radii[1], np.inf)
    F = stabilise(F, task.radii[2], np.inf)
    stable = np.empty(theta.size)
    copy_into(C[1:], stable)
    copy_into(D[1:], stable[nc:])
    copy_into(F[1:], stable[nc + nd :])
    model = Polynomials(np.zeros(nk + nb), C, D, F)
    x, e = project(task, model, signals, exact)
    copy_into(x[:nb], model.B[nk:])
    cost = dot(e, e)
    return Place(stable, model, x, e, signals, cost if np.isfinite(cost) else np.inf)


@compiled(inlined=True)
def project(
    task: Task, model: Polynomials, signals: FloatArray, exact: bool
) -> tuple[FloatArray, FloatArray]:
    """The best x = (b, m) for given C, D, F, and its errors e; B of the model is not used."""
    pad = task.pad
    by_b = signals[BY_B, pad:]
    by_m = signals[BY_M, pad:]
    at_zero = signals[AT_ZERO, pad:]
    fir_into(model.D, task.u, by_b)
    all_pole_into(model.C, by_b, by_b)
    all_pole_into(model.F, by_b, by_b)
    for t in range(by_b.size):
        by_b[t] = -by_b[t]
        by_m[t] = 0.0
    by_m[0] = 1.0
    all_pole_into(model.C, by_m, by_m)
    all_pole_into(model.F, by_m, by_m)
    fir_into(model.D, task.y, at_zero)
    all_pole_into(model.C, at_zero, at_zero)
    spans = task.spans[: BY_M + 2].copy()
    spans[BY_M + 1, SIGNAL] = AT_ZERO
    spans[BY_M + 1, DELAY] = 0
    spans[BY_M + 1, COUNT] = 1
    if exact:
        x = solve_triangle(triangularise(signals, pad, spans))
    else:
        x = substitute_back(cholesky(correlate(signals, pad, spans)))
    e = at_zero.copy()
    column = 0
    for group in (BY_B, BY_M):
        for i in range(spans[group, COUNT]):
            first = pad - spans[group, DELAY] - i
            factor = x[column]
            delayed = signals[group, first : first + e.size]
            for t in range(e.size):
                e[t] += factor * delayed[t]
            column += 1
    return x, e


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
    model = place.model
    e = place.errors
    signals = place.signals
    pad = task.pad
    by_c = signals[BY_C, pad:]
    by_d = signals[BY_D, pad:]
    by_f = signals[BY_F, pad:]
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
    model = place.model
    signals = place.signals
    pad = task.pad
    spans = task.spans
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
        first_group = second.one
        second_group = second.other
        filtered = errors[second.error]
        for i in range(spans[first_group, COUNT]):
            for j in range(spans[second_group, COUNT]):
                row = corners[first_group] + i
                column = corners[second_group] + j
                if i == 0 or j == spans[second_group, COUNT] - 1:
                    delayed = (
                        pad
                        - spans[first_group, DELAY]
                        - spans[second_group, DELAY]
                        - i
                        - j
                    )
                    S[row, column] = second.factor * dot(
                        filtered, signals[second.signal, delayed:]
                    )
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
                total -= (
                    K[k, a] * K[k, b]
                    + R[k, linear + a] * K[k, b]
                    + K[k, a] * R[k, linear + b]
                )
            for k in range(a + 1):
                total += R[linear + k, linear + a] * R[linear + k, linear + b]
            H[a, b] = total
            H[b, a] = total
    return H
