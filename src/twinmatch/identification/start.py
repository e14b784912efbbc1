"""Start values for the search, from routes that fail for different reasons.

1. A long ARX model whitens the data; Steiglitz–McBride on the whitened data gives B/F (the
   Box–Jenkins Steiglitz–McBride method of Y. Zhu, efficient even in closed loop).
2. Steiglitz–McBride on the raw data: the output-error model, blind to the noise.
3. An ARX model of the wanted order: one denominator for both parts.

The noise part C/D of routes 1 and 2 is the ARMA model of what B/F leaves, by Hannan–Rissanen.
"""

from __future__ import annotations

import numpy as np

from twinmatch.identification.kernels import (
    LARGEST_ROOT,
    Polynomials,
    all_pole,
    cholesky,
    column_norms,
    correlate,
    errors_of,
    fir,
    ridge_solve,
    stabilise,
)
from twinmatch.identification.order import Order
from twinmatch.signals import FloatArray

__all__ = ["start_values"]

LONG = 20
"""Order of the long autoregressions, where the window is long enough for it."""
ROUNDS = 8
"""Rounds of Steiglitz–McBride; it settles in a few or not at all."""
RIDGE = 1e-9


def start_values(u: FloatArray, y: FloatArray, order: Order) -> list[FloatArray]:
    """Candidates for θ = (c, d, f), each stable, in a fixed order."""
    whitener = long_arx(u, y, order.nk)
    skip = whitener.size - 1
    thetas = []
    white_u, white_y = fir(whitener, u)[skip:], fir(whitener, y)[skip:]
    for input_, output in ((white_u, white_y), (u, y)):
        F = steiglitz_mcbride(input_, output, order)
        C, D = noise_model(u, y, F, order)
        thetas.append(np.concatenate((C[1:], D[1:], F[1:])))
    A = arx_denominator(u, y, order)
    shared = np.zeros(order.nd)
    shared[: min(order.nd, order.nf)] = A[1 : 1 + min(order.nd, order.nf)]
    thetas.append(np.concatenate((np.zeros(order.nc), shared, A[1 : 1 + order.nf])))
    return thetas


def regression(signals: list[FloatArray], columns: list[tuple[int, int, int]], first: int) -> FloatArray:
    """Least squares of `signals[0]` on delayed signals, each group (signal, first delay, count)."""
    pad = max(delay + count for _, delay, count in columns) + 1
    padded = np.zeros((len(signals), pad + signals[0].size))
    padded[:, pad:] = signals
    R = cholesky(correlate(padded, pad + first, np.array([*columns, (0, 0, 1)], dtype=np.int64)))
    size = R.shape[0] - 1
    damping = RIDGE * column_norms(R)[:size]
    return ridge_solve(R[:size, :size].copy(), R[:size, size].copy(), damping)


def long_arx(u: FloatArray, y: FloatArray, delay: int) -> FloatArray:
    """The denominator A of a long ARX model: 1/A is close to the noise filter C/D."""
    length = min(LONG, u.size // 8)
    found = regression([y, u], [(0, 1, length), (1, delay, length)], length + delay)
    return np.concatenate((np.ones(1), -found[:length]))


def arx_denominator(u: FloatArray, y: FloatArray, order: Order) -> FloatArray:
    """The denominator of the ARX model of the order of F."""
    if order.nf == 0:
        return np.ones(1)
    spans = [(0, 1, order.nf), (1, order.nk, order.nb)]
    found = regression([y, u], spans, max(order.nf, order.nk + order.nb - 1))
    return stabilise(np.concatenate((np.ones(1), -found[: order.nf])), LARGEST_ROOT, 1.0)


def steiglitz_mcbride(u: FloatArray, y: FloatArray, order: Order) -> FloatArray:
    """F of the output-error model by iterated prefiltering, the initial conditions estimated along."""
    if order.nf == 0:
        return np.ones(1)
    impulse = np.zeros(u.size)
    impulse[0] = 1.0
    F = np.ones(1)
    spans = [(0, 1, order.nf), (1, order.nk, order.nb), (2, 0, order.process_state)]
    for _ in range(ROUNDS):
        signals = [np.asarray(all_pole(F, x)) for x in (y, u, impulse)]
        found = regression(signals, spans, 0)
        previous, F = F, stabilise(np.concatenate((np.ones(1), -found[: order.nf])), LARGEST_ROOT, 1.0)
        if previous.size == F.size and np.max(np.abs(F - previous)) < 1e-4:
            break
    return F


def noise_model(u: FloatArray, y: FloatArray, F: FloatArray, order: Order) -> tuple[FloatArray, FloatArray]:
    """C and D of what the best B/F with this F leaves of y."""
    impulse = np.zeros(u.size)
    impulse[0] = 1.0
    spans = [(1, order.nk, order.nb), (2, 0, order.process_state)]
    found = regression([y, all_pole(F, u), all_pole(F, impulse)], spans, 0)
    B = np.concatenate((np.zeros(order.nk), found[: order.nb]))
    one = np.ones(1)
    rest = errors_of(u, y, Polynomials(B, one, one, F), -found[order.nb :])
    return hannan_rissanen(rest, order.nc, order.nd)


def hannan_rissanen(v: FloatArray, nc: int, nd: int) -> tuple[FloatArray, FloatArray]:
    """C and D of an ARMA model D v = C e: innovations from a long autoregression, then one regression."""
    if nc + nd == 0:
        return np.ones(1), np.ones(1)
    length = min(LONG, v.size // 4)
    A = np.concatenate((np.ones(1), -regression([v], [(0, 1, length)], length)))
    innovations = fir(A, v)
    innovations[:length] = 0.0
    found = regression([v, innovations], [(0, 1, nd), (1, 1, nc)], length + nc)
    C = np.concatenate((np.ones(1), found[nd:]))
    D = np.concatenate((np.ones(1), -found[:nd]))
    return stabilise(C, 0.98, 1.0), stabilise(D, 0.999, 1.0)
