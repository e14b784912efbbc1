"""Polynomials in q⁻¹: filters, bounds on the roots of C, D and F, and inner products of signals.

The operations have a fixed order and use no library calls whose rounding depends on the number of threads, so
that the same data give the same model to the last bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.dynamics.kernels import copy_into
from twinmatch.signals import FloatArray

REACH = 48
"""Interval, in samples, at which a filter is checked for being at rest."""
VANISHED = 1e-140
"""A filter with a smaller state is set to rest: denormal numbers are a hundred times slower."""
TAPS = 6
"""Filters with up to so many coefficients are unrolled."""
ComplexArray = NDArray[np.complex128]

LARGEST_ROOT = 1.0 - 1e-6
"""Largest root magnitude of an estimated C, D or F."""
TOUCHING = 1e-8
"""Largest distance at which a root counts as on the boundary."""


@compiled(inside=True)
def fir_into(numerator: FloatArray, x: FloatArray, out: FloatArray) -> None:
    """Filter x by a polynomial in q⁻¹ from rest into `out`, another array of its length."""
    count = x.size
    taps = numerator.size
    if taps > TAPS or count < TAPS:
        for t in range(count):
            total = 0.0
            for i in range(min(taps - 1, t) + 1):
                total += numerator[i] * x[t - i]
            out[t] = total
        return
    c = np.zeros(TAPS)
    copy_into(numerator, c)
    for t in range(TAPS - 1):
        total = 0.0
        for i in range(t + 1):
            total += c[i] * x[t - i]
        out[t] = total
    # Unrolled over slices, this fills the vector unit.
    c0 = c[0]
    c1 = c[1]
    c2 = c[2]
    c3 = c[3]
    c4 = c[4]
    c5 = c[5]
    x0 = x[5:]
    x1 = x[4:]
    x2 = x[3:]
    x3 = x[2:]
    x4 = x[1:]
    x5 = x
    later = out[5:]
    for t in range(later.size):
        later[t] = (
            (c0 * x0[t] + c1 * x1[t])
            + (c2 * x2[t] + c3 * x3[t])
            + (c4 * x4[t] + c5 * x5[t])
        )


@compiled(inside=True)
def all_pole_into(denominator: FloatArray, x: FloatArray, out: FloatArray) -> None:
    """Filter x by 1/denominator from rest into `out`, which may be x; the denominator is monic in q⁻¹."""
    degree = denominator.size - 1
    if degree >= TAPS:
        for t in range(x.size):
            total = x[t]
            for i in range(min(degree, t), 0, -1):
                total -= denominator[i] * out[t - i]
            out[t] = total
        return
    a = np.zeros(TAPS)
    copy_into(denominator, a)
    a1 = a[1]
    a2 = a[2]
    a3 = a[3]
    a4 = a[4]
    a5 = a[5]
    o1 = o2 = o3 = o4 = o5 = 0.0
    for start in range(0, x.size, REACH):
        if abs(o1) + abs(o2) + abs(o3) + abs(o4) + abs(o5) < VANISHED:
            o1 = o2 = o3 = o4 = o5 = 0.0
        for t in range(start, min(start + REACH, x.size)):
            # the newest output last: a short dependency
            total = (x[t] - (a5 * o5 + a4 * o4)) - (a3 * o3 + a2 * o2) - a1 * o1
            out[t] = total
            o5 = o4
            o4 = o3
            o3 = o2
            o2 = o1
            o1 = total


@compiled
def fir(numerator: FloatArray, x: FloatArray) -> FloatArray:
    """Filter x by a polynomial in q⁻¹ from rest; shape (N,)."""
    out = np.empty(x.size)
    fir_into(numerator, x, out)
    return out


@compiled(inside=True)
def dot(a: FloatArray, b: FloatArray) -> float:
    """Inner product over the length of a, in eight interleaved sums that fill the vector unit."""
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = 0.0
    whole = a.size // 8 * 8
    for t in range(0, whole, 8):
        s0 += a[t] * b[t]
        s1 += a[t + 1] * b[t + 1]
        s2 += a[t + 2] * b[t + 2]
        s3 += a[t + 3] * b[t + 3]
        s4 += a[t + 4] * b[t + 4]
        s5 += a[t + 5] * b[t + 5]
        s6 += a[t + 6] * b[t + 6]
        s7 += a[t + 7] * b[t + 7]
    for t in range(whole, a.size):
        s0 += a[t] * b[t]
    return ((s0 + s1) + (s2 + s3)) + ((s4 + s5) + (s6 + s7))


@compiled
def continue_outputs(
    B: FloatArray, F: FloatArray, u: FloatArray, outputs: FloatArray
) -> FloatArray:
    """F w = B u from the first sample after `outputs`, which are kept; shape (N,).

    Inputs and outputs before the first sample count as zero.
    """
    w = np.empty(u.size)
    copy_into(outputs, w)
    for t in range(outputs.size, u.size):
        total = 0.0
        for i in range(min(B.size - 1, t) + 1):
            total += B[i] * u[t - i]
        for i in range(1, min(F.size - 1, t) + 1):
            total -= F[i] * w[t - i]
        w[t] = total
    return w


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
    count = 0
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
            normals[count, i] = -(np.conj(z) * power / slope).real / abs(z)
            power *= z
        if is_finite(normals[count]):
            count += 1
    return normals[:count]


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
    for i in range(values.size):  # noqa: SIM110
        if not np.isfinite(values[i]):
            return False
    return True
