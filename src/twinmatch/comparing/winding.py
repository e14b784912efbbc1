"""Kernel: how often the inner product of two graph symbols winds around zero.

With stable spectral factors w of |g|², c = g2* g1/(w2* w1) is the inner product of the normalised symbols:
|c|² = 1 − κ². Its phase is tracked along the axis from 0 to ∞; steps are halved until the curve between two
points is so close to its chord that it cannot pass on the other side of zero.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twinmatch.comparing.chordal import value
from twinmatch.compiled import compiled
from twinmatch.signals import FloatArray

__all__ = ["inner_product", "turns"]

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
    size1, size2 = 0.0, 0.0
    x, above = math.exp(-abs(t)), t > 0
    for k in range(signed1.shape[0]):
        real1, imaginary1 = value(signed1[k], x, above)
        real2, imaginary2 = value(signed2[k], x, above)
        inner += complex(real1 * real2 + imaginary1 * imaginary2, real2 * imaginary1 - real1 * imaginary2)
        size1 += real1 * real1 + imaginary1 * imaginary1
        size2 += real2 * real2 + imaginary2 * imaginary2
    smooth = _direction(roots1, t).conjugate() * _direction(roots2, t)
    return inner * smooth * (1 / abs(smooth)) * (1 / math.sqrt(size1)) * (1 / math.sqrt(size2))


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
    at = np.empty(DEPTH + 1)
    held = np.empty(DEPTH + 1, dtype=np.complex128)
    left, c_left = grid[0], inner_product(signed1, signed2, roots1, roots2, grid[0])
    for node in grid[1:]:
        at[0], held[0] = node, inner_product(signed1, signed2, roots1, roots2, node)
        waiting = 1
        while waiting:
            right, c_right = at[waiting - 1], held[waiting - 1]
            if min(abs(c_left), abs(c_right)) < ZERO:
                return math.nan
            middle = 0.5 * (left + right)
            c = inner_product(signed1, signed2, roots1, roots2, middle)
            bend = CURVATURE * abs(c - 0.5 * (c_left + c_right))
            if min(_clearance(c_left, c), _clearance(c, c_right)) > bend or waiting > DEPTH:
                for end in (c, c_right):
                    ratio = end * c_left.conjugate()
                    total += math.atan2(ratio.imag, ratio.real)
                    c_left = end
                left = right
                waiting -= 1
            else:
                at[waiting], held[waiting] = middle, c
                waiting += 1
    return total / math.pi
