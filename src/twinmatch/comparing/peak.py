"""Kernel: the largest chordal distance over all frequencies.

κ² as a function of t = ln Ω is analytic except at poles off the real axis, which are known: the spectral
roots of the two models. The grid is as fine as the nearest of them requires, however narrow the peak. Between
nodes Hermite cubics, checked at every midpoint, bound κ²; intervals that may still exceed the best value
found are halved until none is left. This finds the global maximum.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twinmatch.comparing.chordal import squared_distance
from twinmatch.compiled import compiled
from twinmatch.signals import FloatArray

__all__ = ["frequency_grid", "highest"]

STEP = 0.25
"""Length of a first interval over its distance to the nearest pole."""

MARGIN = 7.0
"""How far the grid reaches beyond the outermost pole: there κ² equals its end value to within e^−14."""

TOLERANCE = 1e-12
"""Relative excess over the best κ² that an interval must be able to reach to be searched."""

STACK = 128
SHORTEST = 1e-10
MOST_HALVINGS = 20_000


@compiled
def frequency_grid(roots1: NDArray[np.complex128], roots2: NDArray[np.complex128]) -> FloatArray:
    """Nodes t, increasing, over the range of all poles; at least its two ends."""
    count = roots1.size + roots2.size
    if count == 0:
        return np.array([-1.0, 1.0])
    where = np.empty(count)
    off = np.empty(count)
    for i in range(count):
        root = roots1[i] if i < roots1.size else roots2[i - roots1.size]
        where[i] = math.log(abs(root))
        off[i] = max(1e-14, math.atan2(root.real, abs(root.imag)))  # angle from the axis of frequencies
    nodes = [where.min() - MARGIN]
    end = where.max() + MARGIN
    while nodes[-1] < end:
        nodes.append(nodes[-1] + STEP * _clearance(where, off, nodes[-1]))
    return np.array(nodes)


@compiled
def _clearance(where: FloatArray, off: FloatArray, t: float) -> float:
    """Distance from t to the nearest pole."""
    nearest = math.inf
    for i in range(where.size):
        nearest = min(nearest, (t - where[i]) ** 2 + off[i] ** 2)
    return math.sqrt(nearest)


@compiled
def _cubic_top(f: float, f_end: float, slope: float, slope_end: float) -> float:
    """Largest value of a Hermite cubic on [0, 1]."""
    top = max(f, f_end)
    square = 3 * (f_end - f) - 2 * slope - slope_end
    cube = 2 * (f - f_end) + slope + slope_end
    discriminant = square * square - 3 * cube * slope
    if discriminant < 0:
        return top
    below = math.sqrt(discriminant) - square
    if below == 0:
        return top
    x = slope / below
    if 0 < x < 1:
        top = max(top, f + x * (slope + x * (square + x * cube)))
    return top


@compiled
def highest(
    stack1: FloatArray, stack2: FloatArray, stack_minors: FloatArray, grid: FloatArray
) -> tuple[float, float]:
    """The largest κ² and its place t, which may be −∞ or ∞."""
    best, place = squared_distance(stack1, stack2, stack_minors, -math.inf)[0], -math.inf
    end = squared_distance(stack1, stack2, stack_minors, math.inf)[0]
    if end > best:
        best, place = end, math.inf
    f = np.empty(grid.size)
    slope = np.empty(grid.size)
    for i in range(grid.size):
        f[i], slope[i] = squared_distance(stack1, stack2, stack_minors, grid[i])
        if f[i] > best:
            best, place = f[i], grid[i]
    todo = np.empty((STACK, 6))
    halvings = 0
    for i in range(grid.size - 1):
        todo[0] = (grid[i], grid[i + 1], f[i], f[i + 1], slope[i], slope[i + 1])
        waiting = 1
        while waiting:
            waiting -= 1
            a, b, fa, fb, da, db = todo[waiting]
            h = b - a
            m = 0.5 * (a + b)
            fm, dm = squared_distance(stack1, stack2, stack_minors, m)
            halvings += 1
            if fm > best:
                best, place = fm, m
            off = abs(fm - (0.5 * (fa + fb) + 0.125 * h * (da - db)))
            off += 0.25 * h * abs(dm - (1.5 * (fb - fa) / h - 0.25 * (da + db)))
            # halving reduces the error of the cubics 16 times; an eighth leaves a margin
            bar = best * (1 + TOLERANCE) - 0.125 * off
            if h < SHORTEST or halvings > MOST_HALVINGS or waiting > STACK - 3:
                continue
            h *= 0.5
            if _cubic_top(fm, fb, h * dm, h * db) > bar:
                todo[waiting] = (m, b, fm, fb, dm, db)
                waiting += 1
            if _cubic_top(fa, fm, h * da, h * dm) > bar:
                todo[waiting] = (a, m, fa, fm, da, dm)
                waiting += 1
    return best, place
