"""Descent from one start to the minimum next to it.

Gauss–Newton omits the second derivatives of e. Far from the minimum this makes it robust; in the flat
valleys of closed-loop data and of too high orders it zigzags for hundreds of steps. The second derivatives
are exact and cheap here, so the search switches to Newton as soon as its model of the cost predicts the
decrease badly. Steps that leave the stable region are pulled back to its boundary and taken only if they
still reduce the cost.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from twinmatch.compiled import compiled
from twinmatch.dynamics.kernels import copy_into
from twinmatch.fitting.delayed import column_norms
from twinmatch.fitting.polynomials import boundary_normals, dot
from twinmatch.fitting.prediction import (
    ROWS,
    Place,
    Task,
    curvature,
    evaluate,
    linearise,
)
from twinmatch.signals import FloatArray

FLAT = 10.0
"""A step that gains less than this factor times `Rules.settled` is idle; after `PATIENCE` of these, stop."""
PATIENCE = 3
NOISE_FREE = 1e-26
"""Share of Σ y² below which the errors are rounding."""
EPSILON = 1e-14
"""Curvature of an axis, relative to the largest, below which it is rounding."""
TRIAL = 4
STIFF = 1e8
"""Damping at which the search stops."""


class Rules(NamedTuple):
    """Stopping rules of a descent."""

    steps: int
    """Largest number of steps."""
    settled: float
    """Converged when the predicted gain of an undamped step is below this share of the cost."""
    rival: float = math.inf
    """Cost of another search; this one is abandoned if it seems out of reach after `TRIAL` steps."""
    exact: bool = False
    """Factorise by QR instead of normal equations, for the last digits."""
    faith: float = 5.0
    """A search is abandoned after `TRIAL` steps if this many times the predicted gain of its undamped step would
    not reach the rival."""


class Quadratic(NamedTuple):
    """A quadratic model of the cost in the eigenvectors of its Hessian."""

    gradient: FloatArray
    curvatures: FloatArray
    basis: FloatArray
    """The eigenvectors as columns."""


@compiled(inside=True)
def product(a: FloatArray, b: FloatArray) -> FloatArray:
    """The matrix a b, summed in a fixed order."""
    out = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            for j in range(b.shape[1]):
                out[i, j] += a[i, k] * b[k, j]
    return out


@compiled(inlined=True)
def diagonalise(
    gradient: FloatArray, hessian: FloatArray, basis: FloatArray
) -> Quadratic:
    """The cost around a point, cost + 2 gᵀδ + δᵀHδ, in the eigenvectors of the Hessian in `basis`."""
    across = np.ascontiguousarray(basis.T)
    curvatures, axes = np.linalg.eigh(product(across, product(hessian, basis)))
    turned = product(basis, np.ascontiguousarray(axes))
    along = np.zeros(gradient.size)
    for i in range(gradient.size):
        for j in range(gradient.size):
            along[j] += turned[i, j] * gradient[i]
    return Quadratic(along, curvatures, turned)


@compiled(inside=True)
def damped_step(quadratic: Quadratic, damping: float) -> tuple[FloatArray, float]:
    """The damped step and its predicted gain; also downhill along axes of negative curvature."""
    gradient, curvatures, basis = quadratic
    greatest = 0.0
    gain = 0.0
    for j in range(gradient.size):
        greatest = max(greatest, abs(curvatures[j]))
    floor = max(EPSILON * greatest, 1e-300)
    step = np.zeros(gradient.size)
    for j in range(gradient.size):
        along = -gradient[j] / (max(abs(curvatures[j]), floor) + damping)
        gain -= along * (2.0 * gradient[j] + curvatures[j] * along)
        for i in range(gradient.size):
            step[i] += basis[i, j] * along
    return step, gain


@compiled(inlined=True)
def quadratic_at(task: Task, place: Place, newton: bool, exact: bool) -> Quadratic:
    """The quadratic model of the cost at a place; at the stability boundary, in directions along it."""
    R = linearise(task, place, exact)
    count = place.theta.size
    size = R.shape[0] - 1
    linear = size - count
    gradient = np.zeros(count)
    hessian = np.zeros((count, count))
    basis = np.zeros((count, count))
    for k in range(count):
        row = R[linear + k, linear:]
        for i in range(k, count):
            gradient[i] += row[i] * row[count]
            for j in range(k, count):
                hessian[i, j] += row[i] * row[j]
    norms = column_norms(R)
    for i in range(count):
        scale = np.sqrt(hessian[i, i]) + 1e-6 * norms[linear + i]
        basis[i, i] = 1.0 / scale if scale > 0.0 else 1.0
    if newton:
        hessian = curvature(task, place, R)
    normals = outward(task, place)
    for _ in range(2):
        quadratic = diagonalise(gradient, hessian, basis)
        if normals.shape[0] == 0:
            break
        step, _ = damped_step(quadratic, 0.0)
        if not slide(basis, normals, step):
            break
    return quadratic


@compiled(inside=True)
def slide(basis: FloatArray, normals: FloatArray, step: FloatArray) -> bool:
    """Restrict `basis` to directions along the boundary if `step` would cross it; return whether it would."""
    leaving = np.empty(normals.shape)
    count = 0
    for k in range(normals.shape[0]):
        if inner(normals[k], step) > 0.0:
            for j in range(step.size):  # by the axes of the basis
                total = 0.0
                for i in range(step.size):
                    total += normals[k, i] * basis[i, j]
                leaving[count, j] = total
            count += 1
    largest = 0.0
    for i in range(step.size):
        for j in range(step.size):
            largest = max(largest, abs(basis[i, j]))
    for k in range(count):
        row = leaving[k]
        for j in range(k):
            project_out(leaving[j], row)
        size = np.sqrt(inner(row, row))
        for j in range(row.size):
            row[j] = row[j] / size if size > 1e-10 * largest else 0.0
        for i in range(step.size):
            project_out(row, basis[i])
    return count > 0


@compiled(inside=True)
def inner(a: FloatArray, b: FloatArray) -> float:
    """Inner product of two short vectors."""
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@compiled(inside=True)
def project_out(unit: FloatArray, row: FloatArray) -> None:
    """Project the unit vector out of the row."""
    part = inner(unit, row)
    for i in range(row.size):
        row[i] -= part * unit[i]


@compiled(inlined=True)
def outward(task: Task, place: Place) -> FloatArray:
    """Outward normals of the stable region where roots touch its boundary, as rows."""
    rows = np.zeros((place.theta.size, place.theta.size))
    first = count = 0
    for k in range(3):
        polynomial = (
            place.model.C if k == 0 else place.model.D if k == 1 else place.model.F
        )
        normals = boundary_normals(polynomial, task.radii[k])
        for i in range(normals.shape[0]):
            copy_into(normals[i], rows[count, first:])
            count += 1
        first += polynomial.size - 1
    return rows[:count]


@compiled
def descend(task: Task, theta: FloatArray, rules: Rules) -> tuple[Place, bool, int]:
    """Descend from θ until converged; the cost never increases.

    Returns:
        The final place, whether it converged, and the number of steps.
    """
    used = np.zeros((ROWS, task.pad + task.u.size))
    spare = np.zeros((ROWS, task.pad + task.u.size))
    place = evaluate(task, theta, used, rules.exact)
    floor = NOISE_FREE * dot(task.y, task.y)
    damping = 1e-3
    newton = False
    idle = 0
    for iteration in range(rules.steps):
        if place.cost <= floor or theta.size == 0:
            return place, True, iteration
        quadratic = quadratic_at(task, place, newton, rules.exact)
        predicted = damped_step(quadratic, 0.0)[1]
        if predicted <= rules.settled * place.cost:
            return place, True, iteration
        if iteration >= TRIAL and place.cost - rules.faith * predicted > rules.rival:
            return place, False, iteration
        while True:
            delta, expected = damped_step(quadratic, damping)
            trial = evaluate(task, place.theta + delta, spare, rules.exact)
            gained = place.cost - trial.cost
            if gained > 0.0:
                break
            damping *= 8.0
            newton = True
            if damping > STIFF:
                return place, True, iteration
        ratio = gained / expected if expected > 0.0 else 0.0
        damping = max(
            damping * (0.1 if ratio > 0.75 else 0.5 if ratio > 0.25 else 2.0), 1e-12
        )
        newton = newton or not 0.5 < ratio < 2.0
        idle = idle + 1 if gained < FLAT * rules.settled * place.cost else 0
        place = trial
        used, spare = spare, used
        if idle == PATIENCE:
            return place, True, iteration + 1
    return place, False, rules.steps
