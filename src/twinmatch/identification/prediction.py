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

from dataclasses import dataclass

import numpy as np

from twinmatch.identification.kernels import LARGEST_ROOT, Polynomials, curvature, linearise, project
from twinmatch.identification.order import Order
from twinmatch.identification.polynomial import clamp
from twinmatch.signals import FloatArray

__all__ = ["Point", "Problem"]

MEMORY = 6.0
"""The predictor must forget its initial conditions to e^−MEMORY by the end of the window: roots of C stay
below 1 − MEMORY/N. Nearer the unit circle C and the free initial conditions conspire to cancel chance
sinusoids: measured on the rig, a few parts in a thousand off the loss and far worse predictions of the
next window."""


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """A model along the search: θ, the best x for it, and its errors."""

    theta: FloatArray
    """c, d, f."""
    model: Polynomials
    """θ and b as polynomials."""
    x: FloatArray
    """b, m."""
    errors: FloatArray
    """e, shape (N,)."""
    signals: FloatArray
    """Derivatives before their delays, rows 0 and 1 filled; shape (8, pad + N)."""
    cost: float
    """Σ e²."""
    prior: FloatArray
    """Standardised initial conditions of the noise filter, where they are penalised; else empty."""


class Problem:
    """The sum of squared prediction errors of one window as a function of θ = (c, d, f)."""

    exact_curvature = True
    """Whether `curvature` is to be had."""

    def __init__(self, u: FloatArray, y: FloatArray, order: Order, *, free_start: bool = True) -> None:
        self.u = u
        self.y = y
        self.order = order
        nb, nc, nd, nf, nk = order
        self.radii = (1.0 - MEMORY / u.size, LARGEST_ROOT, LARGEST_ROOT)
        self.states = order.predictor_state if free_start else 0
        self.linear_size = nb + self.states
        self.size = self.linear_size + nc + nd + nf
        # Second derivatives are delayed by the delays of both coefficients.
        self._pad = max(nb + nk, self.states, nc + 1, nd + 1, nf + 1) + max(nc, nd, nf)
        linear = [(0, nk, nb), (1, 0, self.states)]
        self._linear = np.array([*linear, (2, 0, 1)], dtype=np.int64)
        self._all = np.array([*linear, (2, 1, nc), (3, 1, nd), (4, 1, nf), (5, 0, 1)], dtype=np.int64)

    def polynomials(self, theta: FloatArray) -> Polynomials:
        """C, D and F at θ, stable; B is left at zero."""
        nb, nc, nd, nf, nk = self.order
        parts = []
        first = 0
        for degree, radius in zip((nc, nd, nf), self.radii, strict=True):
            part = np.empty(degree + 1)
            part[0] = 1.0
            part[1:] = theta[first : first + degree]
            parts.append(clamp(part, radius))
            first += degree
        return Polynomials(np.zeros(nk + nb), *parts)

    def initial_state(self, point: Point) -> FloatArray:
        """The initial conditions m of the predictor."""
        return point.x[self.order.nb :]

    def evaluate(self, theta: FloatArray, *, exact: bool = False) -> Point:
        """The best linear coefficients at θ and the errors they leave.

        Roots outside the stable region are pulled back to its boundary: the point's θ is what is left.
        """
        signals = np.zeros((8, self._pad + self.u.size))
        model = self.polynomials(theta)
        x, e = project(self.u, self.y, model, signals, self._pad, self._linear, exact)
        return self._point(model, x, e, signals, np.zeros(0))

    def _point(
        self, model: Polynomials, x: FloatArray, e: FloatArray, signals: FloatArray, prior: FloatArray
    ) -> Point:
        model.B[self.order.nk :] = x[: self.order.nb]
        theta = np.concatenate((model.C[1:], model.D[1:], model.F[1:]))
        cost = float(np.sum(e * e) + np.sum(prior * prior))
        return Point(theta, model, x, e, signals, cost if np.isfinite(cost) else np.inf, prior)

    def triangle(self, point: Point, *, exact: bool = False) -> FloatArray:
        """QR triangle of the derivatives of e by (x, θ), the rotated e as last column; (p+1, p+1)."""
        return linearise(
            self.u, self.y, point.model, point.errors, point.signals, self._pad, self._all, exact
        )

    def curvature(self, point: Point, triangle: FloatArray) -> FloatArray:
        """Half the Hessian of the cost by θ, x following; `triangle` is that of the same point."""
        return curvature(self.u, point.model, point.errors, point.signals, self._pad, self._all, triangle)
