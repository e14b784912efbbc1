"""Nonlinear least squares on output and input, and the uncertainty of the estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twinmatch.dynamics import Descended, Parameters
from twinmatch.fitting.problem import Problem
from twinmatch.signals import FloatArray

__all__ = ["Estimate", "Uncertainty", "on_bounds", "solve", "starts_for", "uncertainty"]

_MOST_EVALUATIONS = 100
_ON_BOUND = 1e-4
"""Distance from a bound, in units of the interval, below which a parameter counts as on it."""
_ROUNDING = 1e-13
"""Share of the largest eigenvalue below which another is rounding: each entry of the information is a sum
over hundreds of samples, accurate to a relative 1e-14. The condition number is then 3e6."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """Result of least squares."""

    problem: Problem
    values: FloatArray
    """The unknowns, shape (n,)."""
    converged: bool

    @cached_property
    def residuals(self) -> FloatArray:
        """Weighted residuals of the compared signals, shape (outputs, N − 2)."""
        return self.problem.residuals(self.values).reshape(self.problem.outputs, -1)

    @property
    def chi2(self) -> float:
        """Mean squared weighted residual; near 1 if only noise remains."""
        return float(np.mean(np.square(self.residuals)))


def starts_for(problem: Problem, start: Parameters) -> list[FloatArray]:
    """Start points: the start values, and the structure's other starts if their parameters are free.

    In one of ten windows of the rig the fit from a single start stops in a side valley.
    """
    starts = [problem.values_of(start)]
    for changes in start.model.structure.starts:
        known = {name: value for name, value in changes.items() if name in problem.free}
        if known:
            starts.append(problem.values_of(start.replace(**known)))
    return starts


def solve(problem: Problem, starts: Sequence[FloatArray]) -> Estimate:
    """The best of the fits from several starts; of equals the first."""
    best: Descended | None = None
    for start in starts:
        found = problem.descend(start, _MOST_EVALUATIONS, best)
        if best is None or found.cost < best.cost:
            best = found
    if best is None:
        msg = "solve: no start; give at least one"
        raise ValueError(msg)
    return Estimate(problem, best.values, best.converged)


def on_bounds(problem: Problem, values: FloatArray) -> tuple[str, ...]:
    """Names of the parameters that ended on a bound."""
    width = problem.upper - problem.lower
    near = np.minimum(values - problem.lower, problem.upper - values) <= _ON_BOUND * width
    return tuple(name for name, hit in zip(problem.names, near, strict=True) if hit)


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Information of the window about the free parameters."""

    fisher: FloatArray
    """Information JᵀJ of the weighted residuals, shape (n, n), in the parameters' own units."""
    scores: FloatArray
    """Covariance of the gradient Jᵀr, shape (n, n); for white noise of variance 1 it is `fisher`."""
    scales: FloatArray
    """Typical sizes of the parameters, shape (n,)."""
    eigenvalues: FloatArray
    """Eigenvalues of the information in units of the parameters' scales, ascending, shape (n,)."""
    directions: FloatArray
    """Its eigenvectors as columns, shape (n, n); the largest component of each is positive."""
    condition: float
    """Condition number of the scaled Jacobian; infinite if a direction has no effect at all."""
    covariance: FloatArray
    """Covariance of the parameters, shape (n, n); infinite where the information is singular."""

    def given(self, places: Sequence[int]) -> Uncertainty:
        """The uncertainty of the parameters at these places if the others are known."""
        block = np.ix_(places, places)
        return _known(self.fisher[block], self.scores[block], self.scales[list(places)])


def uncertainty(problem: Problem, estimate: Estimate) -> Uncertainty:
    """Information and covariance of an estimate.

    A plant's noise enters at the sensor and circulates in the loop, so the residuals are far from white
    and the textbook covariance s²·(JᵀJ)⁻¹ is too small by a factor of two to four. Here the noise of
    each reading is propagated through the twin's loop: (JᵀJ)⁻¹·S·(JᵀJ)⁻¹ with S = Σ_k (Jᵀm_k)(Jᵀm_k)ᵀ,
    m_k the residuals caused by noise at sample k alone, scaled so that the noise explains the actual
    residuals.
    """
    evaluation = problem.evaluate(estimate.values)
    _, _, fisher = evaluation.normal
    sums, expected = evaluation.noise_scores
    free_samples = 1.0 - len(problem.names) / estimate.residuals.size
    scores = sums.T @ sums * (estimate.chi2 / free_samples / expected)
    return _known(fisher, scores, problem.scales)


def _known(fisher: FloatArray, scores: FloatArray, scales: FloatArray) -> Uncertainty:
    scaling = np.outer(scales, scales)
    eigenvalues, directions = np.linalg.eigh(fisher * scaling)
    eigenvalues = np.maximum(eigenvalues, 0.0)
    largest_components = directions[np.argmax(np.abs(directions), axis=0), np.arange(scales.size)]
    directions = directions * np.where(largest_components < 0.0, -1.0, 1.0)
    smallest, largest = float(eigenvalues[0]), float(eigenvalues[-1])
    if smallest > _ROUNDING * largest:
        condition = float(np.sqrt(largest / smallest))
        inverse = np.linalg.inv(fisher * scaling) * scaling
        covariance = inverse @ scores @ inverse
        covariance = (covariance + covariance.T) / 2
    else:
        condition, covariance = float("inf"), np.full_like(fisher, np.inf)
    return Uncertainty(fisher, scores, scales, eigenvalues, directions, condition, covariance)
