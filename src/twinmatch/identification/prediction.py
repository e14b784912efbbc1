"""One-step prediction errors of a Box–Jenkins model and their exact derivatives.

Multiplied out, the predictor of y = B/F u + C/D e is one difference equation,

    C F e = D F y − D B u + Σ mⱼ δ(t−j),    j < max(deg DF, deg CF, deg DB),

in which m holds everything the time before the window leaves behind: the initial conditions of B/F and
of the noise filter together. For given θ = (c, d, f) the error e is linear in x = (b, m), so the sum of
squares is minimised over x by least squares at every θ (variable projection) and only θ is searched.
All derivatives are delayed copies of a few filtered signals:

    ∂e/∂b = −D/(CF) u                ∂e/∂m = δ/(CF)
    ∂e/∂c = −e/C    ∂e/∂d = (F y − B u)/(CF)    ∂e/∂f = (D y − C e)/(CF)
"""

from __future__ import annotations

import numpy as np

from twinmatch.identification.errors import IdentificationError
from twinmatch.identification.kernels import LARGEST_ROOT, Task, Weighed
from twinmatch.identification.order import Order
from twinmatch.signals import FloatArray

__all__ = ["INITIALS", "MEMORY", "linear_size", "task_of", "unknowns"]

INITIALS = ("estimate", "zero", "backcast")
MEMORY = 6.0
"""Predictor and noise must forget their initial conditions to e^−MEMORY by the end of the window: roots of
C and D stay below 1 − MEMORY/N. Nearer the unit circle C and the free initial conditions conspire to cancel
chance sinusoids: measured on the rig, a few parts in a thousand off the loss and far worse predictions of
the next window. And noise that never returns to its mean is free to carry the levels which the set-point
commands; B/F then have a static gain of any size and sign, and the ν-gap sees two different plants."""


def task_of(u: FloatArray, y: FloatArray, order: Order, initial: str = "estimate") -> Task:
    """The sum of squared prediction errors of one window as a function of θ = (c, d, f).

    Raises:
        IdentificationError: an unknown `initial`.
    """
    if initial not in INITIALS:
        msg = f'initial: {initial!r} is unknown; use "estimate", "zero" or "backcast"'
        raise IdentificationError(msg)
    nb, nc, nd, nf, nk = order
    states = 0 if initial == "zero" else order.predictor_state
    spans = [(0, nk, nb), (1, 0, states), (2, 1, nc), (3, 1, nd), (4, 1, nf), (5, 0, 1)]
    return Task(
        u=u,
        y=y,
        counts=np.array(order, dtype=np.int64),
        radii=np.array([1.0 - MEMORY / u.size, 1.0 - MEMORY / u.size, LARGEST_ROOT]),
        spans=np.array(spans, dtype=np.int64),
        # Second derivatives are delayed by the delays of both coefficients.
        pad=max(nb + nk, states, nc + 1, nd + 1, nf + 1) + max(nc, nd, nf),
    )


def linear_size(task: Task, weighed: Weighed = None) -> int:
    """Coefficients of B and initial conditions."""
    order = Order(*(int(n) for n in task.counts))
    if weighed:
        return order.nb + order.process_state + max(order.nc, order.nd)
    return order.nb + int(task.spans[1, 2])


def unknowns(task: Task, weighed: Weighed = None) -> int:
    """Everything that is free: coefficients and initial conditions."""
    return linear_size(task, weighed) + int(task.counts[1:4].sum())
