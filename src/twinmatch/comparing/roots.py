"""Roots of a polynomial with integer coefficients, refined where float accuracy is not enough.

A float eigenvalue solver cannot resolve two roots closer than the square root of the rounding error. Where
that may hide a resonance, the roots are computed again with 50 digits.
"""

from __future__ import annotations

from decimal import Context, Decimal, localcontext

import numpy as np
from numpy.typing import NDArray

from twinmatch.comparing.polynomials import Polynomial, split

__all__ = ["roots_of_even_part"]

NEAR = 1e-5
"""Angle to the positive real axis, radians, below which roots are refined."""

SWEEPS = 60

_Number = tuple[Decimal, Decimal]


def roots_of_even_part(polynomial: Polynomial) -> NDArray[np.complex128]:
    """Roots in Ω² of a polynomial that is positive for real Ω; those near the real axis refined."""
    high, _ = split([polynomial])
    roots: NDArray[np.complex128] = np.asarray(np.roots(high[0, ::-1]), dtype=np.complex128)
    if np.any((roots.real > 0) & (np.abs(roots.imag) < NEAR * np.abs(roots))):
        return _refined(polynomial, roots)
    return roots


def _refined(polynomial: Polynomial, starts: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Simultaneous iteration of Ehrlich and Aberth, in which the roots repel each other."""
    with localcontext(Context(prec=50)):
        powers = [Decimal(c) for c in reversed(polynomial)]
        # a conjugate pair computed as real could never leave the axis
        at = [(Decimal(r.real), Decimal(r.imag + 1e-9 * abs(r) * (k + 1))) for k, r in enumerate(starts)]
        for _ in range(SWEEPS):
            moved = Decimal(0)
            for i, x in enumerate(at):
                step = _step(powers, x, at[:i] + at[i + 1 :])
                at[i] = (x[0] - step[0], x[1] - step[1])
                moved = max(moved, _size(step) / _size(at[i]))
            if moved < Decimal("1e-40"):
                break
        return np.array([complex(float(x), float(y)) for x, y in at])


def _step(powers: list[Decimal], x: _Number, others: list[_Number]) -> _Number:
    value, slope = (Decimal(0), Decimal(0)), (Decimal(0), Decimal(0))
    for c in powers:
        slope = _sum(_times(slope, x), value)
        value = _sum(_times(value, x), (c, Decimal(0)))
    if not any(value):
        return value
    ratio = _over(slope, value)
    for other in others:
        apart = (x[0] - other[0], x[1] - other[1])
        if any(apart):
            pull = _over((Decimal(1), Decimal(0)), apart)
            ratio = (ratio[0] - pull[0], ratio[1] - pull[1])
    return _over((Decimal(1), Decimal(0)), ratio)


def _sum(a: _Number, b: _Number) -> _Number:
    return a[0] + b[0], a[1] + b[1]


def _times(a: _Number, b: _Number) -> _Number:
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


def _over(a: _Number, b: _Number) -> _Number:
    square = _size(b)
    return (a[0] * b[0] + a[1] * b[1]) / square, (a[1] * b[0] - a[0] * b[1]) / square


def _size(a: _Number) -> Decimal:
    """Square of the absolute value."""
    return a[0] * a[0] + a[1] * a[1]
