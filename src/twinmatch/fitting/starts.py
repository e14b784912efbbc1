"""Starts of the search for a Box–Jenkins model: from three methods that fail for different reasons, and hops.

1. A long ARX model whitens the data; Steiglitz–McBride on the whitened data gives B/F (the
   Box–Jenkins Steiglitz–McBride method of Y. Zhu, efficient even in closed loop).
2. Steiglitz–McBride on the raw data: the output-error model, which ignores the noise.
3. An ARX model of the same order: one denominator for both parts.

The noise part C/D of methods 1 and 2 is the ARMA model of the residuals of B/F, by Hannan–Rissanen.

*Hops* are starts around the best minimum found so far, with a few of its roots moved at random. Orders above
the second have many local minima: pairs of roots that nearly cancel, with one minimum for every chance
sinusoid that they can follow. Independent random starts rarely fall near a good one; starts that keep most of
the best model and move one or two of its roots often do. The random generator has a fixed seed, so that the
same data give the same model.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.dynamics.kernels import copy_into
from twinmatch.fitting.data import Order
from twinmatch.fitting.delayed import SLACK, Spans, cholesky, correlate, solve_triangle
from twinmatch.fitting.polynomials import (
    LARGEST_ROOT,
    all_pole_into,
    fir,
    fir_into,
    stabilise,
)
from twinmatch.fitting.prediction import Polynomials, errors_of
from twinmatch.signals import FloatArray

LONG = 20
"""Order of the long autoregressions, if the window is long enough."""
ROUNDS = 8
"""Iterations of Steiglitz–McBride; it converges in a few or not at all."""
SETTLED = 1e-4
"""Change of the coefficients of F below which it has converged."""
ROUTES = 3
Roots = NDArray[np.complex128]

SEED = 20220227
REAL = 1e-9
"""Imaginary part below which a root counts as real."""


@compiled
def start_values(u: FloatArray, y: FloatArray, orders: NDArray[np.int64]) -> FloatArray:
    """Candidates for θ = (c, d, f) of every order, each stable, in a fixed order.

    Args:
        u: input, shape (N,).
        y: output, shape (N,).
        orders: nb, nc, nd, nf, nk of every order, as rows. What whitens the data depends on the delay only, and
            is computed where it differs from that of the order before.

    Returns:
        Shape (orders, 3, largest nc + nd + nf); zero behind the coefficients of an order.
    """
    width = 0
    for k in range(orders.shape[0]):
        width = max(width, orders[k, 1] + orders[k, 2] + orders[k, 3])
    thetas = np.zeros((orders.shape[0], ROUTES, width))
    delay = -1
    whitener = np.ones(1)
    for k in range(orders.shape[0]):
        counts = orders[k]
        if counts[4] != delay:
            delay = counts[4]
            whitener = long_arx(u, y, delay)
        fill_starts(u, y, whitener, counts, thetas[k])
    return thetas


@compiled(inlined=True)
def fill_starts(
    u: FloatArray,
    y: FloatArray,
    whitener: FloatArray,
    counts: NDArray[np.int64],
    thetas: FloatArray,
) -> None:
    """Write the candidates of one order into rows of zeros."""
    _, nc, nd, nf, _ = counts
    skip = whitener.size - 1
    for route in range(2):
        if route == 0:
            F = steiglitz_mcbride(
                fir(whitener, u)[skip:], fir(whitener, y)[skip:], counts
            )
        else:
            F = steiglitz_mcbride(u, y, counts)
        C, D = noise_model(u, y, F, counts)
        copy_into(C[1:], thetas[route])
        copy_into(D[1:], thetas[route, nc:])
        copy_into(F[1:], thetas[route, nc + nd :])
    A = arx_denominator(u, y, counts)
    copy_into(A[1 : 1 + min(nd, nf)], thetas[2, nc:])
    copy_into(A[1:], thetas[2, nc + nd :])


@compiled(inside=True)
def regression(signals: FloatArray, low: int, spans: Spans) -> FloatArray:
    """Least squares of the column of the last group on those of the others, from sample `low` on."""
    return -solve_triangle(cholesky(correlate(signals, low, spans)))


@compiled(inside=True)
def padded(pad: int, first: FloatArray, second: FloatArray) -> FloatArray:
    """Two signals with leading zeros, shape (2, pad + N)."""
    signals = np.zeros((2, pad + first.size))
    copy_into(first, signals[0, pad:])
    copy_into(second, signals[1, pad:])
    return signals


@compiled(inside=True)
def monic(coefficients: FloatArray) -> FloatArray:
    """1 − c₁q⁻¹ − …: the polynomial of an autoregression with these coefficients."""
    polynomial = np.ones(1 + coefficients.size)
    for i in range(coefficients.size):
        polynomial[1 + i] = -coefficients[i]
    return polynomial


@compiled(inside=True)
def long_arx(u: FloatArray, y: FloatArray, delay: int) -> FloatArray:
    """The denominator A of a long ARX model: 1/A is close to the noise filter C/D."""
    length = min(LONG, u.size // 8)
    pad = length + delay + SLACK
    spans = np.array(((0, 1, length), (1, delay, length), (0, 0, 1)))
    return monic(regression(padded(pad, y, u), pad + length + delay, spans)[:length])


@compiled(inside=True)
def arx_denominator(
    u: FloatArray, y: FloatArray, counts: NDArray[np.int64]
) -> FloatArray:
    """The denominator of the ARX model of the order of F."""
    nb, _, _, nf, nk = counts
    if nf == 0:
        return np.ones(1)
    pad = max(nf, nk + nb) + SLACK
    spans = np.array(((0, 1, nf), (1, nk, nb), (0, 0, 1)))
    coefficients = regression(padded(pad, y, u), pad + max(nf, nk + nb - 1), spans)
    return stabilise(monic(coefficients[:nf]), LARGEST_ROOT, 1.0)


@compiled(inside=True)
def steiglitz_mcbride(
    u: FloatArray, y: FloatArray, counts: NDArray[np.int64]
) -> FloatArray:
    """F of the output-error model by iterated prefiltering, with estimated initial conditions."""
    nb, _, _, nf, nk = counts
    F = np.ones(1 + nf)
    F[1:] = 0.0
    if nf == 0:
        return F
    states = max(nf, nb + nk - 1)
    pad = max(nf, nk + nb, states) + SLACK
    spans = np.array(((0, 1, nf), (1, nk, nb), (2, 0, states), (0, 0, 1)))
    signals = np.zeros((3, pad + u.size))
    for _ in range(ROUNDS):
        through_pole(F, u, y, signals, pad)
        previous = F
        F = stabilise(monic(regression(signals, pad, spans)[:nf]), LARGEST_ROOT, 1.0)
        change = 0.0
        for i in range(nf):
            change = max(change, abs(F[1 + i] - previous[1 + i]))
        if change < SETTLED:
            break
    return F


@compiled(inside=True)
def through_pole(
    F: FloatArray, u: FloatArray, y: FloatArray, signals: FloatArray, pad: int
) -> None:
    """Write y, u and an impulse, each filtered by 1/F, into three signals with `pad` leading zeros."""
    impulse = signals[2, pad:]
    for t in range(impulse.size):
        impulse[t] = 0.0
    impulse[0] = 1.0
    all_pole_into(F, y, signals[0, pad:])
    all_pole_into(F, u, signals[1, pad:])
    all_pole_into(F, impulse, impulse)


@compiled(inside=True)
def noise_model(
    u: FloatArray, y: FloatArray, F: FloatArray, counts: NDArray[np.int64]
) -> tuple[FloatArray, FloatArray]:
    """C and D for the residuals of the best B/F with this F."""
    nb, nc, nd, nf, nk = counts
    states = max(nf, nb + nk - 1)
    pad = max(nk + nb, states) + SLACK
    signals = np.zeros((3, pad + u.size))
    through_pole(F, u, y, signals, pad)
    copy_into(y, signals[0, pad:])
    spans = np.array(((1, nk, nb), (2, 0, states), (0, 0, 1)))
    coefficients = regression(signals, pad, spans)
    B = np.zeros(nk + nb)
    unity = np.ones(1)
    copy_into(coefficients[:nb], B[nk:])
    errors = errors_of(u, y, Polynomials(B, unity, unity, F), -coefficients[nb:])
    return hannan_rissanen(errors, nc, nd)


@compiled(inside=True)
def hannan_rissanen(v: FloatArray, nc: int, nd: int) -> tuple[FloatArray, FloatArray]:
    """C and D of an ARMA model D v = C e: innovations from a long autoregression, then one regression."""
    if nc + nd == 0:
        return np.ones(1), np.ones(1)
    length = min(LONG, v.size // 4)
    pad = max(length, nc, nd) + SLACK
    signals = padded(pad, v, v)
    A = monic(regression(signals, pad + length, np.array(((0, 1, length), (0, 0, 1)))))
    fir_into(A, v, signals[1, pad:])
    signals[1, pad : pad + length] = 0.0
    spans = np.array(((0, 1, nd), (1, 1, nc), (0, 0, 1)))
    coefficients = regression(signals, pad + length + nc, spans)
    return stabilise(monic(-coefficients[nd:]), 0.98, 1.0), stabilise(
        monic(coefficients[:nd]), 0.999, 1.0
    )


class Hops:
    """An unlimited sequence of starts around a model."""

    def __init__(self, order: Order) -> None:
        """Begin the sequence for an order; it is always the same."""
        self._degrees = (order.nc, order.nd, order.nf)
        self._movable = [k for k, degree in enumerate(self._degrees) if degree > 0]

    @cached_property
    def _draws(self) -> np.random.Generator:
        return np.random.Generator(np.random.PCG64(SEED))

    @property
    def possible(self) -> bool:
        """Whether there is a root to move."""
        return bool(self._movable)

    def from_model(self, theta: FloatArray) -> FloatArray:
        """θ = (c, d, f) with some of its roots moved at random, all inside the unit circle."""
        corners = np.concatenate(([0], np.cumsum(self._degrees)))
        moved = theta.copy()
        group = self._movable[self._pick(len(self._movable))]
        kind = self._pick(4)
        if kind == 3 and min(self._degrees[:2]) > 1:
            # A pair of C that nearly cancels a pair of D: a narrow band in which the noise is coloured.
            angle = self._angle()
            magnitude = self._magnitude(-2.5, -1.0)
            wider = max(
                1.0 - (1.0 - magnitude) * (1.5 + 2.5 * self._draws.random()), 0.5
            )
            for k, size in ((0, wider), (1, magnitude)):
                part = slice(corners[k], corners[k + 1])
                moved[part] = _coefficients(
                    self._with_pair(_all_roots(theta[part]), size, angle)
                )
        else:
            move = (self._move_one, self._move_two, self._move_all)[kind % 3]
            part = slice(corners[group], corners[group + 1])
            moved[part] = _coefficients(move(_all_roots(theta[part])))
        return moved

    def _pick(self, count: int) -> int:
        return int(self._draws.random() * count)

    def _magnitude(self, nearest: float, farthest: float) -> float:
        """1 − 10^x, x uniform."""
        return float(
            1.0 - 10.0 ** (nearest + (farthest - nearest) * self._draws.random())
        )

    def _angle(self) -> float:
        """Towards low frequencies, where a sampled loop lives."""
        return float(np.pi * self._draws.random() ** 1.5)

    def _move_one(self, roots: Roots) -> Roots:
        real = np.flatnonzero(np.abs(roots.imag) <= REAL)
        if real.size == 0:
            return self._move_two(roots)
        moved = roots.copy()
        moved[real[self._pick(real.size)]] = self._magnitude(-2.5, 0.2)
        return moved

    def _move_two(self, roots: Roots) -> Roots:
        if roots.size < 2:
            return self._move_all(roots)
        return self._with_pair(roots, self._magnitude(-2.5, -0.7), self._angle())

    def _with_pair(self, roots: Roots, magnitude: float, angle: float) -> Roots:
        """Replace two real roots, or a pair, by another pair."""
        pairs = roots[roots.imag > REAL]
        real = roots[np.abs(roots.imag) <= REAL]
        if pairs.size and (real.size < 2 or self._pick(2) == 1):
            pairs = np.delete(pairs, self._pick(pairs.size))
        else:
            for _ in range(2):
                real = np.delete(real, self._pick(real.size))
        pairs = np.append(pairs, magnitude * np.exp(1j * angle))
        return np.concatenate((real, pairs, np.conj(pairs)))

    def _move_all(self, roots: Roots) -> Roots:
        drawn: list[complex] = []
        while len(drawn) < roots.size:
            if roots.size - len(drawn) >= 2 and self._pick(2) == 1:
                root = self._magnitude(-3.0, -0.3) * np.exp(1j * self._angle())
                drawn += [root, np.conj(root)]
            else:
                drawn.append(
                    self._magnitude(-2.5, -0.1) * (1.0 if self._pick(5) else -1.0)
                )
        return np.array(drawn, dtype=np.complex128)


def _all_roots(part: FloatArray) -> Roots:
    """All roots, as many as there are coefficients, including those at zero."""
    return np.roots(np.append(1.0, part)).astype(np.complex128)


def _coefficients(roots: Roots) -> FloatArray:
    """Coefficients of the monic polynomial, without the leading one."""
    product = np.zeros(roots.size + 1, dtype=np.complex128)
    product[0] = 1.0
    for k, root in enumerate(roots):
        product[1 : k + 2] -= root * product[: k + 1]
    return np.asarray(product.real[1:])
