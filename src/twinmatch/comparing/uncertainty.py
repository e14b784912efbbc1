"""Uncertainty of the ν-gaps of a family, and of the choice that rests on them.

At one frequency the distance is the length of a complex vector, v = minors of [1 P1; 1 P2] over both lengths.
A perturbation moves it to v + e. If the true vector were t·v, the estimate would be the largest |t·v + e|
over the frequencies, and |t·v + e|² = a t² + b t + c with a = |v|², b = 2 Re v*e, c = |e|². These three
coefficients per pair are enough to compute the estimates for any true t·v.

The uncertainty is that of the matches: their parameters come with a covariance. Draws from it (fixed seed)
perturb the frequency response of every plant at every operating point to first order. Parameters that trade
off lie in a curved valley: to first order, a step along its tangent hardly changes the response, whereas
simulating with the stepped parameters would change it. The exact ν-gaps are kept as centres; only their
spread is computed from the draws. A candidate that was given, not matched, has no covariance and counts as
exact.

A ν-gap is a maximum, and noise biases it upwards: matches of one plant differ a little, and draws around
them differ more. Percentiles of the draws would exclude the true value. So the interval is that of a test
(Neyman): it holds the gaps t·δ for which the estimate δ is neither among the smallest nor among the largest
twentieth of the estimates expected for t·δ.

Model errors that no parameters of a structure can describe are not included.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinmatch.comparing.models import Candidate
from twinmatch.comparing.plant_gap import (
    LoopConditions,
    PlantGaps,
    plant_gaps,
    response_slopes,
)
from twinmatch.comparing.polynomials import DiscriminationError
from twinmatch.compiled import compiled
from twinmatch.dynamics import Parameters
from twinmatch.signals import FloatArray, OperatingPoint

Complex = NDArray[np.complex128]

HALVINGS = 7
"""Halvings of the interval that contains a scale: finer than a hundred draws resolve."""


def directions(responses: Complex) -> Complex:
    """Columns [1; P] of length 1, shape (…, 2), for responses P of any shape."""
    scale = 1 / np.sqrt(1.0 + (responses.real**2 + responses.imag**2))
    columns = np.empty((*responses.shape, 2), dtype=np.complex128)
    columns[..., 0] = scale
    columns[..., 1] = responses * scale
    return columns


@compiled
def disturbed_pair(
    still1: Complex, still2: Complex, moved1: Complex, moved2: Complex
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The coefficients a, b and c of one pair.

    Args:
        still1: unperturbed direction of the first model, shape (frequencies, 2).
        still2: that of the second model.
        moved1: direction of the first model in every draw, shape (draws, frequencies, 2).
        moved2: that of the second model.

    Returns:
        Shapes (frequencies,), (frequencies, draws) and (frequencies, draws): draws are contiguous in memory,
        so that they can be vectorised.
    """
    draws, points, _ = moved1.shape
    a = np.empty(points)
    b = np.empty((points, draws))
    c = np.empty((points, draws))
    for w in range(points):
        v = still1[w, 0] * still2[w, 1] - still1[w, 1] * still2[w, 0]
        a[w] = v.real * v.real + v.imag * v.imag
        for s in range(draws):
            e = (
                moved1[s, w, 0] * moved2[s, w, 1]
                - moved1[s, w, 1] * moved2[s, w, 0]
                - v
            )
            b[w, s] = 2 * (v.real * e.real + v.imag * e.imag)
            c[w, s] = e.real * e.real + e.imag * e.imag
    return a, b, c


@compiled
def turn(direction1: Complex, direction2: Complex) -> float:
    """Total phase change of the inner product of two models' directions over the frequencies, radians."""
    total = 0.0
    before = 0j
    for w in range(direction1.shape[0]):
        inner = direction1[w, 0] * direction2[w, 0].conjugate()
        inner += direction1[w, 1] * direction2[w, 1].conjugate()
        if w > 0:
            ratio = inner * before.conjugate()
            total += math.atan2(ratio.imag, ratio.real)
        before = inner
    return total


@compiled(innermost=True)
def _larger(a: float, b: float) -> float:
    """The larger of two numbers; NaN if one of them is."""
    return a if a > b or math.isnan(a) else b


@compiled
def failing_draws(
    a: FloatArray,
    c: FloatArray,
    still: tuple[Complex, Complex],
    moved: tuple[Complex, Complex],
    failed: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """In which draws the winding condition fails at any operating point, shape (draws,).

    The condition cannot change while the distance stays below 1 along the perturbation; a change shows in the
    phase of the inner product.

    Args:
        a: from `disturbed_pair`, the frequencies of one operating point after the other.
        c: likewise.
        still: unperturbed directions of the two models, shape (frequencies, 2).
        moved: the same in every draw, shape (draws, frequencies, 2).
        failed: whether the condition fails at each operating point without the draws, shape (points,).
    """
    width = a.size // failed.size
    fails = np.zeros(c.shape[1], dtype=np.bool_)
    any_failed = False
    turns_before = np.empty(failed.size)
    for p in range(failed.size):
        any_failed = any_failed or failed[p]
        part = slice(p * width, (p + 1) * width)
        turns_before[p] = turn(still[0][part], still[1][part])
    still_square = 0.0
    moved_squares = np.zeros(c.shape[1])
    for w in range(a.size):
        still_square = _larger(a[w], still_square)
        for s in range(c.shape[1]):
            moved_squares[s] = _larger(c[w, s], moved_squares[s])
    top = math.sqrt(still_square)
    for s in range(c.shape[1]):
        if not any_failed and top + math.sqrt(moved_squares[s]) < 1:
            continue
        for p in range(failed.size):
            part = slice(p * width, (p + 1) * width)
            after = turn(moved[0][s, part], moved[1][s, part])
            has_changed = abs(after - turns_before[p]) > 0.5 * math.pi
            if has_changed != failed[p]:
                fails[s] = True
    return fails


@compiled
def estimates(
    which: NDArray[np.int64], a: FloatArray, b: FloatArray, c: FloatArray, scale: float
) -> FloatArray:
    """Sum over the pairs `which` of the largest |scale·v + e|, one per draw, shape (draws,)."""
    points, draws = b.shape[1:]
    total = np.zeros(draws)
    top = np.empty(draws)
    for p in which:
        top[:] = 0.0
        for w in range(points):
            square = a[p, w] * scale
            for s in range(draws):
                square_there = (square + b[p, w, s]) * scale + c[p, w, s]
                top[s] = square_there if square_there > top[s] else top[s]
        for s in range(draws):
            total[s] += min(1.0, math.sqrt(top[s]))
    return total


@compiled(inside=True)
def _number_reaching(seen: float, values: FloatArray) -> int:
    """How many of the values are `seen` or more."""
    number = 0
    for value in values:
        if value >= seen:
            number += 1
    return number


@compiled
def _bisect_scale(  # noqa: PLR0917
    which: NDArray[np.int64],
    a: FloatArray,
    b: FloatArray,
    c: FloatArray,
    seen: float,
    most: int,
    low: float,
    high: float,
) -> tuple[float, float]:
    """Interval around the scale above which more than `most` draws give `seen` or more."""
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if _number_reaching(seen, estimates(which, a, b, c, middle)) > most:
            high = middle
        else:
            low = middle
    return low, high


@compiled
def fitting_scales(
    which: NDArray[np.int64], a: FloatArray, b: FloatArray, c: FloatArray, tail: float
) -> tuple[float, float]:
    """Least and largest t for which the actual estimate lies between the quantiles tail and 1 − tail of t·v.

    The actual estimate is the sum over the pairs of the largest |v|.
    """
    estimate = 0.0
    most = 0.0
    draws = b.shape[2]
    for p in which:
        still_square = 0.0
        moved_square = 0.0
        for w in range(a.shape[1]):
            still_square = _larger(a[p, w], still_square)
            for s in range(draws):
                moved_square = _larger(c[p, w, s], moved_square)
        estimate += math.sqrt(still_square)
        most += math.sqrt(moved_square)
    rare = int(tail * draws)
    # beyond these limits no draw reaches the actual estimate
    widest = 2 * most / max(estimate, 1e-300)
    low = max(0.0, 1.0 - widest)
    high = 1.0
    if low == 0.0:
        at_zero = estimates(which, a, b, c, 0.0)
        if _number_reaching(estimate, at_zero) > rare:
            high = 0.0
    least, _ = _bisect_scale(which, a, b, c, estimate, rare, low, high)
    _, largest = _bisect_scale(
        which, a, b, c, estimate, draws - rare - 1, 1.0, 1.0 + widest
    )
    return least, largest


CONFIDENCE = 0.9
"""Confidence of the intervals, both sides together."""

TAIL = (1 - CONFIDENCE) / 2

DRAWS = 100

SEED = 2000


def covariance_root(candidate: Candidate) -> FloatArray:
    """L with L·Lᵀ the covariance, shape (n, n); undetermined directions have their scale as uncertainty.

    Raises:
        DiscriminationError: the covariance has another shape, or an entry that is not a number.
    """
    covariance = candidate.covariance
    if not len(covariance):
        return np.zeros((0, 0))
    scales = np.array(
        [candidate.parameters.model.declared[name].scale for name in candidate.free]
    )
    if covariance.shape != (scales.size, scales.size) or np.isnan(covariance).any():
        raise DiscriminationError(
            f"uncertainty: a covariance of shape {covariance.shape} for {len(candidate.free)} "
            "parameters; give one row and one column of numbers for each, or none"
        )
    relative = covariance / np.outer(scales, scales)
    if not np.isfinite(relative).all():  # the match left some combination unbounded
        return np.diag(scales)
    values, vectors = np.linalg.eigh((relative + relative.T) / 2)
    values = np.maximum(values, 0.0)
    return np.asarray(scales[:, None] * vectors * np.sqrt(values / (1.0 + values)))


@dataclass(frozen=True, eq=False)
class FamilyUncertainty:
    """90 % intervals of a family's ν-gaps and their sums, and the probabilities of being nominal."""

    nu_gap_low: FloatArray
    """Lower ends, shape (n, n), symmetric with a zero diagonal, like the upper ends."""
    nu_gap_high: FloatArray
    sum_low: FloatArray
    """Lower ends for the column sums, shape (n,)."""
    sum_high: FloatArray
    nominal_probability: FloatArray
    """Share of the draws in which a candidate has the smallest sum, shape (n,); adds up to 1."""


def family_uncertainty(
    twins: Sequence[Candidate],
    gaps: PlantGaps,
    loop: LoopConditions,
    *,
    plant: Parameters | None = None,
    seed: int = SEED,
) -> FamilyUncertainty:
    """Compute intervals and probabilities from the covariances of the matches.

    Args:
        twins: the candidates.
        gaps: ν-gaps between their plants.
        loop: the loop in which they are held.
        plant: the plant as it is now; two candidates always have equal sums, so the one nearer to the plant
            counts as nominal.
        seed: seed of the draws; the same seed gives the same bits.

    Raises:
        DiscriminationError: no twin, gaps of another shape, or a covariance that does not fit the
            parameters.
    """
    n = len(twins)
    if not n or gaps.at.shape[1:] != (n, n):
        msg = f"uncertainty: {n} twins and ν-gaps of shape {gaps.at.shape}; give at least one, (points, n, n)"
        raise DiscriminationError(msg)
    family = _Family.of(twins, gaps, loop, seed)
    low = np.zeros((n, n))
    high = np.zeros((n, n))
    for p, (i, j) in enumerate(zip(family.first, family.second, strict=True)):
        low[i, j], high[i, j] = low[j, i], high[j, i] = family.interval(p)
    sums = [family.sum_of(k) for k in range(n)]
    lows, highs, draws = map(np.array, zip(*sums, strict=True))
    shares = _shares(draws)
    if n == 2:
        shares = (
            np.full(2, 0.5)
            if plant is None
            else _nearer(twins, plant, gaps.points, loop, seed)
        )
    return FamilyUncertainty(low, high, lows, highs, shares)


@dataclass(frozen=True, eq=False)
class _Family:
    """Every pair: its ν-gap, and its spread as `spread` describes it."""

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    gaps: FloatArray
    a: FloatArray
    b: FloatArray
    c: FloatArray
    fails: NDArray[np.bool_]

    @classmethod
    def of(
        cls,
        twins: Sequence[Candidate],
        gaps: PlantGaps,
        loop: LoopConditions,
        seed: int,
    ) -> _Family:
        rng = np.random.default_rng(seed)
        still = []
        moved = []
        for twin in twins:
            unperturbed, drawn = _directions(twin, gaps.points, loop, rng)
            still.append(unperturbed)
            moved.append(drawn)
        first, second = np.triu_indices(len(twins), 1)
        width = still[0].shape[0]
        a = np.empty((first.size, width))
        b = np.empty((first.size, width, DRAWS))
        c = np.empty((first.size, width, DRAWS))
        fails = np.zeros((first.size, DRAWS), dtype=np.bool_)
        for p, (i, j) in enumerate(zip(first, second, strict=True)):
            a[p], b[p], c[p] = disturbed_pair(still[i], still[j], moved[i], moved[j])
            has_failed = gaps.at[:, i, j] == 1
            fails[p] = failing_draws(
                a[p], c[p], (still[i], still[j]), (moved[i], moved[j]), has_failed
            )
        return cls(first, second, gaps.matrix[first, second], a, b, c, fails)

    def interval(self, pair: int) -> tuple[float, float]:
        """Interval of one ν-gap."""
        gap = float(self.gaps[pair])
        if gap == 1:
            return float(np.quantile(self._whole(pair), TAIL)), 1.0
        if gap == 0:
            return 0.0, float(np.quantile(self._estimates([pair]), CONFIDENCE))
        least, most = fitting_scales(np.array([pair]), self.a, self.b, self.c, TAIL)
        reaches = float(np.mean(self.fails[pair])) > TAIL
        return least * gap, 1.0 if reaches else min(1.0, most * gap)

    def sum_of(self, candidate: int) -> tuple[float, float, FloatArray]:
        """Interval of one candidate's sum, and the sum in every draw, shape (draws,); pairs failing the
        winding condition count separately."""
        pairs = np.flatnonzero((self.first == candidate) | (self.second == candidate))
        winding_failed = pairs[self.gaps[pairs] == 1]
        comparable = pairs[self.gaps[pairs] < 1]
        draws = np.zeros(DRAWS)
        low = 0.0
        high = float(winding_failed.size)
        if winding_failed.size:
            for pair in winding_failed:
                draws += self._whole(pair)
            low = float(np.quantile(draws, TAIL))
        if comparable.size:
            total = float(self.gaps[comparable].sum())
            least, most = fitting_scales(comparable, self.a, self.b, self.c, TAIL)
            low = low + least * total
            high = high + min(float(comparable.size), most * total)
            draws += _recentre(self._estimates(comparable), total)
        return low, high, draws

    def distance(self, pair: int) -> FloatArray:
        """Draws of one ν-gap, shape (draws,)."""
        gap = float(self.gaps[pair])
        return self._whole(pair) if gap == 1 else _recentre(self._whole(pair), gap)

    def _estimates(self, pairs: ArrayLike) -> FloatArray:
        return np.asarray(estimates(np.asarray(pairs), self.a, self.b, self.c, 1.0))

    def _whole(self, pair: int) -> FloatArray:
        """The ν-gap in every draw, winding condition included."""
        return np.where(self.fails[pair], 1.0, self._estimates([pair]))


def _recentre(draws: FloatArray, estimate: float) -> FloatArray:
    """Shift draws so that their median is the estimate: noise biases distances upwards."""
    return draws + (estimate - float(np.median(draws)))


def _shares(draws: FloatArray) -> FloatArray:
    """Share of the draws in which each row is the smallest, shape (n,)."""
    wins = np.bincount(np.argmin(draws, axis=0), minlength=len(draws))
    return np.asarray(wins / draws.shape[1], dtype=np.float64)


def _nearer(
    twins: Sequence[Candidate],
    plant: Parameters,
    points: Sequence[OperatingPoint],
    loop: LoopConditions,
    seed: int,
) -> FloatArray:
    """Share of the draws in which each of two candidates is nearer to the plant, shape (2,)."""
    with_plant = [*twins, Candidate("", 0.0, plant, None)]
    gaps = plant_gaps([twin.parameters for twin in with_plant], points, loop)
    family = _Family.of(with_plant, gaps, loop, seed)
    to_plant = np.flatnonzero(family.second == 2)
    return _shares(np.array([family.distance(int(pair)) for pair in to_plant]))


def _directions(
    twin: Candidate,
    points: Sequence[OperatingPoint],
    loop: LoopConditions,
    rng: np.random.Generator,
) -> tuple[Complex, Complex]:
    """Directions of a twin's plant, the frequencies of one operating point after the other, unperturbed and
    in every draw; shapes (frequencies, 2) and (draws, frequencies, 2).

    Without an operating point both are those of a zero response.
    """
    root = covariance_root(twin)
    draws = rng.standard_normal((DRAWS, len(root))) @ root.T
    if not points:
        return directions(np.zeros(1, np.complex128)), directions(
            np.zeros((DRAWS, 1), np.complex128)
        )
    free = twin.free if len(root) else ()
    responses = []
    slopes = []
    for point in points:
        response_there, slopes_there = response_slopes(
            twin.parameters, free, point, loop
        )
        responses.append(response_there)
        slopes.append(slopes_there)
    response = np.concatenate(responses)
    moved = np.asarray(response + draws @ np.hstack(slopes), dtype=np.complex128)
    return directions(response), directions(moved)
