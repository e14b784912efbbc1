"""The ν-gap (Vinnicombe 1993) between models; what follows is for one input and any number of outputs.

With stable spectral factors w of |g|², c = g2* g1/(w2* w1) is the inner product of the normalised symbols:
|c|² = 1 − κ². Its phase is tracked along the axis from 0 to ∞; steps are halved until the curve between two
points is so close to its chord that it cannot pass on the other side of zero.

δν(P1, P2) is the largest chordal distance between the models over all frequencies if the inner product of
their normalised graph symbols, g2* g1, has no zero on the axis and does not wind around it; otherwise 1.
The paper's formula is the first half alone; two models with a small chordal distance can have a ν-gap of 1,
such as 0.1/(s + 1) and 0.1/(s − 1).

Discrete models are mapped to the half plane, which leaves the ν-gap unchanged. Coefficients are exact up to
the search; minors and the final value are computed with 32 digits, so the result is accurate to about 12
digits even between models that agree in eight.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinmatch.comparing import chordal
from twinmatch.comparing.chordal import value
from twinmatch.comparing.graph_symbol import GraphSymbol, graph_symbol
from twinmatch.comparing.matrix_gap import matrix_nu_gap
from twinmatch.comparing.polynomials import DiscriminationError
from twinmatch.comparing.state_space import StateSpace, inputs_of
from twinmatch.compiled import compiled
from twinmatch.signals import FloatArray

ZERO = 1e-8
"""Below this |c| counts as zero: κ is 1 to the last bit."""

CURVATURE = 3.0
"""Least distance from the chord to zero, in deviations of a step's midpoint from its chord."""

DEPTH = 60


@compiled
def _direction(roots: NDArray[np.complex128], t: float) -> complex:
    """Π (jΩ + root) with every factor scaled to length 1 or less and 0.7 or more."""
    product = 1 + 0j
    if t <= 0:
        frequency = math.exp(t)
        for root in roots:
            product *= (root + 1j * frequency) * (1 / (abs(root) + frequency))
    else:
        inverse = math.exp(-t)
        for root in roots:
            product *= (root * inverse + 1j) * (1 / (abs(root) * inverse + 1))
    return product


@compiled
def inner_product(
    signed1: FloatArray,
    signed2: FloatArray,
    roots1: NDArray[np.complex128],
    roots2: NDArray[np.complex128],
    t: float,
) -> complex:
    """c at t: real at both ends of the axis."""
    inner = 0j
    size1 = 0.0
    size2 = 0.0
    x = math.exp(-abs(t))
    above = t > 0
    for k in range(signed1.shape[0]):
        real1, imaginary1 = value(signed1[k], x, above)
        real2, imaginary2 = value(signed2[k], x, above)
        inner += complex(
            real1 * real2 + imaginary1 * imaginary2,
            real2 * imaginary1 - real1 * imaginary2,
        )
        size1 += real1 * real1 + imaginary1 * imaginary1
        size2 += real2 * real2 + imaginary2 * imaginary2
    smooth = _direction(roots1, t).conjugate() * _direction(roots2, t)
    return (
        inner
        * smooth
        * (1 / abs(smooth))
        * (1 / math.sqrt(size1))
        * (1 / math.sqrt(size2))
    )


@compiled
def _clearance(a: complex, b: complex) -> float:
    """Distance from zero to the chord from a to b."""
    step = b - a
    length = step.real * step.real + step.imag * step.imag
    along = 0.0 if length == 0 else -(a.real * step.real + a.imag * step.imag) / length
    return abs(a + min(1.0, max(0.0, along)) * step)


@compiled
def turns(
    signed1: FloatArray,
    signed2: FloatArray,
    roots1: NDArray[np.complex128],
    roots2: NDArray[np.complex128],
    grid: FloatArray,
) -> float:
    """Half turns of c along the grid, counter-clockwise; NaN if c passes through zero."""
    total = 0.0
    nodes = np.empty(DEPTH + 1)
    values = np.empty(DEPTH + 1, dtype=np.complex128)
    low_node = grid[0]
    c_left = inner_product(signed1, signed2, roots1, roots2, grid[0])
    for node in grid[1:]:
        nodes[0] = node
        values[0] = inner_product(signed1, signed2, roots1, roots2, node)
        waiting = 1
        while waiting:
            high_node = nodes[waiting - 1]
            c_right = values[waiting - 1]
            if min(abs(c_left), abs(c_right)) < ZERO:
                return math.nan
            middle = 0.5 * (low_node + high_node)
            c = inner_product(signed1, signed2, roots1, roots2, middle)
            bend = CURVATURE * abs(c - 0.5 * (c_left + c_right))
            if (
                min(_clearance(c_left, c), _clearance(c, c_right)) > bend
                or waiting > DEPTH
            ):
                for end in (c, c_right):
                    ratio = end * c_left.conjugate()
                    total += math.atan2(ratio.imag, ratio.real)
                    c_left = end
                low_node = high_node
                waiting -= 1
            else:
                nodes[waiting] = middle
                values[waiting] = c
                waiting += 1
    return total / math.pi


ALMOST_ONE = 1 - 1e-15


def nu_gap(p1: Any, p2: Any) -> float:
    """ν-gap between two models, 0 (equal) to 1.

    Args:
        p1, p2: StateSpace, ours or that of `control`; with one input also `GraphSymbol`, and TransferFunction
            of `control`. An unstable common factor of all entries is cancelled if it is common to within
            rounding. With more than one input the result has about ten digits (`matrix_nu_gap`).

    Raises:
        DiscriminationError: different time bases or numbers of inputs or outputs, or an invalid model.
    """
    if inputs_of(p1) > 1 and inputs_of(p2) > 1:
        return matrix_nu_gap(StateSpace.of(p1), StateSpace.of(p2))
    g1 = graph_symbol(p1)
    g2 = graph_symbol(p2)
    common_period(g1, g2)
    return gap_between(g1, g2)


@lru_cache(maxsize=8192)  # candidates stay in the family for many verdicts
def gap_between(g1: GraphSymbol, g2: GraphSymbol) -> float:
    """The ν-gap of two symbols; it is kept, and another call costs a look-up."""
    if g1.column == g2.column:
        return 0.0
    largest, half_turns = _compare(
        g1.coefficients,
        g2.coefficients,
        g1.signed,
        g2.signed,
        g1.stack,
        g2.stack,
        g1.spectral_roots,
        g2.spectral_roots,
    )
    # passing through zero is a distance of 1, which rounding may have left slightly below
    return largest if abs(half_turns) < 0.5 and largest < ALMOST_ONE else 1.0


def nu_gap_matrix(systems: Sequence[Any]) -> FloatArray:
    """ν-gaps of all pairs, shape (n, n), symmetric with a zero diagonal; raises as `nu_gap`."""
    symbols = [graph_symbol(s) for s in systems]
    gaps = np.zeros((len(symbols), len(symbols)))
    for i, g1 in enumerate(symbols):
        for j in range(i):
            gaps[i, j] = gaps[j, i] = nu_gap(g1, symbols[j])
    return gaps


def common_period(g1: GraphSymbol, g2: GraphSymbol) -> float | bool | None:
    """The time base that both models share."""
    if g1.outputs != g2.outputs:
        msg = f"ν-gap: one model has {g1.outputs} outputs, the other {g2.outputs}; they must be equal"
        raise DiscriminationError(msg)
    first = g1.period
    second = g2.period
    if first is None or second is None:
        return second if first is None else first
    if first is True or second is True:
        if first and second:
            return second if first is True else first
    elif first == second:
        return first
    msg = f"ν-gap: one model has period {first}, the other {second} (0: continuous); they must be equal"
    raise DiscriminationError(msg)


@compiled
def _compare(  # noqa: PLR0917
    pair1: tuple[FloatArray, FloatArray],
    pair2: tuple[FloatArray, FloatArray],
    signed1: tuple[FloatArray, FloatArray],
    signed2: tuple[FloatArray, FloatArray],
    stack1: FloatArray,
    stack2: FloatArray,
    roots1: NDArray[np.complex128],
    roots2: NDArray[np.complex128],
) -> tuple[float, float]:
    """Largest κ, and the half turns of the inner product (NaN if it passes through zero)."""
    high, low = chordal.minors(pair1[0], pair1[1], pair2[0], pair2[1])
    high = chordal.with_powers_of_j(high)
    low = chordal.with_powers_of_j(low)
    grid = chordal.frequency_grid(roots1, roots2)
    square, place = chordal.highest(
        stack1, stack2, chordal.with_derivatives(high), grid
    )
    if square == 0.0:  # one model is a multiple of the other, term by term
        return 0.0, 0.0
    if -math.inf < place < math.inf:
        # the phase of c can turn fastest where c is smallest
        node = 0
        finer = np.empty(grid.size + 1)
        for k in range(grid.size):
            node += grid[k] < place
            finer[k if grid[k] < place else k + 1] = grid[k]
        finer[node], grid = place, finer
        kappa = _refine_largest(signed1, signed2, (high, low), grid, node)
    else:
        kappa = chordal.exact_distance(signed1, signed2, (high, low), place)
    return kappa, turns(signed1[0], signed2[0], roots1, roots2, grid)


@compiled
def _refine_largest(
    signed1: tuple[FloatArray, FloatArray],
    signed2: tuple[FloatArray, FloatArray],
    pair_minors: tuple[FloatArray, FloatArray],
    grid: FloatArray,
    node: int,
) -> float:
    """Refine the largest κ near a grid node that is accurate to the search's tolerance."""
    place = grid[node]
    best = chordal.exact_distance(signed1, signed2, pair_minors, place)
    width = grid[min(node + 1, grid.size - 1)] - grid[max(node - 1, 0)]
    for part in (3e-2, 1e-3, 3e-5):
        h = part * width
        before = chordal.exact_distance(signed1, signed2, pair_minors, place - h)
        after = chordal.exact_distance(signed1, signed2, pair_minors, place + h)
        bend = before - 2 * best + after
        if bend < 0:
            vertex = place + min(1.0, max(-1.0, 0.5 * (before - after) / bend)) * h
            kappa = chordal.exact_distance(signed1, signed2, pair_minors, vertex)
            if kappa > best:
                best = kappa
                place = vertex
    return best
