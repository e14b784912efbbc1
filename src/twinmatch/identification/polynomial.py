"""Keeping the roots of a monic polynomial inside the unit circle."""

from __future__ import annotations

import numpy as np

from twinmatch.identification.kernels import LARGEST_ROOT, is_stable
from twinmatch.signals import FloatArray

__all__ = ["boundary_normals", "clamp", "reflect"]

TOUCHING = 1e-8
"""A root is on the boundary when it is no farther from it than this."""


def reflect(polynomial: FloatArray, radius: float = LARGEST_ROOT) -> FloatArray:
    """Move roots outside the unit circle to their mirror image inside, then `clamp`.

    A reflected C or D keeps the spectrum's shape: only the size of the innovations changes.
    """
    if is_stable(polynomial, radius) or not np.all(np.isfinite(polynomial)):
        return clamp(polynomial, radius)
    roots = np.roots(polynomial).astype(np.complex128)
    outside = np.abs(roots) > 1.0
    roots[outside] = 1.0 / np.conj(roots[outside])
    return clamp(_from_roots(roots, polynomial.size), radius)


def clamp(polynomial: FloatArray, radius: float = LARGEST_ROOT) -> FloatArray:
    """Pull roots beyond `radius` back to it along their ray; what is not finite becomes 1."""
    if is_stable(polynomial, radius):
        return polynomial
    if not np.all(np.isfinite(polynomial)):
        return np.asarray(np.eye(1, polynomial.size)[0])
    roots = np.roots(polynomial).astype(np.complex128)
    magnitude = np.abs(roots)
    beyond = magnitude >= radius
    roots[beyond] *= (radius - 1e-9) / magnitude[beyond]
    stable = _from_roots(roots, polynomial.size)
    while not is_stable(stable, radius):  # rounding may leave a multiple root outside
        stable = stable * 0.9999 ** np.arange(stable.size)
    return stable


def boundary_normals(polynomial: FloatArray, radius: float = LARGEST_ROOT) -> list[FloatArray]:
    """Gradients of |z| by the free coefficients for the simple roots z that touch the boundary."""
    if is_stable(polynomial, radius - TOUCHING):
        return []
    degree = polynomial.size - 1
    slope = np.polyder(polynomial)
    normals = []
    for z in np.roots(polynomial).astype(np.complex128):
        if abs(z) < radius - TOUCHING or z.imag < 0.0:
            continue
        by_coefficient = -(z ** np.arange(degree - 1, -1, -1)) / np.polyval(slope, z)
        normal = np.real(np.conj(z) * by_coefficient) / abs(z)
        if np.all(np.isfinite(normal)):
            normals.append(normal)
    return normals


def _from_roots(roots: np.ndarray[tuple[int], np.dtype[np.complex128]], size: int) -> FloatArray:
    polynomial = np.zeros(size)  # np.roots leaves out roots at zero
    polynomial[: roots.size + 1] = np.real(np.poly(roots))
    return polynomial
