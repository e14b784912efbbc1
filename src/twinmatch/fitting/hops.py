"""Hops: starts around the best minimum found so far, with a few of its roots moved at random.

Orders above the second have many local minima: pairs of roots that nearly cancel, with one minimum for every
chance sinusoid that they can follow. Independent random starts rarely fall near a good one; starts that keep
most of the best model and move one or two of its roots often do. The random generator has a fixed seed, so
that the same data give the same model.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twinmatch.fitting.order import Order
from twinmatch.signals import FloatArray

__all__ = ["Hops"]

Roots = NDArray[np.complex128]

SEED = 20220227
REAL = 1e-9
"""Imaginary part below which a root counts as real."""


class Hops:
    """An unlimited sequence of starts around a model."""

    def __init__(self, order: Order) -> None:
        """Begin the sequence for an order; it is always the same."""
        self._degrees = (order.nc, order.nd, order.nf)
        self._movable = [k for k, degree in enumerate(self._degrees) if degree > 0]
        self._draws = np.random.Generator(np.random.PCG64(SEED))

    @property
    def possible(self) -> bool:
        """Whether there is a root to move."""
        return bool(self._movable)

    def from_model(self, theta: FloatArray) -> FloatArray:
        """θ = (c, d, f) with some of its roots moved at random, all inside the unit circle."""
        corners = np.concatenate(([0], np.cumsum(self._degrees)))
        moved = theta.copy()
        which = self._movable[self._pick(len(self._movable))]
        kind = self._pick(4)
        if kind == 3 and min(self._degrees[:2]) > 1:
            # A pair of C that nearly cancels a pair of D: a narrow band in which the noise is coloured.
            angle, magnitude = self._angle(), self._magnitude(-2.5, -1.0)
            wider = max(1.0 - (1.0 - magnitude) * (1.5 + 2.5 * self._draws.random()), 0.5)
            for k, size in ((0, wider), (1, magnitude)):
                part = slice(corners[k], corners[k + 1])
                moved[part] = _coefficients(self._with_pair(_all_roots(theta[part]), size, angle))
        else:
            move = (self._move_one, self._move_two, self._move_all)[kind % 3]
            part = slice(corners[which], corners[which + 1])
            moved[part] = _coefficients(move(_all_roots(theta[part])))
        return moved

    def _pick(self, count: int) -> int:
        return int(self._draws.random() * count)

    def _magnitude(self, nearest: float, farthest: float) -> float:
        """1 − 10^x, x uniform."""
        return float(1.0 - 10.0 ** (nearest + (farthest - nearest) * self._draws.random()))

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
        pairs, real = roots[roots.imag > REAL], roots[np.abs(roots.imag) <= REAL]
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
                drawn.append(self._magnitude(-2.5, -0.1) * (1.0 if self._pick(5) else -1.0))
        return np.array(drawn, dtype=np.complex128)


def _all_roots(part: FloatArray) -> Roots:
    """All roots, as many as there are coefficients, including those at zero."""
    found = np.roots(np.append(1.0, part)).astype(np.complex128)
    return np.append(found, np.zeros(part.size - found.size, dtype=np.complex128))


def _coefficients(roots: Roots) -> FloatArray:
    """Coefficients of the monic polynomial, without the leading one."""
    product = np.zeros(roots.size + 1, dtype=np.complex128)
    product[0] = 1.0
    for k, root in enumerate(roots):
        product[1 : k + 2] -= root * product[: k + 1]
    return np.asarray(product.real[1:])
