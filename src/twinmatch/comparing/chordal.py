"""Kernels: the chordal distance of two graph symbols at one frequency.

A frequency is t = ln Ω on the imaginary axis of the half plane, from −∞ to ∞. A row of coefficients
c[0..n] stands for p(jΩ) = Σ c[k] (jΩ)^k; above Ω = 1 it is evaluated as p(jΩ)/Ω^n, which leaves every
ratio below unchanged and never overflows. Powers of j are folded into the coefficients (`with_powers_of_j`),
so that even rows are real and odd ones imaginary.

With the minors M[j,k] = g1[j] g2[k] − g1[k] g2[j], Lagrange's identity reads
|g1|² |g2|² − |g2* g1|² = Σ |M[j,k]|², so κ² = Σ |M|² / (|g1|² |g2|²) needs no subtraction of nearly equal
numbers, however close the models are.
"""

from __future__ import annotations

import math

import numpy as np

from twinmatch.comparing import double_double as dd
from twinmatch.compiled import compiled
from twinmatch.signals import FloatArray

__all__ = ["exact_distance", "minors", "squared_distance", "value", "with_derivatives", "with_powers_of_j"]


@compiled
def with_powers_of_j(rows: FloatArray) -> FloatArray:
    """Coefficients times the sign of j^k: + + − −."""
    signed = rows.copy()
    for k in range(rows.shape[1]):
        if k & 2:
            signed[:, k] = -signed[:, k]
    return signed


@compiled
def with_derivatives(signed: FloatArray) -> FloatArray:
    """Stack of value, dp/dt as used up to Ω = 1, and d(p/Ω^n)/dt as used above, shape (3, rows, n + 1)."""
    rows, width = signed.shape
    stack = np.empty((3, rows, width))
    for k in range(width):
        stack[0, :, k] = signed[:, k]
        stack[1, :, k] = signed[:, k] * k
        stack[2, :, k] = signed[:, k] * (k - width + 1)
    return stack


@compiled
def minors(
    high1: FloatArray, low1: FloatArray, high2: FloatArray, low2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Coefficients of all 2×2 minors of [g1 g2] in double-double, shape (m(m+1)/2, n1 + n2 + 1) each."""
    rows, width1 = high1.shape
    width2 = high2.shape[1]
    high = np.zeros((rows * (rows - 1) // 2, width1 + width2 - 1))
    low = np.zeros_like(high)
    row = 0
    for j in range(rows):
        for k in range(j + 1, rows):
            for a in range(width1):
                for b in range(width2):
                    p, e = dd.multiply(high1[j, a], low1[j, a], high2[k, b], low2[k, b])
                    q, f = dd.multiply(high1[k, a], low1[k, a], high2[j, b], low2[j, b])
                    p, e = dd.add(p, e, -q, -f)
                    high[row, a + b], low[row, a + b] = dd.add(high[row, a + b], low[row, a + b], p, e)
            row += 1
    return high, low


@compiled
def value(row: FloatArray, x: float, above: bool) -> tuple[float, float]:
    """Real and imaginary part of one row at Ω = x, or, above 1, at Ω = 1/x."""
    even, odd = 0.0, 0.0
    degree = row.size - 1
    y = x * x
    if not above:
        for k in range(degree - degree % 2, -1, -2):
            even = even * y + row[k]
        for k in range(degree - 1 + degree % 2, 0, -2):
            odd = odd * y + row[k]
        return even, odd * x
    for k in range(0, degree + 1, 2):
        even = even * y + row[k]
    for k in range(1, degree + 1, 2):
        odd = odd * y + row[k]
    return (even * x, odd) if degree % 2 else (even, odd * x)


@compiled
def _square_and_slope(stack: FloatArray, x: float, weight: float, above: bool) -> tuple[float, float]:
    """Σ |weight·p|² over the rows and its derivative by t."""
    derivative = 2 if above else 1
    square, slope = 0.0, 0.0
    for k in range(stack.shape[1]):
        real, imaginary = value(stack[0, k], x, above)
        d_real, d_imaginary = value(stack[derivative, k], x, above)
        real *= weight
        imaginary *= weight
        square += real * real + imaginary * imaginary
        slope += 2 * weight * (real * d_real + imaginary * d_imaginary)
    return square, slope


@compiled
def squared_distance(
    stack1: FloatArray, stack2: FloatArray, stack_minors: FloatArray, t: float
) -> tuple[float, float]:
    """κ² and dκ²/dt at t, in plain floats, for the search."""
    x, above = math.exp(-abs(t)), t > 0
    size1, slope1 = _square_and_slope(stack1, x, 1.0, above)
    size2, slope2 = _square_and_slope(stack2, x, 1.0, above)
    # one root after the other: the product of two small squares may underflow
    weight = 1 / math.sqrt(size1) / math.sqrt(size2)
    square, slope = _square_and_slope(stack_minors, x, weight, above)
    return square, slope - square * (slope1 / size1 + slope2 / size2)


@compiled
def _horner(high: FloatArray, low: FloatArray, x: float) -> float:
    """Value of a polynomial in x², highest power first."""
    y, y_low = dd.scale(x, 0.0, x)
    a, a_low = 0.0, 0.0
    for k in range(high.size):
        a, a_low = dd.multiply(a, a_low, y, y_low)
        a, a_low = dd.add(a, a_low, high[k], low[k])
    return a


@compiled
def _exact_square(high: FloatArray, low: FloatArray, t: float, weight: float) -> float:
    """Σ |weight·p|² with every p evaluated in double-double."""
    x = math.exp(-abs(t))
    # above Ω = 1 the powers of 1/Ω run the other way
    order = 1 if t > 0 else -1
    high, low = high[:, ::order], low[:, ::order]
    square = 0.0
    for row in range(high.shape[0]):
        # the last coefficient belongs to x⁰, the last but one to x¹
        constant_side = _horner(high[row, ::-1][::2][::-1], low[row, ::-1][::2][::-1], x)
        other_side = _horner(high[row, ::-1][1::2][::-1], low[row, ::-1][1::2][::-1], x) * x
        square += (constant_side * weight) ** 2 + (other_side * weight) ** 2
    return square


@compiled
def exact_distance(
    pair1: tuple[FloatArray, FloatArray],
    pair2: tuple[FloatArray, FloatArray],
    pair_minors: tuple[FloatArray, FloatArray],
    t: float,
) -> float:
    """κ at t, to the last few bits, from double-double coefficients with powers of j folded in."""
    size1 = math.sqrt(_exact_square(pair1[0], pair1[1], t, 1.0))
    size2 = math.sqrt(_exact_square(pair2[0], pair2[1], t, 1.0))
    return min(1.0, math.sqrt(_exact_square(pair_minors[0], pair_minors[1], t, 1 / size1 / size2)))
