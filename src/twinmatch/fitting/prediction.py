"""One-step prediction errors of a Box–Jenkins model and their exact derivatives.

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
from twinmatch.fitting.delayed import (
    COUNT,
    DELAY,
    SIGNAL,
    SLACK,
    Spans,
    cholesky,
    correlate,
    solve_triangle,
    substitute_back,
    triangularise,
)
from twinmatch.fitting.errors import IdentificationError
from twinmatch.fitting.filters import all_pole_into, copy_into, dot, fir_into
from twinmatch.fitting.order import Order
from twinmatch.fitting.predictor import Polynomials
from twinmatch.fitting.stability import LARGEST_ROOT, stabilise
from twinmatch.signals import FloatArray

__all__ = ["INITIALS", "MEMORY", "Place", "Task", "evaluate", "linear_size", "task_of", "unknowns"]

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


def task_of(u: FloatArray, y: FloatArray, order: Order, initial: str = "estimate") -> Task:
    """The sum of squared prediction errors of one window as a function of θ = (c, d, f).

    Raises:
        IdentificationError: an unknown `initial`.
    """
    if initial not in INITIALS:
        msg = f'initial: {initial!r} is unknown; use "estimate" or "zero"'
        raise IdentificationError(msg)
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
    C, D, F = np.ones(1 + nc), np.ones(1 + nd), np.ones(1 + nf)
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
    by_b, by_m, at_zero = signals[BY_B, pad:], signals[BY_M, pad:], signals[AT_ZERO, pad:]
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
    spans[BY_M + 1, SIGNAL], spans[BY_M + 1, DELAY], spans[BY_M + 1, COUNT] = AT_ZERO, 0, 1
    if exact:
        x = solve_triangle(triangularise(signals, pad, spans))
    else:
        x = substitute_back(cholesky(correlate(signals, pad, spans)))
    e = at_zero.copy()
    column = 0
    for group in (BY_B, BY_M):
        for i in range(spans[group, COUNT]):
            at = pad - spans[group, DELAY] - i
            factor, delayed = x[column], signals[group, at : at + e.size]
            for t in range(e.size):
                e[t] += factor * delayed[t]
            column += 1
    return x, e
