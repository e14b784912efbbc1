"""Nonlinear least squares on output and input, covariance of the estimate, profile-likelihood intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from twinmatch.compiled import compiled
from twinmatch.dynamics import Parameters, box_step
from twinmatch.fitting.problem import LASTING, Evaluation, Problem, ended_on_bounds
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

_ROUNDING = 1e-13
"""Share of the largest eigenvalue below which another is rounding: each entry of the information is a sum
over hundreds of samples, accurate to a relative 1e-14. The condition number is then 3e6."""
_PARTAKES: Final = 0.3
"""Component of a direction from which a parameter counts as part of it: less is a tenth of its length, squared."""
_CONCERNED: Final = 1e-3
"""Share of a parameter in combinations without effect from which on it takes part: rounding gives less."""
_FAR: Final = 10.0
"""Factor between a value and its typical size from which the size says nothing of it."""
QUANTILE: Final = 3.841458820694124
"""95 % quantile of χ² with one degree of freedom."""


class _ProfileSearch(Rule):
    """How an end of an interval is found. Newton's iteration takes a few steps, each shortened a few times
    where it leads too far; where a valley folds back, the end is bracketed instead, with refits of all other
    parameters. An end that is off by 2 % of the rise is off by 1 % of the half interval, as the rise is
    nearly a parabola."""

    steps: int = 8
    """Steps of Newton, at most."""
    cuts: int = 3
    """How often one of them is shortened, at most."""
    cut: float = 0.4
    """Factor on the way of a step that is shortened."""
    far: float = 2.0
    """Rises above the limit, in units of the allowed one, from which on a step leads too far."""
    refits: int = 16
    """Refits of a bracketed end, at most."""
    evaluations: int = 30
    """Evaluations of a refit, at most."""
    growth: float = 3.0
    """Factor on the distance of the next value, as long as none is outside."""
    close: float = 0.02
    """Tolerance of an end, as a share of the allowed rise of the sum of squares."""
    refined: float = 2e-4
    """What a refit may leave above its minimum, as such a share: a hundredth of the tolerance."""


_PROFILE: Final = _ProfileSearch()


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
        return self.problem.residuals(self.values)

    @property
    def chi2(self) -> float:
        """Mean squared weighted residual; near 1 if only noise remains."""
        return self.problem.mean_square(self.residuals)


def starts_for(problem: Problem, start: Parameters) -> list[FloatArray]:
    """Start points: the start values, and the structure's other starts if their parameters are free.

    In one of ten windows of the rig the fit from a single start stops in a side valley.
    """
    starts = [problem.values_of(start)]
    for changes in start.model.structure.starts:
        free_changes = {
            name: value for name, value in changes.items() if name in problem.free
        }
        if free_changes:
            starts.append(problem.values_of(start.replace(**free_changes)))
    return starts


class Effort(NamedTuple):
    """How far a search goes."""

    evaluations: int
    """At most so many from each start."""
    negligible: float = 0.0
    """It ends where a step promises no larger decrease of the mean squared weighted residual; 0: at rounding."""


FULL: Final = Effort(100)
"""What a match is worth."""


def solve(
    problem: Problem, starts: Sequence[FloatArray], effort: Effort = FULL
) -> Estimate:
    """The best of the fits from several starts; of equals the first."""
    settled = effort.negligible * problem.residual_count
    best = problem.descend(starts[0], effort.evaluations, settled=settled)
    for start in starts[1:]:
        fit = problem.descend(start, effort.evaluations, best, settled)
        if fit.cost < best.cost:
            best = fit
    return Estimate(problem, best.values, best.converged)


def on_bounds(problem: Problem, values: FloatArray) -> tuple[str, ...]:
    """Names of the parameters that ended on a bound."""
    return ended_on_bounds(problem.unknowns, values)


class Hidden(NamedTuple):
    """Combinations of parameters that have no effect at all: of a gain and a rest, if the input stood still."""

    held: list[int]
    """Places of parameters, one for each combination: once these are known, nothing is hidden."""
    concerned: list[int]
    """Places of all that take part: each may have any value."""


def _hidden(
    eigenvalues: FloatArray, directions: FloatArray, first: Sequence[int] = ()
) -> Hidden:
    """What the eigenvectors, as columns, of the information in units of the scales say of it."""
    has_no_effect = ~(eigenvalues > _ROUNDING * eigenvalues[-1])
    combinations = directions[:, has_no_effect]
    concerned = np.linalg.norm(combinations, axis=1) > _CONCERNED
    return Hidden(_one_of_each(combinations, first), np.flatnonzero(concerned).tolist())


def _one_of_each(combinations: FloatArray, first: Sequence[int]) -> list[int]:
    """Places of parameters, one for each combination, which are columns; those at `first` before others.

    Each is the largest of its combination, and is then eliminated from the rest of them.
    """
    held: list[int] = []
    while combinations.shape[1]:
        combination = combinations[:, 0]
        sizes = np.abs(combination).tolist()
        preferred = [i for i in first if sizes[i] > _CONCERNED]
        place = max(preferred or range(len(sizes)), key=sizes.__getitem__)
        held.append(place)
        rest = combinations[:, 1:]
        combinations = rest - np.outer(combination, rest[place] / combination[place])
    return held


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

    @property
    def covariance_of_shown(self) -> FloatArray:
        """Covariance of the parameters, shape (n, n); infinite only for those whose values nothing tells.

        What has no effect hides nothing of the others.
        """
        if math.isfinite(self.condition):
            return self.covariance
        hidden = self.hidden()
        places = [i for i in range(self.scales.size) if i not in hidden.held]
        covariance = np.full_like(self.fisher, np.inf)
        if places:
            covariance[np.ix_(places, places)] = self.given(places).covariance
        covariance[hidden.concerned, :] = np.inf
        covariance[:, hidden.concerned] = np.inf
        return covariance

    def hidden(self, first: Sequence[int] = ()) -> Hidden:
        """What has no effect at all; parameters at the places `first` are held before others."""
        return _hidden(self.eigenvalues, self.directions, first)

    def given(self, places: Sequence[int]) -> Uncertainty:
        """The uncertainty of the parameters at these places if the others are known."""
        block = np.ix_(places, places)
        return _uncertainty_of(
            self.fisher[block], self.scores[block], self.scales[list(places)]
        )

    def confused(self, most: float) -> list[int]:
        """Places of the parameters that hardly show apart: what they share shows over `most` times less than
        what shows most, both in units of the scales."""
        hardly_shows = self.eigenvalues * most**2 < self.eigenvalues[-1]
        shares = np.abs(self.directions[:, hardly_shows]).max(axis=1, initial=0.0)
        return np.flatnonzero(shares > _PARTAKES).tolist()

    def condition_of(self, places: Sequence[int]) -> float:
        """Condition number of the scaled Jacobian for the parameters at these places, while all are fitted: that of
        the information which is left for them."""
        left_out = [i for i in range(self.scales.size) if i not in places]
        if not left_out or not math.isfinite(self.condition):
            return self.condition
        scaled = self.fisher * np.outer(self.scales, self.scales)
        of_places = scaled[np.ix_(places, places)]
        of_left_out = scaled[np.ix_(left_out, left_out)]
        between = scaled[np.ix_(left_out, places)]
        shared = between.T @ np.linalg.solve(of_left_out, between)
        eigenvalues = np.linalg.eigvalsh(of_places - shared)
        if not eigenvalues[0] > _ROUNDING * eigenvalues[-1]:
            return math.inf
        return float(np.sqrt(eigenvalues[-1] / eigenvalues[0]))


def uncertainty(problem: Problem, estimate: Estimate) -> Uncertainty:
    """Information and covariance of an estimate.

    A plant's noise enters at the sensor and circulates in the loop, so the residuals are far from white
    and the textbook covariance s²·(JᵀJ)⁻¹ is too small by a factor of two to four. Here the noise of
    each reading is propagated through the twin's loop: (JᵀJ)⁻¹·S·(JᵀJ)⁻¹ with S = Σ_k (Jᵀm_k)(Jᵀm_k)ᵀ,
    m_k the residuals caused by noise at sample k alone, scaled so that the noise explains the actual
    residuals.
    """
    fisher = problem.evaluate(estimate.values).hessian
    sums, expected = problem.noise_scores(estimate.values)
    free_samples = 1.0 - len(problem.names) / estimate.residuals.size
    scores = sums.T @ sums * (estimate.chi2 / free_samples / expected)
    n_free = len(problem.free)
    pull = problem.experiment.pull
    scores[:n_free, :n_free] += np.diag(LASTING * pull)
    return _uncertainty_of(fisher, scores, _sizes_at(problem, estimate.values))


def _sizes_at(problem: Problem, values: FloatArray) -> FloatArray:
    """Typical sizes of the unknowns, shape (n,): where a default is far from the value, that of the value.

    Otherwise a default that is hundreds of times too small looks like a direction that hardly shows.
    """
    sizes = problem.scales.copy()
    for place, (unknown, value) in enumerate(
        zip(problem.unknowns, values.tolist(), strict=True)
    ):
        is_far = not sizes[place] / _FAR <= value <= sizes[place] * _FAR
        if unknown.relative and unknown.bounds[0] > 0.0 and is_far:
            sizes[place] = value
    return sizes


def _uncertainty_of(
    fisher: FloatArray, scores: FloatArray, scales: FloatArray
) -> Uncertainty:
    scaling = np.outer(scales, scales)
    eigenvalues, directions = np.linalg.eigh(fisher * scaling)
    eigenvalues = np.maximum(eigenvalues, 0.0)
    largest_components = directions[
        np.argmax(np.abs(directions), axis=0), np.arange(scales.size)
    ]
    directions = directions * np.where(largest_components < 0.0, -1.0, 1.0)
    smallest = float(eigenvalues[0])
    largest = float(eigenvalues[-1])
    if smallest > _ROUNDING * largest:
        condition = float(np.sqrt(largest / smallest))
        inverse = np.linalg.inv(fisher * scaling) * scaling
        covariance = inverse @ scores @ inverse
        covariance = (covariance + covariance.T) / 2
    else:
        condition = float("inf")
        covariance = np.full_like(fisher, np.inf)
    return Uncertainty(
        fisher, scores, scales, eigenvalues, directions, condition, covariance
    )


def profile_intervals(
    problem: Problem, values: FloatArray, covariance: FloatArray
) -> FloatArray:
    """95 % interval of each parameter around the estimate `values`, shape (n, 2).

    The residuals are not white, so the sum of squares may rise by the quantile times the ratio of the
    parameter's variance to the one that white noise would give: the curvature of the profile at its
    minimum then matches the variance, and its shape farther out is that of the twin. An end that a bound
    cuts off is infinite; if that bound is zero, the end is zero, because zero is a physical limit.
    """
    optimum = problem.evaluate(values)
    of_white_noise = _variances_by_white_noise(optimum.hessian, problem.scales)
    rises = QUANTILE * np.diag(covariance) / of_white_noise
    intervals = np.empty((values.size, 2))
    for i, rise in enumerate(rises.tolist()):
        for side, sign in enumerate((-1, 1)):
            has_rise = math.isfinite(rise) and rise > 0.0
            end = profile_end(problem, optimum, i, sign, rise) if has_rise else None
            if end is not None:
                intervals[i, side] = end[i]
            else:
                intervals[i, side] = (
                    0.0 if sign < 0 and problem.lower[i] == 0.0 else sign * math.inf
                )
    return intervals


def _variances_by_white_noise(fisher: FloatArray, scales: FloatArray) -> FloatArray:
    """Variances of the parameters if the residuals were white, shape (n,); NaN where nothing shows."""
    scaled = fisher * np.outer(scales, scales)
    hidden = _hidden(*np.linalg.eigh(scaled))
    places = [i for i in range(scales.size) if i not in hidden.held]
    variances = np.full(scales.size, np.nan)
    inverse = np.linalg.inv(scaled[np.ix_(places, places)])
    variances[places] = np.diag(inverse) * np.square(scales[places])
    return variances


def profile_end(
    problem: Problem, start: Evaluation, i: int, sign: int, rise: float
) -> FloatArray | None:
    """The parameters at which the sum of squares has risen by `rise` above its minimum at `start` along
    parameter `i`, with the others refitted; None if it does not rise so far inside the bounds.

    Newton's iteration for both conditions at once, the others at their minimum and the sum at its limit
    (Venzon and Moolgavkar 1988). A step after which the sum is far above its limit is shortened. Where
    the valley folds back, so that no small step makes progress, the end is bracketed instead.
    """
    point = inside = start
    limit = start.cost + rise
    bound = float(problem.upper[i] if sign > 0 else problem.lower[i])
    for _ in range(_PROFILE.steps):
        values, cost, gradient, hessian = point
        box = hessian, gradient, values, problem.lower, problem.upper, i
        gain = cost - model_profile(*box, 0.0, cost)[1]
        excess = cost - gain - limit
        if cost <= limit:
            inside = point
            if values[i] == bound:
                return None
        if abs(excess) <= _PROFILE.close * rise and gain <= _PROFILE.close * rise:
            return values
        way = model_reach(*box, float(inside.values[i]), bound, cost, limit)
        most = max(limit + _PROFILE.far * rise, cost)
        for _ in range(_PROFILE.cuts):
            step = model_profile(*box, way, cost)[0]
            trial = problem.evaluate(
                np.minimum(np.maximum(values + step, problem.lower), problem.upper),
                most,
            )
            if trial.cost <= most:
                break
            way *= _PROFILE.cut
        else:
            break
        point = trial
    return _find_end(problem, inside, i, bound, limit, rise)


def _find_end(  # noqa: PLR0917
    problem: Problem,
    inside: Evaluation,
    i: int,
    bound: float,
    limit: float,
    rise: float,
) -> FloatArray | None:
    """Find the end between a value inside and one outside, refitting the others at each.

    The first value is where the quadratic model reaches the limit. Each refit begins where the model of the one
    before has the others, and ends once it is much closer to its minimum than the end has to be.
    """
    near = inside.values
    hessian = inside.hessian
    below = _way_to_limit(inside.cost, limit, rise)
    far: FloatArray | None = None
    beyond = math.inf
    ahead = 1.0
    span = model_reach(
        hessian,
        inside.gradient,
        near,
        problem.lower,
        problem.upper,
        i,
        float(near[i]),
        bound,
        inside.cost,
        limit,
    )
    for _ in range(_PROFILE.refits):
        if far is not None:
            # Illinois method
            share = min(max(below / (below - beyond), 0.1), 0.9)
            start = near + share * (far - near)
        else:
            target = float(near[i]) + span
            target = min(target, bound) if span > 0.0 else max(target, bound)
            start = _in_valley(problem, near, hessian, i, target)
            span = _PROFILE.growth * span
        lower = problem.lower.copy()
        upper = problem.upper.copy()
        lower[i] = upper[i] = start[i]
        refit = problem.experiment.descend(
            start,
            lower,
            upper,
            problem.scales,
            _PROFILE.evaluations,
            settled=_PROFILE.refined * rise,
        )
        excess = refit.cost - limit
        if abs(excess) <= _PROFILE.close * rise:
            return refit.values
        if excess > 0.0:
            far = refit.values
            beyond = _way_to_limit(refit.cost, limit, rise)
            below, ahead = (0.5 * below, ahead) if ahead < 0.0 else (below, -1.0)
        else:
            if start[i] == bound:
                return None
            near = refit.values
            hessian = refit.hessian
            below = _way_to_limit(refit.cost, limit, rise)
            beyond, ahead = (0.5 * beyond, ahead) if ahead > 0.0 else (beyond, 1.0)
    return near


def _way_to_limit(cost: float, limit: float, rise: float) -> float:
    """How far a sum of squares is beyond its limit, in a measure in which a parabola is a straight line."""
    minimum = limit - rise
    return math.sqrt(max(cost - minimum, 0.0)) - math.sqrt(rise)


def _in_valley(
    problem: Problem, values: FloatArray, hessian: FloatArray, i: int, target: float
) -> FloatArray:
    """Values with parameter `i` at a target, and the others where they follow it by the quadratic model of a fit
    with it elsewhere."""
    way = target - float(values[i])
    no_slope = np.zeros_like(values)
    step = model_profile(
        hessian, no_slope, values, problem.lower, problem.upper, i, way, 0.0
    )[0]
    followed = np.clip(values + step, problem.lower, problem.upper)
    followed[i] = target
    return np.asarray(followed)


@compiled
def model_profile(  # noqa: PLR0917
    hessian: FloatArray,
    gradient: FloatArray,
    values: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    i: int,
    way: float,
    cost: float,
) -> tuple[FloatArray, float]:
    """The step with component `i` of `way` whose others minimise the quadratic model, and the sum there."""
    low = lower.copy()
    high = upper.copy()
    low[i] = high[i] = values[i]
    slope = gradient.copy()
    for j in range(slope.size):
        slope[j] += hessian[j, i] * way
    step, gain = box_step(hessian, slope, values, low, high, 1e-12)
    step[i] = way
    return step, cost + (2.0 * gradient[i] + hessian[i, i] * way) * way - gain


@compiled
def model_reach(  # noqa: PLR0917
    hessian: FloatArray,
    gradient: FloatArray,
    values: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    i: int,
    inside: float,
    bound: float,
    cost: float,
    limit: float,
) -> float:
    """Change of component `i` at which the quadratic model's convex profile reaches the limit."""
    near = inside - values[i]
    far = bound - values[i]
    above = (
        model_profile(hessian, gradient, values, lower, upper, i, far, cost)[1] - limit
    )
    if above <= 0.0:
        return float(far)
    below = (
        model_profile(hessian, gradient, values, lower, upper, i, near, cost)[1] - limit
    )
    if below >= 0.0:
        return float(0.5 * near)
    for _ in range(60):
        middle = 0.5 * (near + far)
        value = (
            model_profile(hessian, gradient, values, lower, upper, i, middle, cost)[1]
            - limit
        )
        if value > 0.0:
            far = middle
        else:
            near = middle
        if abs(far - near) <= 1e-3 * abs(inside - values[i] - far):
            break
    return float(0.5 * (near + far))
