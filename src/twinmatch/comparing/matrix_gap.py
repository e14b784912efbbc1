"""ν-gap and stability margin of systems with any number of inputs and outputs (Vinnicombe 1993).

At a frequency the gap of P₁ and P₂ is the largest singular value of
(I + P₂P₂*)^(−½) (P₁ − P₂) (I + P₁*P₁)^(−½). It is the ν-gap at the frequency where it is largest, if the loop
of P₁ with P₂~, u = −P₂~ y, has as many stable poles as P₁ has states and as many unstable ones as P₂: this is
Vinnicombe's winding condition, counted. Otherwise the ν-gap is 1. Factors come from orthogonalising [I; P],
and the difference is formed before anything is squared, so small gaps keep their digits.

Where it is largest is found as the H∞ norm is (Bruinsma and Steinbuch 1990): the frequencies at which a
singular value equals γ are zeros of [[I + P₂P₂~, (P₁ − P₂)/γ], [(P₁ − P₂)~/γ, I + P₁~P₁]] on the axis,
eigenvalues of a matrix of order 2(n₁ + n₂). A level slightly above the best value found has none, or the
intervals between them hold a higher value.

For systems with one input or one output, `nu_gap` and `stability_margin` compute the same from polynomials
with exact coefficients.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from twinmatch.comparing.polynomials import DiscriminationError
from twinmatch.comparing.state_space import ON_AXIS, Matrix, StateSpace, half_plane
from twinmatch.comparing.undefined import having_value
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

MAX_LEVELS = 30
ABOVE = 1e-9
"""How far a level lies above the best value found, relative to it."""

NEAR_AXIS = 1e-4
"""Zeros this close to the axis, relative to their distance from 0, are tried as frequencies: beside the level
at infinity they are known no better than to 1e-5, and one too many costs a response."""

BESIDE = 1e-6
"""A response is computed this far from a pole on the axis, relative to the slowest other pole: the gap is
smooth there, the response infinite."""

ONE = 1 - 1e-12
"""A gap from here on counts as 1."""

PER_DECADE = 8
NEIGHBOURS = np.array([-1.0, 0.0, 1.0])


class _Polishing(Rule):
    """Parabolas through three points around the top of a peak, each closer together than the one
    before."""

    most: int = 20
    """Parabolas, at most."""
    first: float = 3e-2
    """Width of the first one, relative to the frequency."""
    closer: float = 0.03
    """Width of the next one, relative to the one before it."""
    last: float = 1e-6
    """Width of the last one, relative to the frequency."""


_POLISHING: Final = _Polishing()


@having_value("the ν-gap")
def matrix_nu_gap(first: StateSpace, second: StateSpace) -> float:
    """ν-gap between two systems, 0 (equal) to 1.

    Raises:
        DiscriminationError: they differ in period or in numbers of inputs or outputs, or the ν-gap has no
            value.
    """
    if first.D.shape != second.D.shape:
        sizes = [
            f"{s.n_inputs} inputs and {s.n_outputs} outputs" for s in (first, second)
        ]
        raise DiscriminationError(
            f"ν-gap: one model has {sizes[0]}, the other {sizes[1]}; they must be equal"
        )
    left_system, right_system = half_plane(first, second)
    loop = closed_loop(left_system, right_system.adjoint)
    if loop is None:
        return 1.0
    poles = [
        np.linalg.eigvals(system.A) for system in (left_system, right_system, loop)
    ]
    winds = int(np.sum(poles[2].real < 0)) != len(left_system.A)

    def gaps(frequencies: FloatArray) -> FloatArray:
        frequencies_beside = beside(frequencies, np.concatenate(poles[:2]))
        return gaps_of(
            left_system.response(frequencies_beside),
            right_system.response(frequencies_beside),
        )

    if winds and gaps(frequencies_of(poles[2])).any():
        return 1.0
    largest = _largest(
        gaps,
        lambda level: _level_zeros(left_system, right_system, level),
        np.concatenate(poles),
        ONE,
    )
    return 1.0 if largest >= ONE else largest


@having_value("the stability margin")
def matrix_margin(plant: StateSpace, controller: StateSpace) -> float:
    """Stability margin b(P, C) of the loop u = −C·y around y = P·u, 0 (not stable) to 1.

    The inverse of the H∞ norm of [P; I](I + CP)⁻¹[I, C]. Modes that are hidden inside the plant or inside the
    controller do not count.

    Raises:
        DiscriminationError: they differ in period, their numbers of signals do not fit, or the margin has no
            value.
    """
    if plant.D.shape != controller.D.shape[::-1]:
        raise DiscriminationError(
            f"stability margin: the plant has {plant.n_inputs} inputs and {plant.n_outputs} outputs, the "
            f"controller {controller.n_inputs} inputs and {controller.n_outputs} outputs; they must fit"
        )
    loop = closed_loop(*half_plane(plant, controller))
    if loop is None:
        return 0.0
    poles = np.linalg.eigvals(loop.A)
    if (poles.real >= 0).any():
        return 0.0

    def sizes(frequencies: FloatArray) -> FloatArray:
        return sizes_of(loop.response(frequencies))

    return 1 / _largest(sizes, lambda level: _norm_zeros(loop, level), poles, np.inf)


def gaps_of(
    first: NDArray[np.complex128], second: NDArray[np.complex128]
) -> FloatArray:
    """Gaps between responses at the same frequencies, shapes (frequencies, p, m) → (frequencies,)."""
    right_factor = _factor(first)
    left_factor = _factor(second.conj().swapaxes(1, 2))
    half = np.linalg.solve(left_factor.conj().swapaxes(1, 2), first - second)
    whole = np.linalg.solve(
        right_factor.conj().swapaxes(1, 2), half.conj().swapaxes(1, 2)
    )
    return np.asarray(np.minimum(1.0, sizes_of(whole)))


def _factor(response: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """R of R*R = I + P*P: modified Gram–Schmidt on the columns of [I; P], all frequencies at once."""
    m = response.shape[2]
    identity = np.broadcast_to(np.eye(m), (len(response), m, m))
    columns = np.concatenate([identity, response], axis=1)
    factor = np.zeros((len(response), m, m), dtype=np.complex128)
    for k in range(m):
        column = columns[:, :, k]
        later_columns = columns[:, :, k + 1 :]
        factor[:, k, k] = np.sqrt(np.sum(np.abs(column) ** 2, axis=1))
        unit = column / factor[:, k, k, None]
        factor[:, k, k + 1 :] = (unit.conj()[:, None] @ later_columns)[:, 0]
        later_columns -= unit[:, :, None] * factor[:, k, None, k + 1 :]
    return factor


def sizes_of(matrices: Matrix) -> FloatArray:
    """Largest singular values, shapes (frequencies, p, m) → (frequencies,); of two rows or columns by a
    formula, which takes a fifth of the time."""
    if min(matrices.shape[1:]) != 2:
        return np.asarray(np.linalg.norm(matrices, 2, axis=(1, 2)))
    rows = matrices if matrices.shape[1] == 2 else matrices.swapaxes(1, 2)
    first, second = np.sum(np.abs(rows) ** 2, axis=2).T
    across = np.abs(np.sum(rows[:, 0] * rows[:, 1].conj(), axis=1))
    root = np.hypot(first - second, 2.0 * across)
    return np.asarray(np.sqrt(0.5 * (first + second + root)))


def closed_loop(plant: StateSpace, controller: StateSpace) -> StateSpace | None:
    """The loop u = d − C·(y + n), from [d; n] to [y; u]; None if it is not well posed."""
    p, m = plant.D.shape
    direct = np.eye(m) + controller.D @ plant.D
    if np.linalg.cond(direct) > 1 / ON_AXIS**1.5:
        return None
    n = len(plant.A)
    q = len(controller.A)
    # Each signal as rows over the states of plant and controller, the disturbance d and the noise n.
    x, xc, disturbance, noise = np.split(np.eye(n + q + m + p), np.cumsum([n, q, m]))
    without_direct = (
        disturbance - controller.D @ (plant.C @ x + noise) - controller.C @ xc
    )
    u = np.linalg.solve(direct, without_direct)
    y = plant.C @ x + plant.D @ u
    x_rate = plant.A @ x + plant.B @ u
    xc_rate = controller.A @ xc + controller.B @ (y + noise)
    rows = np.concatenate([x_rate, xc_rate, y, u])
    states = slice(n + q)
    signals = slice(n + q, None)
    return StateSpace(
        rows[states, states],
        rows[states, signals],
        rows[signals, states],
        rows[signals, signals],
    )


def _level_zeros(first: StateSpace, second: StateSpace, level: float) -> Matrix:
    """Where a singular value of the gap equals `level`: on the axis, and elsewhere in the plane."""
    back1 = first.adjoint
    back2 = second.adjoint
    p, m = first.D.shape
    n1 = len(first.A)
    n2 = len(second.A)
    x1, z1, x2, z2, v, w = np.split(
        np.eye(2 * (n1 + n2) + p + m), np.cumsum([n1, n1, n2, n2, p])
    )
    through1 = first.C @ x1 + first.D @ w
    into1 = through1 + v / level
    out2 = back2.C @ z2 + back2.D @ v
    into2 = out2 - w / level
    rates = [
        first.A @ x1 + first.B @ w,
        back1.A @ z1 + back1.B @ into1,
        second.A @ x2 + second.B @ into2,
        back2.A @ z2 + back2.B @ v,
    ]
    equations = [
        v + second.C @ x2 + second.D @ into2 + through1 / level,
        w + back1.C @ z1 + back1.D @ into1 - out2 / level,
    ]
    return _zeros(np.concatenate(rates + equations), 2 * (n1 + n2))


def _norm_zeros(system: StateSpace, level: float) -> Matrix:
    """Where a singular value of a response equals `level`."""
    n, m = system.B.shape
    back = system.adjoint
    x, z, w = np.split(np.eye(2 * n + m), [n, 2 * n])
    y = (system.C @ x + system.D @ w) / level
    rows = [
        system.A @ x + system.B @ w,
        back.A @ z + back.B @ y,
        back.C @ z + back.D @ y - level * w,
    ]
    return _zeros(np.concatenate(rows), 2 * n)


def _zeros(rows: Matrix, n: int) -> Matrix:
    """Zeros of a system given by its n derivatives and its equations, as rows over states and unknowns."""
    inner = np.linalg.solve(rows[n:, n:], rows[n:, :n])
    return np.asarray(np.linalg.eigvals(rows[:n, :n] - rows[:n, n:] @ inner))


def _largest(
    values: Callable[[FloatArray], FloatArray],
    zeros: Callable[[float], Matrix],
    poles: Matrix,
    ceiling: float,
) -> float:
    """Largest value over all frequencies, or one from `ceiling` on."""
    tried = frequencies_of(poles)
    best = 0.0
    place = 0.0
    for _ in range(MAX_LEVELS):
        found_values = values(tried)
        if found_values.max() <= best * (1 + ABOVE):
            break
        best, place = _polish(
            values, float(found_values.max()), float(tried[found_values.argmax()])
        )
        if best >= ceiling:
            break
        crossings = zeros(best * (1 + ABOVE))
        crossings = np.sort(
            crossings.imag[np.abs(crossings.real) <= NEAR_AXIS * np.abs(crossings)]
        )
        tried = np.concatenate(
            [[place], crossings, 0.5 * (crossings[1:] + crossings[:-1])]
        )
    return best


def frequencies_of(poles: Matrix) -> FloatArray:
    """Both ends of the axis, and from a decade below the slowest pole to a decade above the fastest."""
    sizes = np.abs(poles)
    # several at 0 are rounded apart
    sizes = sizes[sizes > ON_AXIS * max(sizes.max(initial=0.0), 1.0)]
    if not sizes.size:
        sizes = np.ones(1)
    low = np.log10(sizes.min()) - 1
    high = np.log10(sizes.max()) + 1
    some = np.logspace(low, high, int(PER_DECADE * (high - low)))
    some = np.concatenate([some, np.abs(poles.imag), sizes, [0.0, np.inf]])
    return some if not np.iscomplexobj(poles) else np.concatenate([some, -some])


def _polish(
    values: Callable[[FloatArray], FloatArray], best: float, place: float
) -> tuple[float, float]:
    """The top of the peak next to a place, and where it is: parabolas through three points, ever closer."""
    middle = place
    width = _POLISHING.first * abs(place)
    for _ in range(_POLISHING.most):
        if not np.isfinite(middle) or width <= _POLISHING.last * abs(middle):
            break
        tried = middle + width * NEIGHBOURS
        found_values = values(tried)
        if found_values.max() > best:
            best = float(found_values.max())
            place = float(tried[found_values.argmax()])
        before, centre, after = found_values
        bend = before - 2 * centre + after
        step = (
            0.5 * (before - after) / bend if bend < 0 else 2 * np.sign(after - before)
        )
        middle += float(np.clip(step, -2.0, 2.0)) * width
        width *= _POLISHING.closer if abs(step) < 1 else 1.0
    return best, place


def beside(frequencies: FloatArray, poles: Matrix) -> FloatArray:
    """The frequencies, moved away from poles on the axis."""
    sizes = np.abs(poles)
    limit = ON_AXIS * max(sizes.max(initial=0.0), 1.0)
    off_axis = sizes[sizes > limit]
    distance = BESIDE * float(off_axis.min(initial=1.0) if off_axis.size else 1.0)
    moved = frequencies.copy()
    for pole in poles[np.abs(poles.real) <= limit].imag:
        near = np.abs(moved - pole) < distance
        moved[near] = pole + distance
    return moved
