"""Bounds on the roots of C, D and F, and how they are enforced."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.signals import FloatArray

__all__ = ["LARGEST_ROOT", "boundary_normals", "is_stable", "stabilise"]

ComplexArray = NDArray[np.complex128]

LARGEST_ROOT = 1.0 - 1e-6
"""Largest root magnitude of an estimated C, D or F."""
TOUCHING = 1e-8
"""Largest distance at which a root counts as on the boundary."""


@compiled
def is_stable(polynomial: FloatArray, radius: float) -> bool:
    """Whether all roots of 1 + a₁q⁻¹ + … lie strictly inside |z| = radius (Schur–Cohn recursion)."""
    a = polynomial.copy()
    factor = 1.0
    for i in range(a.size):
        a[i] *= factor
        factor /= radius
    for degree in range(a.size - 1, 0, -1):
        k = a[degree]
        if not abs(k) < 1.0:
            return False
        scale = 1.0 / (1.0 - k * k)
        previous = a[: degree + 1].copy()
        for i in range(degree):
            a[i] = (previous[i] - k * previous[degree - i]) * scale
    return True


@compiled
def stabilise(polynomial: FloatArray, radius: float, mirror: float) -> FloatArray:
    """Pull roots beyond `radius` back to it radially; a polynomial that is not finite becomes 1.

    Roots beyond `mirror`, 1 or infinity, are first reflected to the inside: a reflected C or D keeps the
    shape of the spectrum; only the size of the innovations changes.
    """
    if is_stable(polynomial, radius):
        return polynomial
    if not is_finite(polynomial):
        stable = np.zeros(polynomial.size)
        stable[0] = 1.0
        return stable
    roots = complex_roots(polynomial)
    for k in range(roots.size):
        if abs(roots[k]) > mirror:
            roots[k] = 1.0 / np.conj(roots[k])
        magnitude = abs(roots[k])
        if magnitude >= radius:
            roots[k] *= (radius - 1e-9) / magnitude
    stable = from_roots(roots, polynomial.size)
    while not is_stable(stable, radius):  # rounding may leave multiple roots outside
        for i in range(1, stable.size):
            stable[i] *= 0.9999**i
    return stable


@compiled
def boundary_normals(polynomial: FloatArray, radius: float) -> FloatArray:
    """Gradients of |z| by the free coefficients for the simple roots z that touch the boundary, as rows."""
    degree = polynomial.size - 1
    normals = np.zeros((degree, degree))
    found = 0
    if is_stable(polynomial, radius - TOUCHING):
        return normals[:0]
    roots = complex_roots(polynomial)
    for k in range(roots.size):
        z = roots[k]
        if abs(z) < radius - TOUCHING or z.imag < 0.0:
            continue
        slope = 0.0j
        for i in range(degree):
            slope = slope * z + (degree - i) * polynomial[i]
        if slope == 0.0:  # a double root has no gradient
            continue
        power = 1.0 + 0.0j
        for i in range(degree - 1, -1, -1):
            normals[found, i] = -(np.conj(z) * power / slope).real / abs(z)
            power *= z
        if is_finite(normals[found]):
            found += 1
    return normals[:found]


@compiled(inside=True)
def from_roots(roots: ComplexArray, size: int) -> FloatArray:
    """The monic polynomial of `size` coefficients with these roots, all others at zero."""
    product = np.zeros(size, np.complex128)
    product[0] = 1.0
    for k in range(roots.size):
        for i in range(k + 1, 0, -1):
            product[i] -= roots[k] * product[i - 1]
    out = np.empty(size)
    for i in range(size):
        out[i] = product[i].real
    return out


@compiled(inside=True)
def complex_roots(polynomial: FloatArray) -> ComplexArray:
    """Roots in z of 1 + a₁q⁻¹ + …, except those at zero: eigenvalues of the companion matrix."""
    degree = polynomial.size - 1
    while degree > 0 and polynomial[degree] == 0.0:
        degree -= 1
    companion = np.zeros((degree, degree), np.complex128)
    for i in range(degree):
        companion[0, i] = -polynomial[i + 1]
        if i > 0:
            companion[i, i - 1] = 1.0
    return np.linalg.eigvals(companion).astype(np.complex128)


@compiled(inside=True)
def is_finite(values: FloatArray) -> bool:
    """Whether every value is a number."""
    for i in range(values.size):  # noqa: SIM110 (no generators in kernels)
        if not np.isfinite(values[i]):
            return False
    return True
