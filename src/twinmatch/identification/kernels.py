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

# ruff: noqa: PLR0912, PLR0917 (loops written out have many branches, kernels take arrays in a row)

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
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

ComplexArray = NDArray[np.complex128]
Spans = NDArray[np.int64]
"""Columns of a matrix in groups, shape (g, 3): signal, first delay, count; the delays run on by one."""
Weighed = bool | None
"""True where the initial conditions of the noise filter are penalised, else None: what is None when a
function is compiled takes the code of the other case out of it."""

CHUNK = 48
"""Rows folded into the triangle at a time: a chunk of 30 columns stays in the first-level cache."""
VANISHED = 1e-140
"""A filter whose memory is smaller than this is at rest: denormal numbers are a hundred times slower."""
TAPS = 6
"""Filters of up to so many coefficients are written out."""
DEPENDENT = 1e-13
"""Part of a column's square that must be left after the columns before it for it to count as new."""
RIDGE = 1e-9
"""Damping of linear coefficients relative to their columns: decides ties between columns that the data
cannot tell apart, and changes nothing otherwise."""
LARGEST_ROOT = 1.0 - 1e-6
"""Largest root magnitude an estimated C, D or F may have."""
ROWS = 9
"""Signals of which the derivatives are delayed copies."""
STEP = 1e-6
"""Of the difference quotient of the noise filter's covariance."""
DOUBLINGS = 28
"""Enough for a root of D next to the largest allowed: 2²⁸ terms."""
TOUCHING = 1e-8
"""A root is on the boundary when it is no farther from it than this."""
FLAT = 10.0
"""A step that gains less than this part of what counts as settled is idle; after `PATIENCE`, stop."""
PATIENCE = 3
NOISE_FREE = 1e-26
"""Part of Σ y² below which errors are rounding only."""
EPSILON = 1e-14
"""Curvature of an axis, relative to the greatest, below which it is rounding."""
TRIAL = 4
FAITH = 5.0
"""A search that after `TRIAL` steps would not reach its rival with this many times the gain that its
undamped step promises is given up."""
STIFF = 1e8
"""Damping at which no step is left to take."""
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


def _inner(function: _Function) -> _Function:
    # Called from kernels only: half of what there is to compile of a small function is the way into it.
    options = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return cast(_Function, numba.njit(nogil=True, error_model="numpy", **options)(function))


def _inlined(function: _Function) -> _Function:
    # Becomes part of its one caller: what is linked into every level above is compiled once per level.
    return cast(_Function, numba.njit(nogil=True, error_model="numpy", inline="always")(function))


class Polynomials(NamedTuple):
    """A model as coefficients of q⁻¹; C, D and F monic, B with its leading zeros."""

    B: FloatArray
    C: FloatArray
    D: FloatArray
    F: FloatArray


class Task(NamedTuple):
    """The data and the order of one estimate."""

    u: FloatArray
    y: FloatArray
    counts: NDArray[np.int64]
    """nb, nc, nd, nf, nk."""
    radii: FloatArray
    """Largest root magnitudes of C, D and F."""
    spans: Spans
    """Columns b, m, c, d, f and e of the derivatives."""
    pad: int
    """At least the largest delay."""


class Place(NamedTuple):
    """A model along the search: θ, the best x for it, and its errors."""

    theta: FloatArray
    """c, d, f."""
    model: Polynomials
    """θ and b as polynomials."""
    x: FloatArray
    """b, m."""
    errors: FloatArray
    """e, shape (N,)."""
    signals: FloatArray
    """Derivatives before their delays, shape (ROWS, pad + N)."""
    cost: float
    """Σ e², and ‖z‖² where the start is weighed."""
    start: FloatArray
    """s and z where the start is weighed, else empty; see `weigh_linear`."""


class Quadratic(NamedTuple):
    """A quadratic model of the cost in the eigenvectors of its Hessian."""

    gradient: FloatArray
    curvatures: FloatArray
    basis: FloatArray
    """The eigenvectors as columns."""


@_inner
def copy_into(source: FloatArray, target: FloatArray) -> None:
    """Write the source over the first samples of the target; a slice would compile messages about shapes."""
    for t in range(source.size):
        target[t] = source[t]


@_inner
def fir_into(numerator: FloatArray, x: FloatArray, out: FloatArray) -> None:
    """Filter x by a polynomial in q⁻¹ from rest into `out`, another array of its length."""
    count, taps = x.size, numerator.size
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
    # Written out over slices it fills the vector unit.
    c0, c1, c2, c3, c4, c5 = c[0], c[1], c[2], c[3], c[4], c[5]
    x0, x1, x2, x3, x4, x5 = x[5:], x[4:], x[3:], x[2:], x[1:], x
    rest = out[5:]
    for t in range(rest.size):
        rest[t] = (c0 * x0[t] + c1 * x1[t]) + (c2 * x2[t] + c3 * x3[t]) + (c4 * x4[t] + c5 * x5[t])


@_inner
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
    a1, a2, a3, a4, a5 = a[1], a[2], a[3], a[4], a[5]
    o1 = o2 = o3 = o4 = o5 = 0.0
    for start in range(0, x.size, CHUNK):
        if abs(o1) + abs(o2) + abs(o3) + abs(o4) + abs(o5) < VANISHED:
            o1 = o2 = o3 = o4 = o5 = 0.0
        for t in range(start, min(start + CHUNK, x.size)):  # the newest output last: a short dependency
            total = (x[t] - (a5 * o5 + a4 * o4)) - (a3 * o3 + a2 * o2) - a1 * o1
            out[t] = total
            o5, o4, o3, o2, o1 = o4, o3, o2, o1, total


@compiled
def fir(numerator: FloatArray, x: FloatArray) -> FloatArray:
    """Filter x by a polynomial in q⁻¹ from rest; shape (N,)."""
    out = np.empty(x.size)
    fir_into(numerator, x, out)
    return out


@compiled
def all_pole(denominator: FloatArray, x: FloatArray) -> FloatArray:
    """Filter x by 1/denominator from rest; the denominator is monic in q⁻¹; shape (N,)."""
    out = np.empty(x.size)
    all_pole_into(denominator, x, out)
    return out


@_inner
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


@_inner
def delayed_rows(signals: FloatArray, spans: Spans, start: int, count: int, rows: FloatArray) -> None:
    """Copy the columns of `count` samples from index `start` on into `rows`, shape (≥ count, p)."""
    column = 0
    for p in range(spans.shape[0]):
        for i in range(spans[p, 2]):
            at = start - spans[p, 1] - i
            source, target = signals[spans[p, 0], at : at + count], rows[:count, column]
            for t in range(count):
                target[t] = source[t]
            column += 1


@_inner
def corners_of(spans: Spans) -> Spans:
    """First column of every span, and the number of columns at the end."""
    corners = np.zeros(spans.shape[0] + 1, np.int64)
    for p in range(spans.shape[0]):
        corners[p + 1] = corners[p] + spans[p, 2]
    return corners


@compiled
def correlate(signals: FloatArray, low: int, spans: Spans) -> FloatArray:
    """Upper triangle of the normal matrix of delayed signals.

    A row of the matrix has ``signals[s, t - delay]`` for every span; t runs from `low` to the end. Moving
    both delays by one moves a product sum by one sample, so that only the products with the first column
    of each span are summed in full.

    Args:
        signals: shape (m, pad + N), zero in the first `pad` samples; pad is at least the largest delay.
        low: index of the first row used, `pad` for all.
        spans: the columns.

    Returns:
        Normal matrix, shape (p, p); what lies below the diagonal has no meaning.
    """
    corners = corners_of(spans)
    width, groups = corners[-1], spans.shape[0]
    leads = np.zeros((groups, width))
    rows = np.empty((CHUNK, width))
    high = signals.shape[1]
    for start in range(low, high, CHUNK):
        count = min(CHUNK, high - start)
        delayed_rows(signals, spans, start, count, rows)
        for p in range(groups):
            if spans[p, 2] == 0:
                continue
            lead = leads[p]
            corner = corners[p]
            for t in range(0, count - 3, 4):
                r0, r1, r2, r3 = rows[t], rows[t + 1], rows[t + 2], rows[t + 3]
                a0, a1, a2, a3 = r0[corner], r1[corner], r2[corner], r3[corner]
                for j in range(width):
                    lead[j] += (a0 * r0[j] + a1 * r1[j]) + (a2 * r2[j] + a3 * r3[j])
            for t in range(count // 4 * 4, count):
                row = rows[t]
                for j in range(width):
                    lead[j] += row[corner] * row[j]
    G = np.zeros((width, width))
    for p in range(groups):
        for q in range(p, groups):
            a, b = signals[spans[p, 0]], signals[spans[q, 0]]
            for i in range(spans[p, 2]):
                da = spans[p, 1] + i
                for j in range(i if p == q else 0, spans[q, 2]):
                    db = spans[q, 1] + j
                    if i == 0:
                        value = leads[p, corners[q] + j]
                    elif j == 0:
                        value = leads[q, corners[p] + i]
                    else:
                        value = G[corners[p] + i - 1, corners[q] + j - 1]
                        value += a[low - da] * b[low - db] - a[high - da] * b[high - db]
                    G[corners[p] + i, corners[q] + j] = value
    return G


@compiled
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


@_inner
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


@compiled
def triangularise(signals: FloatArray, low: int, spans: Spans) -> FloatArray:
    """Triangle of the QR factorisation of delayed signals; arguments as for `correlate`."""
    width = corners_of(spans)[-1]
    R = np.zeros((width, width))
    rows = np.empty((CHUNK, width))
    work = np.empty(width)
    for start in range(low, signals.shape[1], CHUNK):
        count = min(CHUNK, signals.shape[1] - start)
        delayed_rows(signals, spans, start, count, rows)
        fold(R, rows, count, work)
    return R


@_inner
def triangle_of(matrix: FloatArray) -> FloatArray:
    """Triangle of the QR factorisation of a matrix, shape (p, p); destroys the matrix."""
    R = np.zeros((matrix.shape[1], matrix.shape[1]))
    fold(R, matrix, matrix.shape[0], np.empty(matrix.shape[1]))
    return R


@compiled
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


@compiled
def column_norms(R: FloatArray) -> FloatArray:
    """Euclidean norms of the columns of R."""
    out = np.zeros(R.shape[1])
    for i in range(R.shape[0]):
        for j in range(R.shape[1]):
            out[j] += R[i, j] * R[i, j]
    return np.sqrt(out)


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
def continue_outputs(B: FloatArray, F: FloatArray, u: FloatArray, outputs: FloatArray) -> FloatArray:
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
def errors_of(u: FloatArray, y: FloatArray, model: Polynomials, m: FloatArray) -> FloatArray:
    """Prediction errors for the given initial conditions m of the predictor; shape (N,)."""
    rest, driven, e = np.empty(y.size), np.empty(y.size), np.empty(y.size)
    fir_into(model.F, y, rest)
    fir_into(model.B, u, driven)
    for t in range(y.size):
        rest[t] -= driven[t]
    fir_into(model.D, rest, e)
    for t in range(min(m.size, e.size)):
        e[t] += m[t]
    all_pole_into(model.C, e, e)
    all_pole_into(model.F, e, e)
    return e


@_inner
def back_substitute(R: FloatArray) -> FloatArray:
    """The x with R x = −(last column) for an upper triangle R; components without a row are zero."""
    size = R.shape[0] - 1
    x = np.zeros(size)
    for i in range(size - 1, -1, -1):
        total = -R[i, size]
        for j in range(i + 1, size):
            total -= R[i, j] * x[j]
        x[i] = total / R[i, i] if R[i, i] != 0.0 else 0.0
    return x


@_inner
def solve_triangle(R: FloatArray) -> FloatArray:
    """The x that minimises the errors from the triangle of their derivatives and the error at x = 0."""
    size = R.shape[0] - 1
    rhs, damping = np.empty(size), column_norms(R)
    for i in range(size):
        rhs[i] = -R[i, size]
        damping[i] *= RIDGE
    return ridge_solve(R[:size, :size].copy(), rhs, damping)


@compiled
def best_start(u: FloatArray, y: FloatArray, model: Polynomials, count: int) -> FloatArray:
    """The `count` initial conditions m of the predictor that leave the smallest errors."""
    signals = np.zeros((2, count + u.size))
    impulse = signals[0, count:]
    impulse[0] = 1.0
    all_pole_into(model.C, impulse, impulse)
    all_pole_into(model.F, impulse, impulse)
    copy_into(errors_of(u, y, model, np.zeros(0)), signals[1, count:])
    return solve_triangle(triangularise(signals, count, np.array([[0, 0, count], [1, 0, 1]])))


@compiled
def noise_factor(C: FloatArray, D: FloatArray) -> FloatArray:
    """L, lower triangular: the state n of C/D driven by white noise of variance 1 is L z, z white."""
    size = max(C.size, D.size) - 1
    if size == 0:
        return np.zeros((0, 0))
    A, step = np.zeros((size, size)), np.zeros((size, 1))
    for i in range(size):
        d = D[i + 1] if i + 1 < D.size else 0.0
        step[i, 0] = (C[i + 1] if i + 1 < C.size else 0.0) - d
        A[i, 0] = -d
        if i + 1 < size:
            A[i, i + 1] = 1.0
    P = np.dot(step, step.T.copy())
    for _ in range(DOUBLINGS):  # P = Σ Aᵏ Q Aᵏᵀ, twice as many terms each time
        P = P + np.dot(A, np.dot(P, A.T.copy()))
        A = np.dot(A, A)
    # Where C and D share a root its state is never excited: a floor keeps the factor defined.
    P = 0.5 * (P + P.T) + 1e-12 * (1.0 + np.trace(P)) * np.eye(size)
    return cholesky(P).T.copy()


@_inner
def start_columns(task: Task, model: Polynomials) -> FloatArray:
    """The matrix from (s, z) to m = F L z − D s."""
    nb, nc, nd, nf, nk = task.counts
    free, noise = max(nf, nb + nk - 1), max(nc, nd)
    states = task.spans[1, 2]
    shifted = np.zeros((states, noise))
    columns = np.zeros((states, free + noise))
    for j in range(free):
        for i in range(min(model.D.size, states - j)):
            columns[j + i, j] = -model.D[i]
    for j in range(noise):
        for i in range(min(model.F.size, states - j)):
            shifted[j + i, j] = model.F[i]
    columns[:, free:] = np.dot(shifted, noise_factor(model.C, model.D))
    return columns


@_inner
def weigh_linear(task: Task, model: Polynomials, R: FloatArray) -> tuple[FloatArray, FloatArray]:
    """x = (b, m) and (s, z) that minimise Σ e² + ‖z‖², from the triangle R of b, m and the error at x = 0.

    With n = L z, where L Lᵀ is the covariance of the noise filter's state for innovations of variance 1,
    this is the unconditional sum of squares of Box and Jenkins: what backcasting the noise into the
    infinite past would sum up. The state s of B/F stays free.
    """
    columns = start_columns(task, model)
    nb, size, noise = task.counts[0], R.shape[0] - 1, max(task.counts[1], task.counts[2])
    width = nb + columns.shape[1]
    rows = np.zeros((size + 1 + noise, width + 1))
    rows[: size + 1, :nb] = R[:, :nb]
    rows[: size + 1, nb:width] = np.dot(R[:, nb:size].copy(), columns)
    rows[: size + 1, width] = R[:, size]
    for j in range(noise):
        rows[size + 1 + j, width - noise + j] = 1.0
    T = triangle_of(rows)
    found = ridge_solve(T[:width, :width].copy(), -T[:width, width], RIDGE * column_norms(T)[:width])
    return np.concatenate((found[:nb], np.dot(columns, found[nb:].copy()))), found[nb:].copy()


@_inner
def weigh_all(task: Task, place: Place, R: FloatArray) -> FloatArray:
    """Triangle of the derivatives of (e, z) by (b, s, z, c, d, f) from that of e by (b, m, c, d, f)."""
    nb, nc, nd, nf, nk = task.counts
    free, noise = max(nf, nb + nk - 1), max(nc, nd)
    model = place.model
    z = place.start[free:].copy()
    states, size = task.spans[1, 2], R.shape[0] - 1
    columns = start_columns(task, model)
    moved = np.zeros((states, nc + nd + nf))  # ∂m/∂θ at fixed s and z
    for i in range(nc + nd):
        C, D = model.C.copy(), model.D.copy()
        if i < nc:
            C[1 + i] += STEP
        else:
            D[1 + i - nc] += STEP
        other = start_columns(task, Polynomials(model.B, C, D, model.F))
        moved[:, i] = np.dot(other - columns, place.start) / STEP
    n = np.dot(noise_factor(model.C, model.D), z)
    for i in range(nf):
        for j in range(min(noise, states - 1 - i)):
            moved[1 + i + j, nc + nd + i] += n[j]
    linear = nb + free + noise
    by_m = R[:, nb : nb + states].copy()
    rows = np.zeros((size + 1 + noise, linear + nc + nd + nf + 1))
    rows[: size + 1, :nb] = R[:, :nb]
    rows[: size + 1, nb:linear] = np.dot(by_m, columns)
    rows[: size + 1, linear:-1] = R[:, nb + states : size] + np.dot(by_m, moved)
    rows[: size + 1, -1] = R[:, size]
    for j in range(noise):
        rows[size + 1 + j, linear - noise + j] = 1.0
        rows[size + 1 + j, -1] = z[j]
    return triangle_of(rows)


@_inlined
def project(
    task: Task, model: Polynomials, signals: FloatArray, exact: bool, weighed: Weighed
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The best x = (b, m) for given C, D, F and the errors e it leaves; B of the model is not used.

    Fills rows 0 and 1 of `signals` with ∂e/∂b₀ and ∂e/∂m₀, and row 8 with the error at x = 0.
    """
    pad = task.pad
    by_b, by_m, rest = signals[0, pad:], signals[1, pad:], signals[8, pad:]
    fir_into(model.D, task.u, by_b)
    all_pole_into(model.C, by_b, by_b)
    all_pole_into(model.F, by_b, by_b)
    for t in range(by_b.size):
        by_b[t] = -by_b[t]
        by_m[t] = 0.0
    by_m[0] = 1.0
    all_pole_into(model.C, by_m, by_m)
    all_pole_into(model.F, by_m, by_m)
    fir_into(model.D, task.y, rest)
    all_pole_into(model.C, rest, rest)
    spans = task.spans[:3].copy()
    spans[2, 0], spans[2, 1], spans[2, 2] = 8, 0, 1
    start = np.zeros(0)
    if weighed is None:
        if exact:
            x = solve_triangle(triangularise(signals, pad, spans))
        else:
            x = back_substitute(cholesky(correlate(signals, pad, spans)))
    else:
        x, start = weigh_linear(task, model, triangularise(signals, pad, spans))
    e = rest.copy()
    column = 0
    for span in range(2):
        for i in range(spans[span, 2]):
            at = pad - spans[span, 1] - i
            factor, delayed = x[column], signals[spans[span, 0], at : at + e.size]
            for t in range(e.size):
                e[t] += factor * delayed[t]
            column += 1
    return x, e, start


@compiled
def linearise(task: Task, place: Place, exact: bool, weighed: Weighed) -> FloatArray:
    """QR triangle of the derivatives of e by (b, m, c, d, f), with the rotated e as last column.

    Rows 0, 1 and 8 of `signals` are as `project` left them; rows 2 to 4 become ∂e/∂c, ∂e/∂d and ∂e/∂f
    before their delays, row 5 becomes e.
    """
    _, model, _, e, signals, _, _ = place
    _, C, _, F = model
    pad = task.pad
    rest, by_c, by_d, by_f = signals[8, pad:], signals[2, pad:], signals[3, pad:], signals[4, pad:]
    driven = np.empty(e.size)
    fir_into(model.B, task.u, driven)
    fir_into(F, task.y, by_d)
    for t in range(e.size):
        by_f[t] = rest[t] - e[t]  # (D y − C e)/C
        by_c[t] = -e[t]
        by_d[t] -= driven[t]
    all_pole_into(F, by_f, by_f)
    all_pole_into(C, by_c, by_c)
    all_pole_into(C, by_d, by_d)
    all_pole_into(F, by_d, by_d)
    copy_into(e, signals[5, pad:])
    R = triangularise(signals, pad, task.spans) if exact else cholesky(correlate(signals, pad, task.spans))
    if weighed is not None:
        R = weigh_all(task, place, R)
    return R


@compiled
def curvature(task: Task, place: Place, R: FloatArray) -> FloatArray:
    """Half the second derivative of Σ e² by θ = (c, d, f), with x = (b, m) following as its minimiser.

    Rows 0 to 5 of `signals` are as `linearise` left them, rows 6 and 7 become u/(CF) and B u/(CF); R is
    the triangle. Every ∂²e is one signal through 1/C or 1/F once more, delayed by both delays; the sum
    over e moves that filter onto e, backwards in time. See `CURVATURES`.
    """
    _, model, _, e, signals, _, _ = place
    pad, spans = task.pad, task.spans
    driven = signals[6, pad:]
    all_pole_into(model.C, task.u, driven)
    all_pole_into(model.F, driven, driven)
    fir_into(model.B, driven, signals[7, pad:])
    weights = np.empty((3, e.size))
    filtered = np.empty((2, e.size))
    for t in range(e.size):
        filtered[0, t] = filtered[1, t] = e[e.size - 1 - t]
    all_pole_into(model.C, filtered[0], filtered[0])
    all_pole_into(model.F, filtered[1], filtered[1])
    for t in range(e.size):
        weights[0, t] = e[t]
        weights[1, t] = filtered[0, e.size - 1 - t]
        weights[2, t] = filtered[1, e.size - 1 - t]
    corners = corners_of(spans)
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


@_inlined
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


@_inner
def from_roots(roots: ComplexArray, size: int) -> FloatArray:
    """The monic polynomial of `size` coefficients with these roots and the others at zero."""
    product = np.zeros(size, np.complex128)
    product[0] = 1.0
    for k in range(roots.size):
        for i in range(k + 1, 0, -1):
            product[i] -= roots[k] * product[i - 1]
    out = np.empty(size)
    for i in range(size):
        out[i] = product[i].real
    return out


@_inner
def complex_roots(polynomial: FloatArray) -> ComplexArray:
    """Roots in z of 1 + a₁q⁻¹ + …, those at zero left out: eigenvalues of the companion matrix."""
    degree = polynomial.size - 1
    while degree > 0 and polynomial[degree] == 0.0:
        degree -= 1
    companion = np.zeros((degree, degree), np.complex128)
    for i in range(degree):
        companion[0, i] = -polynomial[i + 1]
        if i > 0:
            companion[i, i - 1] = 1.0
    return np.linalg.eigvals(companion).astype(np.complex128)


@_inner
def is_finite(values: FloatArray) -> bool:
    """Whether every value is a number."""
    for i in range(values.size):  # noqa: SIM110 (no generators in kernels)
        if not np.isfinite(values[i]):
            return False
    return True


@compiled
def stabilise(polynomial: FloatArray, radius: float, mirror: float) -> FloatArray:
    """Pull roots beyond `radius` back to it along their ray; what is not finite becomes 1.

    Roots beyond `mirror`, 1 or infinity, first move to their mirror image inside: a reflected C or D keeps
    the spectrum's shape, only the size of the innovations changes.
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
    while not is_stable(stable, radius):  # rounding may leave a multiple root outside
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


@compiled
def evaluate(task: Task, theta: FloatArray, signals: FloatArray, exact: bool, weighed: Weighed) -> Place:
    """The best linear coefficients at θ and the errors they leave.

    Roots outside the stable region are pulled back to its boundary: the place's θ is what is left.
    """
    nb, nf, nk = task.counts[0], task.counts[3], task.counts[4]
    stable = np.empty(theta.size)
    B = np.zeros(nk + nb)
    C = D = F = B
    first = 0
    for k in range(3):
        last = first + task.counts[1 + k]
        part = np.ones(1 + last - first)
        copy_into(theta[first:last], part[1:])
        part = stabilise(part, task.radii[k], np.inf)
        copy_into(part[1:], stable[first:last])
        if k == 0:
            C = part
        elif k == 1:
            D = part
        else:
            F = part
        first = last
    model = Polynomials(B, C, D, F)
    x, e, start = project(task, model, signals, exact, weighed)
    copy_into(x[:nb], B[nk:])
    cost = 0.0
    for t in range(e.size):
        cost += e[t] * e[t]
    for j in range(max(nf, nb + nk - 1), start.size):
        cost += start[j] * start[j]
    return Place(stable, model, x, e, signals, cost if np.isfinite(cost) else np.inf, start)


@_inner
def product(a: FloatArray, b: FloatArray) -> FloatArray:
    """The matrix a b, summed in a fixed order."""
    out = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            for j in range(b.shape[1]):
                out[i, j] += a[i, k] * b[k, j]
    return out


@_inlined
def diagonalise(gradient: FloatArray, hessian: FloatArray, basis: FloatArray) -> Quadratic:
    """The cost around a point, cost + 2 gᵀδ + δᵀHδ, in the eigenvectors of the Hessian in `basis`."""
    across = np.ascontiguousarray(basis.T)
    curvatures, axes = np.linalg.eigh(product(across, product(hessian, basis)))
    turned = product(basis, np.ascontiguousarray(axes))
    along = np.zeros(gradient.size)
    for i in range(gradient.size):
        for j in range(gradient.size):
            along[j] += turned[i, j] * gradient[i]
    return Quadratic(along, curvatures, turned)


@_inner
def damped_step(quadratic: Quadratic, damping: float) -> tuple[FloatArray, float]:
    """The damped step and the gain it promises; downhill along axes of negative curvature too."""
    gradient, curvatures, basis = quadratic
    greatest, gain = 0.0, 0.0
    for j in range(gradient.size):
        greatest = max(greatest, abs(curvatures[j]))
    floor = max(EPSILON * greatest, 1e-300)
    step = np.zeros(gradient.size)
    for j in range(gradient.size):
        along = -gradient[j] / (max(abs(curvatures[j]), floor) + damping)
        gain -= along * (2.0 * gradient[j] + curvatures[j] * along)
        for i in range(gradient.size):
            step[i] += basis[i, j] * along
    return step, gain


@_inlined
def quadratic_at(task: Task, place: Place, newton: bool, exact: bool, weighed: Weighed) -> Quadratic:
    """The quadratic model of the cost at a place; where θ slides along the boundary, in the axes of that."""
    R = linearise(task, place, exact, weighed)
    count, size = place.theta.size, R.shape[0] - 1
    linear = size - count
    gradient, hessian, basis = np.zeros(count), np.zeros((count, count)), np.zeros((count, count))
    for k in range(count):
        row = R[linear + k, linear:]
        for i in range(k, count):
            gradient[i] += row[i] * row[count]
            for j in range(k, count):
                hessian[i, j] += row[i] * row[j]
    norms = column_norms(R)
    for i in range(count):
        scale = np.sqrt(hessian[i, i]) + 1e-6 * norms[linear + i]
        basis[i, i] = 1.0 / scale if scale > 0.0 else 1.0
    if newton:
        hessian = curvature(task, place, R)
    normals = outward(task, place)
    for _ in range(2):
        quadratic = diagonalise(gradient, hessian, basis)
        if normals.shape[0] == 0:
            break
        step, _ = damped_step(quadratic, 0.0)
        if not slide(basis, normals, step):
            break
    return quadratic


@_inner
def slide(basis: FloatArray, normals: FloatArray, step: FloatArray) -> bool:
    """Leave in `basis` only steps along the boundary where `step` would leave it; whether any does."""
    leaving = np.empty(normals.shape)
    found = 0
    for k in range(normals.shape[0]):
        if inner(normals[k], step) > 0.0:
            for j in range(step.size):  # by the axes of the basis
                total = 0.0
                for i in range(step.size):
                    total += normals[k, i] * basis[i, j]
                leaving[found, j] = total
            found += 1
    largest = 0.0
    for i in range(step.size):
        for j in range(step.size):
            largest = max(largest, abs(basis[i, j]))
    for k in range(found):
        row = leaving[k]
        for j in range(k):
            take_out(leaving[j], row)
        size = np.sqrt(inner(row, row))
        for j in range(row.size):
            row[j] = row[j] / size if size > 1e-10 * largest else 0.0
        for i in range(step.size):
            take_out(row, basis[i])
    return found > 0


@_inner
def inner(a: FloatArray, b: FloatArray) -> float:
    """Inner product of two short vectors."""
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@_inner
def take_out(unit: FloatArray, row: FloatArray) -> None:
    """Project the unit vector out of the row."""
    part = inner(unit, row)
    for i in range(row.size):
        row[i] -= part * unit[i]


@_inlined
def outward(task: Task, place: Place) -> FloatArray:
    """Normals that point out of the stable region where a root touches its boundary, as rows."""
    rows = np.zeros((place.theta.size, place.theta.size))
    first = found = 0
    for k in range(3):
        polynomial = place.model[1] if k == 0 else place.model[2] if k == 1 else place.model[3]
        normals = boundary_normals(polynomial, task.radii[k])
        for i in range(normals.shape[0]):
            copy_into(normals[i], rows[found, first:])
            found += 1
        first += polynomial.size - 1
    return rows[:found]


@compiled
def descend(
    task: Task,
    theta: FloatArray,
    exact: bool,
    iterations: int,
    rival: float,
    settled: float,
    weighed: Weighed,
) -> tuple[Place, bool, int]:
    """Descend from θ until nothing is left to gain; the cost never grows on the way.

    Gauss–Newton leaves out the second derivatives of e. Far from the minimum that makes it robust; in the
    flat valleys of closed-loop data and of orders that are too high it makes it zigzag for hundreds of
    steps. The second derivatives are exact and cheap here, so the search changes over as soon as the
    model of the cost it used was a bad prophet of the gain. Steps that leave the stable region are pulled
    back to its boundary and taken only if they still gain.

    Args:
        task: the data and the order.
        theta: start.
        exact: factorise by QR instead of by normal equations: for the last digits.
        iterations: most steps to take.
        rival: a cost reached elsewhere; given up when after `TRIAL` steps it seems out of reach.
        settled: converged when an undamped step promises less than this part of the cost.

    Returns:
        Where it ended, whether nothing was left to gain, and the steps taken.
    """
    used = np.zeros((ROWS, task.pad + task.u.size))
    spare = np.zeros((ROWS, task.pad + task.u.size))
    place = evaluate(task, theta, used, exact, weighed)
    floor = NOISE_FREE * dot(task.y, task.y)
    weighs = weighed is not None
    damping, newton, idle = 1e-3, iterations < 0, 0
    for iteration in range(iterations):
        if place.cost <= floor or theta.size == 0:
            return place, True, iteration
        quadratic = quadratic_at(task, place, newton, exact, weighed)
        hope = damped_step(quadratic, 0.0)[1]
        if hope <= settled * place.cost:
            return place, True, iteration
        if iteration >= TRIAL and place.cost - FAITH * hope > rival:
            return place, False, iteration
        while True:
            delta, promised = damped_step(quadratic, damping)
            trial = evaluate(task, place.theta + delta, spare, exact, weighed)
            gained = place.cost - trial.cost
            if gained > 0.0:
                break
            damping *= 8.0
            newton = not weighs
            if damping > STIFF:
                return place, True, iteration
        ratio = gained / promised if promised > 0.0 else 0.0
        damping = max(damping * (0.1 if ratio > 0.75 else 0.5 if ratio > 0.25 else 2.0), 1e-12)
        newton = newton or not (weighs or 0.5 < ratio < 2.0)
        idle = idle + 1 if gained < FLAT * settled * place.cost else 0
        place = trial
        used, spare = spare, used
        if idle == PATIENCE:
            return place, True, iteration + 1
    return place, False, iterations
