"""The ν-gap (Vinnicombe 1993) between models with one input and any number of outputs.

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
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.comparing import chordal, peak, winding
from twinmatch.comparing.errors import DiscriminationError
from twinmatch.comparing.graph_symbol import GraphSymbol, graph_symbol
from twinmatch.compiled import compiled
from twinmatch.signals import FloatArray

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["GraphSymbol", "chordal_distance", "graph_symbol", "nu_gap", "nu_gap_matrix", "nu_gap_of"]

ALMOST_ONE = 1 - 1e-15


def nu_gap(p1: Any, p2: Any) -> float:
    """ν-gap between two models, 0 (equal) to 1.

    Args:
        p1, p2: `control` TransferFunction or StateSpace, or `GraphSymbol`; one input, equal outputs.
            An unstable common factor of all entries is cancelled if it is common to within rounding.

    Raises:
        DiscriminationError: different time bases or numbers of outputs, more than one input, or an
            invalid model.
    """
    return nu_gap_of(graph_symbol(p1), graph_symbol(p2))


def nu_gap_of(g1: GraphSymbol, g2: GraphSymbol) -> float:
    """ν-gap between two models given as graph symbols; raises as `nu_gap`."""
    common_period(g1, g2)
    if g1.column == g2.column:
        return 0.0
    largest, half_turns = _compare(
        g1.coefficients, g2.coefficients, g1.signed, g2.signed, g1.stack, g2.stack,
        g1.spectral_roots, g2.spectral_roots,
    )  # fmt: skip
    # passing through zero is a distance of 1, which rounding may have left slightly below
    return largest if abs(half_turns) < 0.5 and largest < ALMOST_ONE else 1.0


def nu_gap_matrix(systems: Sequence[Any]) -> FloatArray:
    """ν-gaps of all pairs, shape (n, n), symmetric with a zero diagonal; raises as `nu_gap`."""
    symbols = [graph_symbol(s) for s in systems]
    gaps = np.zeros((len(symbols), len(symbols)))
    for i, g1 in enumerate(symbols):
        for j in range(i):
            gaps[i, j] = gaps[j, i] = nu_gap_of(g1, symbols[j])
    return gaps


def chordal_distance(p1: Any, p2: Any, frequencies: ArrayLike) -> FloatArray:
    """Chordal distance κ between two models at each frequency, 0 to 1.

    Args:
        p1, p2: as for `nu_gap`.
        frequencies: rad/s, not negative, any shape; for discrete models up to π over the period (with an
            unknown period: per sample).

    Raises:
        DiscriminationError: as `nu_gap`, or a frequency that is negative, not a number or above π/period.
    """
    g1, g2 = graph_symbol(p1), graph_symbol(p2)
    period = common_period(g1, g2)
    omega = np.asarray(frequencies, dtype=np.float64)
    highest = math.pi / float(period) if period else math.inf
    if not np.all((omega >= 0) & (omega <= highest * (1 + 1e-12))):
        msg = f"chordal distance: frequencies from {omega.min()} to {omega.max()} rad/s; give 0 to {highest}"
        raise DiscriminationError(msg)
    axis = np.tan(np.minimum(omega * float(period) / 2, math.pi / 2)) if period else omega
    with np.errstate(divide="ignore"):
        t = np.log(axis)
    kappa = _distances(g1.coefficients, g2.coefficients, g1.signed, g2.signed, t.ravel())
    return kappa.reshape(omega.shape)


def common_period(g1: GraphSymbol, g2: GraphSymbol) -> float | bool | None:
    """The time base that both models share."""
    if g1.outputs != g2.outputs:
        msg = f"ν-gap: one model has {g1.outputs} outputs, the other {g2.outputs}; they must be equal"
        raise DiscriminationError(msg)
    first, second = g1.period, g2.period
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
    high, low = chordal.with_powers_of_j(high), chordal.with_powers_of_j(low)
    grid = peak.frequency_grid(roots1, roots2)
    square, place = peak.highest(stack1, stack2, chordal.with_derivatives(high), grid)
    if square == 0.0:  # one model is a multiple of the other, term by term
        return 0.0, 0.0
    if -math.inf < place < math.inf:
        # the phase of c can turn fastest where c is smallest
        grid = np.sort(np.append(grid, place))
        kappa = _polished(signed1, signed2, (high, low), grid, place)
    else:
        kappa = chordal.exact_distance(signed1, signed2, (high, low), place)
    return kappa, winding.turns(signed1[0], signed2[0], roots1, roots2, grid)


@compiled
def _polished(
    signed1: tuple[FloatArray, FloatArray],
    signed2: tuple[FloatArray, FloatArray],
    pair_minors: tuple[FloatArray, FloatArray],
    grid: FloatArray,
    place: float,
) -> float:
    """Refine the largest κ near a grid node that is accurate to the search's tolerance."""
    best = chordal.exact_distance(signed1, signed2, pair_minors, place)
    node = int(np.searchsorted(grid, place))
    width = grid[min(node + 1, grid.size - 1)] - grid[max(node - 1, 0)]
    for part in (3e-2, 1e-3, 3e-5):
        h = part * width
        before = chordal.exact_distance(signed1, signed2, pair_minors, place - h)
        after = chordal.exact_distance(signed1, signed2, pair_minors, place + h)
        bend = before - 2 * best + after
        if bend < 0:
            there = place + min(1.0, max(-1.0, 0.5 * (before - after) / bend)) * h
            kappa = chordal.exact_distance(signed1, signed2, pair_minors, there)
            if kappa > best:
                best, place = kappa, there
    return best


@compiled
def _distances(
    pair1: tuple[FloatArray, FloatArray],
    pair2: tuple[FloatArray, FloatArray],
    signed1: tuple[FloatArray, FloatArray],
    signed2: tuple[FloatArray, FloatArray],
    places: FloatArray,
) -> FloatArray:
    high, low = chordal.minors(pair1[0], pair1[1], pair2[0], pair2[1])
    high, low = chordal.with_powers_of_j(high), chordal.with_powers_of_j(low)
    kappa = np.empty(places.size)
    for i in range(places.size):
        kappa[i] = chordal.exact_distance(signed1, signed2, (high, low), places[i])
    return kappa
