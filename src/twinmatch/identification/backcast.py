"""The start weighed: initial conditions of the noise filter that stationary noise could have left.

With n = L z, where L Lᵀ is the covariance of the filter's state for innovations of variance 1, the
unconditional sum of squares of Box and Jenkins is Σ e² + ‖z‖²: what backcasting the noise into the
infinite past would sum up. The state s of B/F stays free. Both enter the predictor as m = F n − D s, so
that everything here is a change of columns in the triangles of `Problem`.
"""

from __future__ import annotations

import numpy as np

from twinmatch.identification.kernels import Polynomials, ridge_solve, triangle_of
from twinmatch.identification.order import Order
from twinmatch.identification.prediction import Point, Problem
from twinmatch.signals import FloatArray

__all__ = ["BackcastProblem", "noise_factor"]

RIDGE = 1e-9
STEP = 1e-6
"""Of the difference quotient of L."""


def noise_factor(C: FloatArray, D: FloatArray) -> FloatArray:
    """L, lower triangular: the state n of C/D driven by white noise of variance 1 is L z, z white."""
    from scipy.linalg import solve_discrete_lyapunov  # noqa: PLC0415 — a tenth of a second that few need

    size = max(C.size, D.size) - 1
    if size == 0:
        return np.zeros((0, 0))
    c, d = np.pad(C, (0, size + 1 - C.size))[1:], np.pad(D, (0, size + 1 - D.size))[1:]
    A = np.eye(size, k=1)
    A[:, 0] -= d
    P = solve_discrete_lyapunov(A, np.outer(c - d, c - d))
    # Where C and D share a root its state is never excited: a floor keeps the factor defined.
    P = 0.5 * (P + P.T) + 1e-12 * (1.0 + np.trace(P)) * np.eye(size)
    return np.asarray(np.linalg.cholesky(P))


class BackcastProblem(Problem):
    """The unconditional sum of squares; x = (b, s, z)."""

    exact_curvature = False

    def __init__(self, u: FloatArray, y: FloatArray, order: Order) -> None:
        super().__init__(u, y, order)
        self._m_columns = slice(order.nb, self.linear_size)
        self.s_count, self.z_count = order.process_state, max(order.nc, order.nd)
        nonlinear = self.size - self.linear_size
        self.linear_size = order.nb + self.s_count + self.z_count
        self.size = self.linear_size + nonlinear

    def initial_state(self, point: Point) -> FloatArray:
        """The initial conditions m of the predictor."""
        return self._to_m(point.model) @ point.x[self.order.nb :]

    def evaluate(self, theta: FloatArray, *, exact: bool = False) -> Point:  # noqa: ARG002 (always exact)
        """The best (b, s, z) at θ and the errors they leave."""
        free = super().evaluate(theta, exact=True)
        # The free solution solves the linear part; s and z move m away from it only as far as the
        # penalty asks, so the triangle of the linear columns with zero right-hand side suffices.
        nb, width = self.order.nb, free.x.size
        R = super().triangle(free, exact=True)[:width, :width]
        to_m = self._to_m(free.model)
        columns = np.hstack((R[:, :nb], R[:, self._m_columns] @ to_m))
        penalty = np.zeros((self.z_count, columns.shape[1]))
        penalty[:, nb + self.s_count :] = np.eye(self.z_count)
        x = _least_squares(np.vstack((columns, penalty)), np.append(R @ free.x, np.zeros(self.z_count)))
        shift = np.append(x[:nb], to_m @ x[nb:]) - free.x
        e = free.errors + self._combine(free.signals, shift)
        return self._point(free.model, x, e, free.signals, x[nb + self.s_count :])

    def triangle(self, point: Point, *, exact: bool = False) -> FloatArray:
        """QR triangle of the derivatives of (e, z) by (x, θ), the rotated residual as last column."""
        R = super().triangle(point, exact=exact)
        nb, (nc, nd, nf) = self.order.nb, self.order[1:4]
        m_columns, theta_columns = R[:, self._m_columns], R[:, self._m_columns.stop : -1].copy()
        theta_columns += m_columns @ self._m_by_theta(point, nc, nd, nf)
        rows = np.hstack((R[:, :nb], m_columns @ self._to_m(point.model), theta_columns, R[:, -1:]))
        penalty = np.zeros((self.z_count, rows.shape[1]))
        penalty[:, nb + self.s_count : self.linear_size] = np.eye(self.z_count)
        penalty[:, -1] = point.prior
        return triangle_of(np.vstack((rows, penalty)))

    def _to_m(self, model: Polynomials) -> FloatArray:
        """The matrix from (s, z) to m = F L z − D s."""
        from_s = _shifted(model.D, self.states, self.s_count)
        return np.hstack((-from_s, self._from_n(model.F) @ noise_factor(model.C, model.D)))

    def _from_n(self, F: FloatArray) -> FloatArray:
        return _shifted(F, self.states, self.z_count)

    def _m_by_theta(self, point: Point, nc: int, nd: int, nf: int) -> FloatArray:
        """∂m/∂θ at fixed s and z, shape (states, nc + nd + nf)."""
        model, z = point.model, point.prior
        s = point.x[self.order.nb : self.order.nb + self.s_count]
        L, from_n = noise_factor(model.C, model.D), self._from_n(model.F)
        out = np.zeros((self.states, nc + nd + nf))
        for i in range(nc + nd):
            C, D = model.C.copy(), model.D.copy()
            (C if i < nc else D)[1 + (i if i < nc else i - nc)] += STEP
            out[:, i] = from_n @ ((noise_factor(C, D) - L) @ z) / STEP
        for i in range(nd):
            out[1 + i : 1 + i + s.size, nc + i] -= s
        n = L @ z
        for i in range(nf):
            out[1 + i : 1 + i + n.size, nc + nd + i] += n
        return out

    def _combine(self, signals: FloatArray, x: FloatArray) -> FloatArray:
        """The change of e for a change of (b, m)."""
        total = np.zeros(self.u.size)
        spans = [(int(a), int(k), int(n)) for a, k, n in self._linear[:2]]
        delayed = [(signal, delay + i) for signal, delay, count in spans for i in range(count)]
        for value, (signal, delay) in zip(x, delayed, strict=True):
            total += value * signals[signal, self._pad - delay : self._pad - delay + self.u.size]
        return total


def _shifted(polynomial: FloatArray, rows: int, count: int) -> FloatArray:
    """The polynomial as column j, moved down by j."""
    out = np.zeros((rows, count))
    for j in range(count):
        size = min(polynomial.size, rows - j)
        out[j : j + size, j] = polynomial[:size]
    return out


def _least_squares(A: FloatArray, target: FloatArray) -> FloatArray:
    R = triangle_of(np.column_stack((A, target)))
    size = A.shape[1]
    norms = np.sqrt(np.sum(R[:, :size] ** 2, axis=0))
    return np.asarray(
        ridge_solve(np.ascontiguousarray(R[:size, :size]), R[:size, size].copy(), RIDGE * norms)
    )
