"""Start values for the search, from three methods that fail for different reasons.

1. A long ARX model whitens the data; Steiglitz–McBride on the whitened data gives B/F (the
   Box–Jenkins Steiglitz–McBride method of Y. Zhu, efficient even in closed loop).
2. Steiglitz–McBride on the raw data: the output-error model, which ignores the noise.
3. An ARX model of the same order: one denominator for both parts.

The noise part C/D of methods 1 and 2 is the ARMA model of the residuals of B/F, by Hannan–Rissanen.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.fitting.delayed import SLACK, Spans, cholesky, correlate, solve_triangle
from twinmatch.fitting.filters import all_pole_into, copy_into, fir, fir_into
from twinmatch.fitting.predictor import Polynomials, errors_of
from twinmatch.fitting.stability import LARGEST_ROOT, stabilise
from twinmatch.signals import FloatArray

__all__ = ["start_values"]

LONG = 20
"""Order of the long autoregressions, if the window is long enough."""
ROUNDS = 8
"""Iterations of Steiglitz–McBride; it converges in a few or not at all."""
SETTLED = 1e-4
"""Change of the coefficients of F below which it has converged."""
ROUTES = 3


@compiled
def start_values(u: FloatArray, y: FloatArray, counts: NDArray[np.int64]) -> FloatArray:
    """Candidates for θ = (c, d, f), each stable, in a fixed order; shape (3, nc + nd + nf).

    Args:
        u: input, shape (N,).
        y: output, shape (N,).
        counts: nb, nc, nd, nf, nk.
    """
    _, nc, nd, nf, _ = counts
    thetas = np.zeros((ROUTES, nc + nd + nf))
    whitener = long_arx(u, y, counts)
    skip = whitener.size - 1
    for route in range(2):
        if route == 0:
            F = steiglitz_mcbride(fir(whitener, u)[skip:], fir(whitener, y)[skip:], counts)
        else:
            F = steiglitz_mcbride(u, y, counts)
        C, D = noise_model(u, y, F, counts)
        copy_into(C[1:], thetas[route])
        copy_into(D[1:], thetas[route, nc:])
        copy_into(F[1:], thetas[route, nc + nd :])
    A = arx_denominator(u, y, counts)
    copy_into(A[1 : 1 + min(nd, nf)], thetas[2, nc:])
    copy_into(A[1:], thetas[2, nc + nd :])
    return thetas


@compiled(inside=True)
def regression(signals: FloatArray, low: int, spans: Spans) -> FloatArray:
    """Least squares of the column of the last group on those of the others, from sample `low` on."""
    return -solve_triangle(cholesky(correlate(signals, low, spans)))


@compiled(inside=True)
def padded(pad: int, first: FloatArray, second: FloatArray) -> FloatArray:
    """Two signals with leading zeros, shape (2, pad + N)."""
    signals = np.zeros((2, pad + first.size))
    copy_into(first, signals[0, pad:])
    copy_into(second, signals[1, pad:])
    return signals


@compiled(inside=True)
def monic(coefficients: FloatArray) -> FloatArray:
    """1 − c₁q⁻¹ − …: the polynomial of an autoregression with these coefficients."""
    polynomial = np.ones(1 + coefficients.size)
    for i in range(coefficients.size):
        polynomial[1 + i] = -coefficients[i]
    return polynomial


@compiled(inside=True)
def long_arx(u: FloatArray, y: FloatArray, counts: NDArray[np.int64]) -> FloatArray:
    """The denominator A of a long ARX model: 1/A is close to the noise filter C/D."""
    length, delay = min(LONG, u.size // 8), counts[4]
    pad = length + delay + SLACK
    spans = np.array(((0, 1, length), (1, delay, length), (0, 0, 1)))
    return monic(regression(padded(pad, y, u), pad + length + delay, spans)[:length])


@compiled(inside=True)
def arx_denominator(u: FloatArray, y: FloatArray, counts: NDArray[np.int64]) -> FloatArray:
    """The denominator of the ARX model of the order of F."""
    nb, _, _, nf, nk = counts
    if nf == 0:
        return np.ones(1)
    pad = max(nf, nk + nb) + SLACK
    spans = np.array(((0, 1, nf), (1, nk, nb), (0, 0, 1)))
    found = regression(padded(pad, y, u), pad + max(nf, nk + nb - 1), spans)
    return stabilise(monic(found[:nf]), LARGEST_ROOT, 1.0)


@compiled(inside=True)
def steiglitz_mcbride(u: FloatArray, y: FloatArray, counts: NDArray[np.int64]) -> FloatArray:
    """F of the output-error model by iterated prefiltering, with estimated initial conditions."""
    nb, _, _, nf, nk = counts
    F = np.ones(1 + nf)
    F[1:] = 0.0
    if nf == 0:
        return F
    states = max(nf, nb + nk - 1)
    pad = max(nf, nk + nb, states) + SLACK
    spans = np.array(((0, 1, nf), (1, nk, nb), (2, 0, states), (0, 0, 1)))
    signals = np.zeros((3, pad + u.size))
    for _ in range(ROUNDS):
        through_pole(F, u, y, signals[:, pad:])
        previous, F = F, stabilise(monic(regression(signals, pad, spans)[:nf]), LARGEST_ROOT, 1.0)
        change = 0.0
        for i in range(nf):
            change = max(change, abs(F[1 + i] - previous[1 + i]))
        if change < SETTLED:
            break
    return F


@compiled(inside=True)
def through_pole(F: FloatArray, u: FloatArray, y: FloatArray, out: FloatArray) -> None:
    """Write y, u and an impulse, each filtered by 1/F, into the three rows of `out`."""
    all_pole_into(F, y, out[0])
    all_pole_into(F, u, out[1])
    out[2] = 0.0
    out[2, 0] = 1.0
    all_pole_into(F, out[2], out[2])


@compiled(inside=True)
def noise_model(
    u: FloatArray, y: FloatArray, F: FloatArray, counts: NDArray[np.int64]
) -> tuple[FloatArray, FloatArray]:
    """C and D for the residuals of the best B/F with this F."""
    nb, nc, nd, nf, nk = counts
    states = max(nf, nb + nk - 1)
    pad = max(nk + nb, states) + SLACK
    signals = np.zeros((3, pad + u.size))
    through_pole(F, u, y, signals[:, pad:])
    copy_into(y, signals[0, pad:])
    spans = np.array(((1, nk, nb), (2, 0, states), (0, 0, 1)))
    found = regression(signals, pad, spans)
    B, one = np.zeros(nk + nb), np.ones(1)
    copy_into(found[:nb], B[nk:])
    rest = errors_of(u, y, Polynomials(B, one, one, F), -found[nb:])
    return hannan_rissanen(rest, nc, nd)


@compiled(inside=True)
def hannan_rissanen(v: FloatArray, nc: int, nd: int) -> tuple[FloatArray, FloatArray]:
    """C and D of an ARMA model D v = C e: innovations from a long autoregression, then one regression."""
    if nc + nd == 0:
        return np.ones(1), np.ones(1)
    length = min(LONG, v.size // 4)
    pad = max(length, nc, nd) + SLACK
    signals = padded(pad, v, v)
    A = monic(regression(signals, pad + length, np.array(((0, 1, length), (0, 0, 1)))))
    fir_into(A, v, signals[1, pad:])
    signals[1, pad : pad + length] = 0.0
    spans = np.array(((0, 1, nd), (1, 1, nc), (0, 0, 1)))
    found = regression(signals, pad + length + nc, spans)
    return stabilise(monic(-found[nd:]), 0.98, 1.0), stabilise(monic(found[:nd]), 0.999, 1.0)
