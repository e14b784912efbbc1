"""Kernels: the chordal distance of two graph symbols at one frequency, and the largest over all frequencies.

Dekker's and Knuth's exact sum and product; they rely on IEEE rounding, so never compile with `fastmath`.

A frequency is t = ln Ω on the imaginary axis of the half plane, from −∞ to ∞. A row of coefficients
c[0..n] stands for p(jΩ) = Σ c[k] (jΩ)^k; above Ω = 1 it is evaluated as p(jΩ)/Ω^n, which leaves every
ratio below unchanged and never overflows. Powers of j are folded into the coefficients (`with_powers_of_j`),
so that even rows are real and odd ones imaginary.

With the minors M[j,k] = g1[j] g2[k] − g1[k] g2[j], Lagrange's identity reads
|g1|² |g2|² − |g2* g1|² = Σ |M[j,k]|², so κ² = Σ |M|² / (|g1|² |g2|²) needs no subtraction of nearly equal
numbers, however close the models are.

κ² as a function of t = ln Ω is analytic except at poles off the real axis, which are known: the spectral
roots of the two models. The grid is as fine as the nearest of them requires, however narrow the peak. Between
nodes Hermite cubics, checked at every midpoint, bound κ²; intervals that may still exceed the best value
found are halved until none is left. This finds the global maximum.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.signals import FloatArray


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


@compiled
def with_powers_of_j(rows: FloatArray) -> FloatArray:
    """Coefficients times the sign of j^k: + + − −."""
    signed = rows.copy()
    for k in range(rows.shape[1]):
        if k & 2:
            for i in range(rows.shape[0]):
                signed[i, k] = -signed[i, k]
    return signed


@compiled
def with_derivatives(signed: FloatArray) -> FloatArray:
    """Stack of value, dp/dt as used up to Ω = 1, and d(p/Ω^n)/dt as used above, shape (3, rows, n + 1)."""
    rows, width = signed.shape
    stack = np.empty((3, rows, width))
    for k in range(width):
        for i in range(rows):
            stack[0, i, k] = signed[i, k]
            stack[1, i, k] = signed[i, k] * k
            stack[2, i, k] = signed[i, k] * (k - width + 1)
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
                    p, e = multiply(high1[j, a], low1[j, a], high2[k, b], low2[k, b])
                    q, f = multiply(high1[k, a], low1[k, a], high2[j, b], low2[j, b])
                    p, e = add(p, e, -q, -f)
                    high[row, a + b], low[row, a + b] = add(
                        high[row, a + b], low[row, a + b], p, e
                    )
            row += 1
    return high, low


@compiled
def value(row: FloatArray, x: float, above: bool) -> tuple[float, float]:
    """Real and imaginary part of one row at Ω = x, or, above 1, at Ω = 1/x."""
    even = 0.0
    odd = 0.0
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
def _square_and_slope(
    stack: FloatArray, x: float, weight: float, above: bool
) -> tuple[float, float]:
    """Σ |weight·p|² over the rows and its derivative by t."""
    derivative = 2 if above else 1
    square = 0.0
    slope = 0.0
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
    x = math.exp(-abs(t))
    above = t > 0
    size1, slope1 = _square_and_slope(stack1, x, 1.0, above)
    size2, slope2 = _square_and_slope(stack2, x, 1.0, above)
    # one root after the other: the product of two small squares may underflow
    weight = 1 / math.sqrt(size1) / math.sqrt(size2)
    square, slope = _square_and_slope(stack_minors, x, weight, above)
    return square, slope - square * (slope1 / size1 + slope2 / size2)


@compiled
def _horner(high: FloatArray, low: FloatArray, x: float) -> float:
    """Value of a polynomial in x², highest power first."""
    y, y_low = scale(x, 0.0, x)
    a = 0.0
    a_low = 0.0
    for k in range(high.size):
        a, a_low = multiply(a, a_low, y, y_low)
        a, a_low = add(a, a_low, high[k], low[k])
    return a


@compiled
def _exact_square(high: FloatArray, low: FloatArray, t: float, weight: float) -> float:
    """Σ |weight·p|² with every p evaluated in double-double."""
    x = math.exp(-abs(t))
    # above Ω = 1 the powers of 1/Ω run the other way
    order = 1 if t > 0 else -1
    high = high[:, ::order]
    low = low[:, ::order]
    square = 0.0
    for row in range(high.shape[0]):
        # the last coefficient belongs to x⁰, the last but one to x¹
        constant_side = _horner(
            high[row, ::-1][::2][::-1], low[row, ::-1][::2][::-1], x
        )
        other_side = (
            _horner(high[row, ::-1][1::2][::-1], low[row, ::-1][1::2][::-1], x) * x
        )
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
    return min(
        1.0,
        math.sqrt(_exact_square(pair_minors[0], pair_minors[1], t, 1 / size1 / size2)),
    )


STEP = 0.25
"""Length of a first interval over its distance to the nearest pole."""

MARGIN = 7.0
"""How far the grid reaches beyond the outermost pole: there κ² equals its end value to within e^−14."""

TOLERANCE = 1e-12
"""Relative excess over the best κ² that an interval must be able to reach to be searched."""

STACK = 128
MIN_LENGTH = 1e-10
MAX_HALVINGS = 20_000


@compiled
def frequency_grid(
    roots1: NDArray[np.complex128], roots2: NDArray[np.complex128]
) -> FloatArray:
    """Nodes t, increasing, over the range of all poles; at least its two ends."""
    count = roots1.size + roots2.size
    if count == 0:
        return np.array([-1.0, 1.0])
    height = np.empty(count)
    angle = np.empty(count)
    low = math.inf
    high = -math.inf
    for i in range(count):
        root = roots1[i] if i < roots1.size else roots2[i - roots1.size]
        height[i] = math.log(abs(root))
        # angle from the axis of frequencies
        angle[i] = max(1e-14, math.atan2(root.real, abs(root.imag)))
        low = min(low, height[i])
        high = max(high, height[i])
    nodes = [low - MARGIN]
    while nodes[-1] < high + MARGIN:
        nodes.append(nodes[-1] + STEP * _clearance(height, angle, nodes[-1]))
    return np.array(nodes)


@compiled
def _clearance(height: FloatArray, angle: FloatArray, t: float) -> float:
    """Distance from t to the nearest pole."""
    nearest = math.inf
    for i in range(height.size):
        nearest = min(nearest, (t - height[i]) ** 2 + angle[i] ** 2)
    return math.sqrt(nearest)


@compiled
def cubic_top(f: float, f_end: float, slope: float, slope_end: float) -> float:
    """Largest value of a Hermite cubic on [0, 1]."""
    top = max(f, f_end)
    square = 3 * (f_end - f) - 2 * slope - slope_end
    cube = 2 * (f - f_end) + slope + slope_end
    discriminant = square * square - 3 * cube * slope
    if discriminant < 0:
        return top
    root = math.sqrt(discriminant)
    # Of two forms of the place with the largest value, the one in which no digits cancel.
    if square <= 0:
        x = slope / (root - square) if root > square else 0.0
    else:
        x = -(root + square) / (3 * cube) if cube != 0 else 0.0
    if 0 < x < 1:
        top = max(top, f + x * (slope + x * (square + x * cube)))
    return top


@compiled(inside=True)
def _put(  # noqa: PLR0917
    row: FloatArray, a: float, b: float, fa: float, fb: float, da: float, db: float
) -> None:
    row[0] = a
    row[1] = b
    row[2] = fa
    row[3] = fb
    row[4] = da
    row[5] = db


@compiled
def highest(
    stack1: FloatArray, stack2: FloatArray, stack_minors: FloatArray, grid: FloatArray
) -> tuple[float, float]:
    """The largest κ² and its place t, which may be −∞ or ∞."""
    best = squared_distance(stack1, stack2, stack_minors, -math.inf)[0]
    place = -math.inf
    end = squared_distance(stack1, stack2, stack_minors, math.inf)[0]
    if end > best:
        best = end
        place = math.inf
    f = np.empty(grid.size)
    slope = np.empty(grid.size)
    for i in range(grid.size):
        f[i], slope[i] = squared_distance(stack1, stack2, stack_minors, grid[i])
        if f[i] > best:
            best = f[i]
            place = grid[i]
    todo = np.empty((STACK, 6))
    halvings = 0
    for i in range(grid.size - 1):
        _put(todo[0], grid[i], grid[i + 1], f[i], f[i + 1], slope[i], slope[i + 1])
        waiting = 1
        while waiting:
            waiting -= 1
            a, b, fa, fb, da, db = todo[waiting]
            h = b - a
            m = 0.5 * (a + b)
            fm, dm = squared_distance(stack1, stack2, stack_minors, m)
            halvings += 1
            if fm > best:
                best = fm
                place = m
            error = abs(fm - (0.5 * (fa + fb) + 0.125 * h * (da - db)))
            error += 0.25 * h * abs(dm - (1.5 * (fb - fa) / h - 0.25 * (da + db)))
            # halving reduces the error of the cubics 16 times; an eighth leaves a margin
            bar = best * (1 + TOLERANCE) - 0.125 * error
            if h < MIN_LENGTH or halvings > MAX_HALVINGS or waiting > STACK - 3:
                continue
            h *= 0.5
            if cubic_top(fm, fb, h * dm, h * db) > bar:
                _put(todo[waiting], m, b, fm, fb, dm, db)
                waiting += 1
            if cubic_top(fa, fm, h * da, h * dm) > bar:
                _put(todo[waiting], a, m, fa, fm, da, dm)
                waiting += 1
    return best, place
