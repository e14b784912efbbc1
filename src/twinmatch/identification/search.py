"""The search for θ = (c, d, f): damped Gauss–Newton first, Newton where that overshoots.

Gauss–Newton leaves out the second derivatives of e. Far from the minimum that makes it robust; in the flat
valleys of closed-loop data and of orders that are too high it makes it zigzag for hundreds of steps.
The second derivatives are exact and cheap here, so the search changes over as soon as the model of the
cost it used was a bad prophet of the gain.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from twinmatch.identification.polynomial import boundary_normals
from twinmatch.identification.prediction import Point, Problem
from twinmatch.signals import FloatArray

__all__ = ["Outcome", "search"]

SETTLED = 1e-9
"""Converged when an undamped step promises less than this part of the cost."""
FLAT = 1e-8
"""A step that gains less than this part of the cost is idle; after `PATIENCE` of them, stop."""
PATIENCE = 3
NOISE_FREE = 1e-26
"""Part of Σ y² below which errors are rounding only."""
EPSILON = 1e-14
"""Curvature of an axis, relative to the greatest, below which it is rounding."""
TRIAL = 10
HOPELESS = 1.1
"""A search that after `TRIAL` steps is this much above its rival is given up."""
STIFF = 1e8
"""Damping at which no step is left to take."""


class Outcome(NamedTuple):
    """Where a search ended."""

    point: Point
    converged: bool
    iterations: int


class Quadratic:
    """The cost around a point, cost + 2 gᵀδ + δᵀHδ, in the eigenvectors of the scaled Hessian."""

    def __init__(
        self, gradient: FloatArray, hessian: FloatArray, scale: FloatArray, normals: list[FloatArray]
    ) -> None:
        """`normals` point out of the stable region where a root touches its boundary."""
        self.basis = np.diag(1.0 / np.where(scale > 0.0, scale, 1.0))
        self._diagonalise(gradient, hessian)
        if normals:
            step, _ = self.step(0.0)
            leaving = np.array([normal for normal in normals if normal @ step > 0.0])
            if leaving.size:  # slide along the boundary: only steps that leave |z| as it is
                _, size, rows = np.linalg.svd(leaving @ self.basis)
                kept = rows[int(np.sum(size > 1e-10 * size[0])) :]
                self.basis = self.basis @ kept.T
                self._diagonalise(gradient, hessian)

    def _diagonalise(self, gradient: FloatArray, hessian: FloatArray) -> None:
        self.curvatures, axes = np.linalg.eigh(self.basis.T @ hessian @ self.basis)
        self.basis = self.basis @ axes
        self.gradient = self.basis.T @ gradient

    def step(self, damping: float) -> tuple[FloatArray, float]:
        """The damped step and the gain it promises; downhill along axes of negative curvature too."""
        size = np.abs(self.curvatures)
        floor = EPSILON * max(float(np.max(size, initial=0.0)), 1e-300)
        along = -self.gradient / (np.maximum(size, floor) + damping)
        gain = -float(np.sum(along * (2.0 * self.gradient + self.curvatures * along)))
        return self.basis @ along, gain


def search(
    problem: Problem,
    theta: FloatArray,
    *,
    exact: bool = False,
    iterations: int = 100,
    rival: float = math.inf,
) -> Outcome:
    """Descend from θ until nothing is left to gain; the cost never grows on the way.

    Steps that leave the stable region are pulled back to its boundary and taken only if they still gain.

    Args:
        problem: the data and the order.
        theta: start.
        exact: factorise by QR instead of by normal equations: for the last digits.
        iterations: most steps to take.
        rival: a cost reached elsewhere; given up when still far above it after `TRIAL` steps.
    """
    point = problem.evaluate(theta, exact=exact)
    floor = NOISE_FREE * float(np.sum(problem.y**2))
    damping, newton, idle = 1e-3, False, 0
    for iteration in range(iterations):
        if point.cost <= floor or theta.size == 0:
            return Outcome(point, True, iteration)
        if iteration >= TRIAL and point.cost > HOPELESS * rival:
            break
        model = _quadratic(problem, point, newton, exact)
        if model.step(0.0)[1] <= SETTLED * point.cost:
            return Outcome(point, True, iteration)
        while True:
            delta, promised = model.step(damping)
            trial = problem.evaluate(point.theta + delta, exact=exact)
            gained = point.cost - trial.cost
            if gained > 0.0:
                break
            damping *= 8.0
            newton = problem.exact_curvature
            if damping > STIFF:
                return Outcome(point, True, iteration)
        ratio = gained / promised if promised > 0.0 else 0.0
        damping = max(damping * (0.1 if ratio > 0.75 else 0.5 if ratio > 0.25 else 2.0), 1e-12)
        newton = newton or (problem.exact_curvature and not 0.5 < ratio < 2.0)
        idle = idle + 1 if gained < FLAT * point.cost else 0
        point = trial
        if idle == PATIENCE:
            return Outcome(point, True, iteration + 1)
    return Outcome(point, False, iterations)


def _quadratic(problem: Problem, point: Point, newton: bool, exact: bool) -> Quadratic:
    R = problem.triangle(point, exact=exact)
    inner = slice(problem.linear_size, problem.size)
    block, rotated = np.ascontiguousarray(R[inner, inner]), R[inner, problem.size].copy()
    hessian = problem.curvature(point, R) if newton else block.T @ block
    scale = np.sqrt(np.sum(block**2, axis=0)) + 1e-6 * np.sqrt(np.sum(R[:, inner] ** 2, axis=0))
    return Quadratic(block.T @ rotated, hessian, scale, _normals(problem, point))


def _normals(problem: Problem, point: Point) -> list[FloatArray]:
    normals = []
    first = 0
    for polynomial, radius in zip(point.model[1:], problem.radii, strict=True):
        last = first + polynomial.size - 1
        for part in boundary_normals(polynomial, radius):
            normal = np.zeros(point.theta.size)
            normal[first:last] = part
            normals.append(normal)
        first = last
    return normals
