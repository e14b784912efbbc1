"""Least squares on matrices whose columns are delayed copies of a few signals.

The matrices are never formed: `triangularise` folds them chunk by chunk into the triangle of their QR
factorisation (exact, slow), `correlate` computes the normal matrix from a few correlations (twenty times
faster, half the digits), and `cholesky` turns that into the same triangle. Signals are padded with leading
zeros, at least `SLACK` more than the largest delay, so that delays need no bounds check.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.signals import FloatArray

Spans = NDArray[np.int64]
"""Columns of a matrix in groups, shape (g, 3): signal, first delay, count; delays increase by one."""
SIGNAL, DELAY, COUNT = range(3)
"""Positions of the entries of a group."""

SLACK = 4
"""Delays are processed in groups of four, hence this margin."""
CHUNK = 48
"""Rows folded into the triangle at a time: a chunk of 30 columns stays in the first-level cache."""
DEPENDENT = 1e-13
"""Share of a column's square that must remain after projection on the columns before it."""
RIDGE = 1e-9
"""Damping of linear coefficients relative to their columns: resolves columns that the data cannot separate,
and has no effect otherwise."""


@compiled(inside=True)
def delayed_rows(
    signals: FloatArray, spans: Spans, start: int, count: int, rows: FloatArray
) -> None:
    """Copy the columns of `count` samples from index `start` on into `rows`, shape (≥ count, p)."""
    column = 0
    for p in range(spans.shape[0]):
        for i in range(spans[p, COUNT]):
            first = start - spans[p, DELAY] - i
            source = signals[spans[p, SIGNAL], first : first + count]
            target = rows[:count, column]
            for t in range(count):
                target[t] = source[t]
            column += 1


@compiled(inside=True)
def corners_of(spans: Spans) -> Spans:
    """First column of every span, and the number of columns at the end."""
    corners = np.zeros(spans.shape[0] + 1, np.int64)
    for p in range(spans.shape[0]):
        corners[p + 1] = corners[p] + spans[p, COUNT]
    return corners


@compiled
def correlate(signals: FloatArray, low: int, spans: Spans) -> FloatArray:
    """Upper triangle of the normal matrix of delayed signals.

    A row of the matrix has ``signals[s, t - delay]`` for every span; t runs from `low` to the end. Shifting
    both delays by one shifts a product sum by one sample, so only the products with the first column of each
    span are summed in full.

    Args:
        signals: shape (m, pad + N), zero in the first `pad` samples; pad is at least the largest delay and
            `SLACK`.
        low: index of the first row used, `pad` for all.
        spans: the columns.

    Returns:
        Normal matrix, shape (p, p); entries below the diagonal are undefined.
    """
    corners = corners_of(spans)
    width = corners[-1]
    groups = spans.shape[0]
    high = signals.shape[1]
    leads = first_products(signals, low, spans, corners)
    G = np.zeros((width, width))
    for p in range(groups):
        for q in range(p, groups):
            a = signals[spans[p, SIGNAL]]
            b = signals[spans[q, SIGNAL]]
            for i in range(spans[p, COUNT]):
                da = spans[p, DELAY] + i
                for j in range(i if p == q else 0, spans[q, COUNT]):
                    db = spans[q, DELAY] + j
                    if i == 0:
                        value = leads[p, corners[q] + j]
                    elif j == 0:
                        value = leads[q, corners[p] + i]
                    else:
                        value = G[corners[p] + i - 1, corners[q] + j - 1]
                        value += a[low - da] * b[low - db] - a[high - da] * b[high - db]
                    G[corners[p] + i, corners[q] + j] = value
    return G


@compiled(inside=True)
def first_products(
    signals: FloatArray, low: int, spans: Spans, corners: NDArray[np.int64]
) -> FloatArray:
    """Inner products of the first column of every group with all columns, shape (g, p)."""
    groups = spans.shape[0]
    count = signals.shape[1] - low
    leads = np.zeros((groups, corners[-1]))
    sums = np.empty(12)
    for p in range(0, groups, 3):
        second = min(p + 1, groups - 1)
        third = min(p + 2, groups - 1)
        a = signals[spans[p, SIGNAL], low - spans[p, DELAY] :]
        b = signals[spans[second, SIGNAL], low - spans[second, DELAY] :]
        c = signals[spans[third, SIGNAL], low - spans[third, DELAY] :]
        for q in range(groups):
            for i in range(0, spans[q, COUNT], 4):
                first_place = low - spans[q, DELAY] - i - 3
                products(a[:count], b, c, signals[spans[q, SIGNAL], first_place:], sums)
                column = corners[q] + i
                for j in range(min(4, spans[q, COUNT] - i)):
                    leads[p, column + j] = sums[3 - j]
                    leads[second, column + j] = sums[7 - j]
                    leads[third, column + j] = sums[11 - j]
    return leads


@compiled(inside=True)
def products(
    a: FloatArray, b: FloatArray, c: FloatArray, x: FloatArray, out: FloatArray
) -> None:
    """Sums of a(t), b(t) and c(t) times x(t + j), j = 0 … 3, over the length of a; shape (12,).

    Twelve parallel sums fill the vector unit, and every sample of x is loaded for three of them.
    """
    a0 = a1 = a2 = a3 = b0 = b1 = b2 = b3 = c0 = c1 = c2 = c3 = 0.0
    for t in range(a.size):
        x0 = x[t]
        x1 = x[t + 1]
        x2 = x[t + 2]
        x3 = x[t + 3]
        by_a = a[t]
        by_b = b[t]
        by_c = c[t]
        a0 += by_a * x0
        a1 += by_a * x1
        a2 += by_a * x2
        a3 += by_a * x3
        b0 += by_b * x0
        b1 += by_b * x1
        b2 += by_b * x2
        b3 += by_b * x3
        c0 += by_c * x0
        c1 += by_c * x1
        c2 += by_c * x2
        c3 += by_c * x3
    out[0] = a0
    out[1] = a1
    out[2] = a2
    out[3] = a3
    out[4] = b0
    out[5] = b1
    out[6] = b2
    out[7] = b3
    out[8] = c0
    out[9] = c1
    out[10] = c2
    out[11] = c3


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


@compiled(inside=True)
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
            rows[t, k] *= scale
        add_rows(rows, count, k, work)
        for j in range(k + 1, width):
            work[j] *= tau
            R[k, j] -= work[j]
        take_from_rows(rows, count, k, work)


@compiled(inlined=True)
def add_rows(rows: FloatArray, count: int, k: int, work: FloatArray) -> None:
    """Add the rows behind column k to `work`, each times its entry there; four at a time, to read and write
    `work` less often."""
    for t in range(0, count - 3, 4):
        r0 = rows[t]
        r1 = rows[t + 1]
        r2 = rows[t + 2]
        r3 = rows[t + 3]
        a0 = r0[k]
        a1 = r1[k]
        a2 = r2[k]
        a3 = r3[k]
        for j in range(k + 1, work.size):
            work[j] = (((work[j] + a0 * r0[j]) + a1 * r1[j]) + a2 * r2[j]) + a3 * r3[j]
    for t in range(count // 4 * 4, count):
        for j in range(k + 1, work.size):
            work[j] += rows[t, k] * rows[t, j]


@compiled(inlined=True)
def take_from_rows(rows: FloatArray, count: int, k: int, work: FloatArray) -> None:
    """Subtract from each row, behind column k, its entry there times `work`."""
    for t in range(0, count - 3, 4):
        r0 = rows[t]
        r1 = rows[t + 1]
        r2 = rows[t + 2]
        r3 = rows[t + 3]
        a0 = r0[k]
        a1 = r1[k]
        a2 = r2[k]
        a3 = r3[k]
        for j in range(k + 1, work.size):
            weight = work[j]
            r0[j] -= a0 * weight
            r1[j] -= a1 * weight
            r2[j] -= a2 * weight
            r3[j] -= a3 * weight
    for t in range(count // 4 * 4, count):
        for j in range(k + 1, work.size):
            rows[t, j] -= rows[t, k] * work[j]


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


@compiled
def ridge_solve(R: FloatArray, rhs: FloatArray, damping: FloatArray) -> FloatArray:
    """The x that minimises ‖R x − rhs‖² + ‖damping ∘ x‖² for an upper triangle R.

    diag(damping) is folded into R, so that the condition number of R is not squared. An undetermined
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
    for j in range(out.size):
        out[j] = np.sqrt(out[j])
    return out


@compiled(inside=True)
def substitute_back(R: FloatArray) -> FloatArray:
    """The x with R x = −(last column) for an upper triangle R; components without a row are zero."""
    size = R.shape[0] - 1
    x = np.zeros(size)
    for i in range(size - 1, -1, -1):
        total = -R[i, size]
        for j in range(i + 1, size):
            total -= R[i, j] * x[j]
        x[i] = total / R[i, i] if R[i, i] != 0.0 else 0.0
    return x


@compiled(inside=True)
def solve_triangle(R: FloatArray) -> FloatArray:
    """The x that minimises the errors from the triangle of their derivatives and the error at x = 0."""
    size = R.shape[0] - 1
    rhs = np.empty(size)
    damping = column_norms(R)
    for i in range(size):
        rhs[i] = -R[i, size]
        damping[i] *= RIDGE
    return ridge_solve(R[:size, :size].copy(), rhs, damping)
