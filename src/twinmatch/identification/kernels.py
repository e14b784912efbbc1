"""The compiled arithmetic of the room: difference equations, least squares on delayed signals, and the
one-step prediction errors of a Box–Jenkins model with their first and second derivatives.

All of it is in this one file on purpose: numba's disk cache looks only at the file of the function that
is called from Python. It is plain arithmetic in a fixed order, without library calls whose rounding
depends on the number of threads, so that the same data give the same model to the last bit.

The matrices here have delayed copies of a few signals as columns. They are never formed: `triangularise`
folds them chunk by chunk into the triangle of their QR factorisation (exact, slow), `correlate` gets the
normal matrix from a few correlations (twenty times faster, half the digits), and `cholesky` turns that
into the same triangle. Signals carry zeros in front, `pad` of them, so that a delay needs no test.
"""

# ruff: noqa: PLR0917 (kernels take arrays in a row)

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

from twinmatch.signals import FloatArray

__all__ = [
    "LARGEST_ROOT",
    "Polynomials",
    "Spans",
    "all_pole",
    "best_start",
    "cholesky",
    "column_norms",
    "continue_outputs",
    "correlate",
    "curvature",
    "errors_of",
    "fir",
    "is_stable",
    "linearise",
    "project",
    "ridge_solve",
    "triangle_of",
    "triangularise",
]

_Function = TypeVar("_Function", bound=Callable[..., object])

Spans = NDArray[np.int64]
"""Columns of a matrix in groups, shape (g, 3): signal, first delay, count; the delays run on by one."""

CHUNK = 48
"""Rows folded into the triangle at a time: a chunk of 30 columns stays in the first-level cache."""
DEPENDENT = 1e-13
"""Part of a column's square that must be left after the columns before it for it to count as new."""
RIDGE = 1e-9
"""Damping of linear coefficients relative to their columns: decides ties between columns that the data
cannot tell apart, and changes nothing otherwise."""
LARGEST_ROOT = 1.0 - 1e-6
"""Largest root magnitude an estimated C, D or F may have."""
CURVATURES = np.array(
    [
        [0, 2, 1, 0, -1],
        [0, 3, 0, 6, -1],
        [0, 4, 2, 0, -1],
        [1, 2, 1, 1, -1],
        [1, 4, 2, 1, -1],
        [2, 2, 1, 2, -2],
        [2, 3, 1, 3, -1],
        [2, 4, 1, 4, -1],
        [3, 4, 2, 7, 1],
        [4, 4, 2, 4, -2],
    ]
)
"""Second derivatives that are not zero: two spans of (b, m, c, d, f), what e is filtered by (0 nothing,
1 by 1/C, 2 by 1/F), the signal it meets, and the factor."""


def _compiled(function: _Function) -> _Function:
    # No fastmath, so that bits repeat. Division follows IEEE, it does not raise.
    return cast(_Function, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


class Polynomials(NamedTuple):
    """A model as coefficients of q⁻¹; C, D and F monic, B with its leading zeros."""

    B: FloatArray
    C: FloatArray
    D: FloatArray
    F: FloatArray


@_compiled
def fir(numerator: FloatArray, x: FloatArray) -> FloatArray:
    """Filter x by a polynomial in q⁻¹ from rest; shape (N,)."""
    out = np.empty(x.size)
    degree = numerator.size - 1
    for t in range(x.size):
        total = 0.0
        for i in range(min(degree, t) + 1):
            total += numerator[i] * x[t - i]
        out[t] = total
    return out


@_compiled
def all_pole(denominator: FloatArray, x: FloatArray) -> FloatArray:
    """Filter x by 1/denominator from rest; the denominator is monic in q⁻¹; shape (N,)."""
    out = np.empty(x.size)
    degree = denominator.size - 1
    for t in range(x.size):
        total = x[t]
        for i in range(min(degree, t), 0, -1):  # the newest output last keeps the dependency short
            total -= denominator[i] * out[t - i]
        out[t] = total
    return out


@_compiled
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


@_compiled
def correlate(signals: FloatArray, pad: int, spans: Spans, first: int) -> FloatArray:
    """Upper triangle of the normal matrix of delayed signals.

    Row t of the matrix has ``signals[s, pad + t - delay]`` for every span; t = first … N−1. Moving both
    delays by one moves a product sum by one sample, so that only the first row and column of each pair
    of spans are summed in full.

    Args:
        signals: shape (m, pad + N), zero in the first `pad` samples.
        pad: at least the largest delay.
        spans: the columns.
        first: first row used.

    Returns:
        Normal matrix, shape (p, p); what lies below the diagonal has no meaning.
    """
    starts = np.concatenate((np.zeros(1, np.int64), np.cumsum(spans[:, 2])))
    G = np.zeros((starts[-1], starts[-1]))
    low, high = pad + first, signals.shape[1]
    for p in range(spans.shape[0]):
        for q in range(p, spans.shape[0]):
            a, b = signals[spans[p, 0]], signals[spans[q, 0]]
            for i in range(spans[p, 2]):
                da = spans[p, 1] + i
                for j in range(i if p == q else 0, spans[q, 2]):
                    db = spans[q, 1] + j
                    if i == 0 or j == 0:
                        value = dot(a[low - da : high - da], b[low - db : high - db])
                    else:
                        value = G[starts[p] + i - 1, starts[q] + j - 1]
                        value += a[low - da] * b[low - db] - a[high - da] * b[high - db]
                    G[starts[p] + i, starts[q] + j] = value
    return G


@_compiled
def cholesky(G: FloatArray) -> FloatArray:
    """Upper triangle R with RᵀR = G; rows of columns that depend on earlier ones are zero."""
    size = G.shape[0]
    R = np.zeros((size, size))
    for k in range(size):
        for j in range(k, size):
            R[k, j] = G[k, j]
        for i in range(k):
            a = R[i, k]
            for j in range(k, size):
                R[k, j] -= a * R[i, j]
        if R[k, k] > DEPENDENT * G[k, k]:
            scale = 1.0 / np.sqrt(R[k, k])
            for j in range(k, size):
                R[k, j] *= scale
        else:
            R[k, :] = 0.0
    return R


@_compiled
def fold(R: FloatArray, rows: FloatArray, count: int, work: FloatArray) -> None:
    """Fold `count` rows into the upper triangle R by Householder reflections; destroys the rows.

    R and rows have equally many columns; R has one row per column to eliminate.
    """
    width = R.shape[1]
    for k in range(R.shape[0]):
        square = 0.0
        for t in range(count):
            square += rows[t, k] * rows[t, k]
        if square == 0.0:
            continue
        head = R[k, k]
        norm = np.sqrt(head * head + square)
        beta = -norm if head > 0.0 else norm
        scale = 1.0 / (head - beta)
        tau = (beta - head) / beta
        R[k, k] = beta
        for j in range(k + 1, width):
            work[j] = R[k, j]
        for t in range(count):
            a = rows[t, k] * scale
            rows[t, k] = a
            for j in range(k + 1, width):
                work[j] += a * rows[t, j]
        for j in range(k + 1, width):
            work[j] *= tau
            R[k, j] -= work[j]
        for t in range(count):
            a = rows[t, k]
            for j in range(k + 1, width):
                rows[t, j] -= a * work[j]


@_compiled
def triangularise(signals: FloatArray, pad: int, spans: Spans, first: int) -> FloatArray:
    """Triangle of the QR factorisation of delayed signals; arguments as for `correlate`."""
    width = np.sum(spans[:, 2])
    R = np.zeros((width, width))
    rows = np.empty((CHUNK, width))
    work = np.empty(width)
    total = signals.shape[1] - pad
    start = first
    while start < total:
        count = min(CHUNK, total - start)
        column = 0
        for p in range(spans.shape[0]):
            signal = signals[spans[p, 0]]
            for i in range(spans[p, 2]):
                delayed = pad + start - spans[p, 1] - i
                for t in range(count):
                    rows[t, column] = signal[delayed + t]
                column += 1
        fold(R, rows, count, work)
        start += count
    return R


@_compiled
def triangle_of(matrix: FloatArray) -> FloatArray:
    """Triangle of the QR factorisation of a matrix, shape (p, p); destroys the matrix."""
    R = np.zeros((matrix.shape[1], matrix.shape[1]))
    fold(R, matrix, matrix.shape[0], np.empty(matrix.shape[1]))
    return R


@_compiled
def ridge_solve(R: FloatArray, rhs: FloatArray, damping: FloatArray) -> FloatArray:
    """The x that minimises ‖R x − rhs‖² + ‖damping ∘ x‖² for an upper triangle R.

    Done by folding diag(damping) into R, so that the condition of R is not squared. An undetermined
    component (no data, no damping) is set to zero.
    """
    size = R.shape[0]
    T = np.zeros((size, size + 1))
    for i in range(size):
        T[i, size] = rhs[i]
        for j in range(i, size):
            T[i, j] = R[i, j]
    row = np.zeros((1, size + 1))
    work = np.empty(size + 1)
    for i in range(size):
        if damping[i] == 0.0:
            continue
        row[0, :] = 0.0
        row[0, i] = damping[i]
        fold(T, row, 1, work)
    x = np.zeros(size)
    for i in range(size - 1, -1, -1):
        total = T[i, size]
        for j in range(i + 1, size):
            total -= T[i, j] * x[j]
        x[i] = total / T[i, i] if T[i, i] != 0.0 else 0.0
    return x


@_compiled
def column_norms(R: FloatArray) -> FloatArray:
    """Euclidean norms of the columns of R."""
    out = np.zeros(R.shape[1])
    for i in range(R.shape[0]):
        for j in range(R.shape[1]):
            out[j] += R[i, j] * R[i, j]
    return np.sqrt(out)


@_compiled
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


@_compiled
def continue_outputs(B: FloatArray, F: FloatArray, u: FloatArray, outputs: FloatArray) -> FloatArray:
    """F w = B u from the first sample after `outputs`, which are kept; shape (N,).

    Inputs and outputs before the first sample count as zero.
    """
    w = np.empty(u.size)
    w[: outputs.size] = outputs
    for t in range(outputs.size, u.size):
        total = 0.0
        for i in range(min(B.size - 1, t) + 1):
            total += B[i] * u[t - i]
        for i in range(1, min(F.size - 1, t) + 1):
            total -= F[i] * w[t - i]
        w[t] = total
    return w


@_compiled
def errors_of(u: FloatArray, y: FloatArray, model: Polynomials, m: FloatArray) -> FloatArray:
    """Prediction errors for the given initial conditions m of the predictor; shape (N,)."""
    e = fir(model.D, fir(model.F, y) - fir(model.B, u))
    count = min(m.size, e.size)
    e[:count] += m[:count]
    return all_pole(model.F, all_pole(model.C, e))


@_compiled
def solve_linear(signals: FloatArray, pad: int, spans: Spans, exact: bool) -> FloatArray:
    """The x that minimises the errors; the last span is the error at x = 0."""
    R = triangularise(signals, pad, spans, 0) if exact else cholesky(correlate(signals, pad, spans, 0))
    size = R.shape[0] - 1
    damping = RIDGE * column_norms(R)[:size]
    return ridge_solve(R[:size, :size].copy(), -R[:size, size], damping)


@_compiled
def best_start(u: FloatArray, y: FloatArray, model: Polynomials, count: int) -> FloatArray:
    """The `count` initial conditions m of the predictor that leave the smallest errors."""
    signals = np.zeros((2, count + u.size))
    signals[0, count] = 1.0
    signals[0, count:] = all_pole(model.F, all_pole(model.C, signals[0, count:]))
    signals[1, count:] = errors_of(u, y, model, np.zeros(0))
    return solve_linear(signals, count, np.array([[0, 0, count], [1, 0, 1]]), True)


@_compiled
def project(
    u: FloatArray, y: FloatArray, model: Polynomials, signals: FloatArray, pad: int, spans: Spans, exact: bool
) -> tuple[FloatArray, FloatArray]:
    """The best x = (b, m) for given C, D, F and the errors e it leaves; B of the model is not used.

    Fills rows 0 and 1 of `signals` with ∂e/∂b₀ and ∂e/∂m₀, and row 2 with the error at x = 0. `spans`
    are those of b, m and row 2.
    """
    signals[0, pad:] = -all_pole(model.F, all_pole(model.C, fir(model.D, u)))
    signals[1, pad:] = 0.0
    signals[1, pad] = 1.0
    signals[1, pad:] = all_pole(model.F, all_pole(model.C, signals[1, pad:]))
    signals[2, pad:] = all_pole(model.C, fir(model.D, y))
    x = solve_linear(signals, pad, spans, exact)
    e = signals[2, pad:].copy()
    column = 0
    for span in range(2):
        for i in range(spans[span, 2]):
            delayed = signals[spans[span, 0], pad - spans[span, 1] - i :]
            for t in range(e.size):
                e[t] += x[column] * delayed[t]
            column += 1
    return x, e


@_compiled
def linearise(
    u: FloatArray,
    y: FloatArray,
    model: Polynomials,
    e: FloatArray,
    signals: FloatArray,
    pad: int,
    spans: Spans,
    exact: bool,
) -> FloatArray:
    """QR triangle of the derivatives of e by (b, m, c, d, f), with the rotated e as last column.

    Rows 0 and 1 of `signals` are as `project` left them; rows 2 to 4 become ∂e/∂c, ∂e/∂d and ∂e/∂f
    before their delays, row 5 becomes e.
    """
    _, C, D, F = model
    signals[2, pad:] = -all_pole(C, e)
    signals[3, pad:] = all_pole(F, all_pole(C, fir(F, y) - fir(model.B, u)))
    signals[4, pad:] = all_pole(F, all_pole(C, fir(D, y) - fir(C, e)))
    signals[5, pad:] = e
    return triangularise(signals, pad, spans, 0) if exact else cholesky(correlate(signals, pad, spans, 0))


@_compiled
def curvature(
    u: FloatArray,
    model: Polynomials,
    e: FloatArray,
    signals: FloatArray,
    pad: int,
    spans: Spans,
    R: FloatArray,
) -> FloatArray:
    """Half the second derivative of Σ e² by θ = (c, d, f), with x = (b, m) following as its minimiser.

    Rows 0 to 5 of `signals` are as `linearise` left them, rows 6 and 7 become u/(CF) and B u/(CF); R is
    the triangle. Every ∂²e is one signal through 1/C or 1/F once more, delayed by both delays; the sum
    over e moves that filter onto e, backwards in time. See `CURVATURES`.
    """
    signals[6, pad:] = all_pole(model.F, all_pole(model.C, u))
    signals[7, pad:] = fir(model.B, signals[6, pad:].copy())
    weights = np.empty((3, e.size))
    backwards = e[::-1].copy()
    weights[0] = e
    weights[1] = all_pole(model.C, backwards)[::-1]
    weights[2] = all_pole(model.F, backwards)[::-1]
    corners = np.concatenate((np.zeros(1, np.int64), np.cumsum(spans[:, 2])))
    S = np.zeros((corners[5], corners[5]))
    for row in range(CURVATURES.shape[0]):
        p, q, weight, signal, factor = CURVATURES[row]
        for i in range(spans[p, 2]):
            for j in range(spans[q, 2]):
                if i == 0 or j == spans[q, 2] - 1:
                    delayed = pad - spans[p, 1] - spans[q, 1] - i - j
                    value = factor * dot(weights[weight], signals[signal, delayed:])
                else:
                    value = S[corners[p] + i - 1, corners[q] + j + 1]
                S[corners[p] + i, corners[q] + j] = value
    return eliminate_linear(S, R, corners[2])


@_compiled
def eliminate_linear(S: FloatArray, R: FloatArray, linear: int) -> FloatArray:
    """Schur complement over the first `linear` unknowns of RᵀR + S, S upper and zero among those."""
    size = S.shape[0] - linear
    K = np.zeros((linear, size))  # R_xx⁻ᵀ S_xθ
    for i in range(linear):
        if R[i, i] == 0.0:
            continue
        for j in range(size):
            total = S[i, linear + j]
            for k in range(i):
                total -= R[k, i] * K[k, j]
            K[i, j] = total / R[i, i]
    H = np.zeros((size, size))
    for a in range(size):
        for b in range(a, size):
            total = S[linear + a, linear + b]
            for k in range(linear):
                total -= K[k, a] * K[k, b] + R[k, linear + a] * K[k, b] + K[k, a] * R[k, linear + b]
            for k in range(a + 1):
                total += R[linear + k, linear + a] * R[linear + k, linear + b]
            H[a, b] = total
            H[b, a] = total
    return H
