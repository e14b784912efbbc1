"""Arithmetic on unevaluated sums of two floats: about 32 digits, for polynomials that nearly cancel.

Dekker's and Knuth's exact sum and product; they rely on IEEE rounding, so never compile with `fastmath`.
"""

from __future__ import annotations

from twinmatch.compiled import compiled

__all__ = ["add", "multiply", "scale"]


@compiled
def _two_sum(a: float, b: float) -> tuple[float, float]:
    s = a + b
    v = s - a
    return s, (a - (s - v)) + (b - v)


@compiled
def _two_product(a: float, b: float) -> tuple[float, float]:
    p = a * b
    t = 134217729.0 * a
    a_high = t - (t - a)
    a_low = a - a_high
    t = 134217729.0 * b
    b_high = t - (t - b)
    b_low = b - b_high
    return p, ((a_high * b_high - p) + a_high * b_low + a_low * b_high) + a_low * b_low


@compiled
def add(a: float, a_low: float, b: float, b_low: float) -> tuple[float, float]:
    """Sum; both parts of both operands are summed exactly before the last rounding."""
    s, e = _two_sum(a, b)
    t, f = _two_sum(a_low, b_low)
    s, e = _two_sum(s, e + t)
    return _two_sum(s, e + f)


@compiled
def multiply(a: float, a_low: float, b: float, b_low: float) -> tuple[float, float]:
    """Product."""
    p, e = _two_product(a, b)
    return _two_sum(p, e + (a * b_low + a_low * b))


@compiled
def scale(a: float, a_low: float, b: float) -> tuple[float, float]:
    """Product with one float."""
    p, e = _two_product(a, b)
    return _two_sum(p, e + a_low * b)
