"""Estimating Box–Jenkins models: several starts, one search, and the ladder of nested orders."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.identification.backcast import BackcastProblem
from twinmatch.identification.data import checked_pair
from twinmatch.identification.errors import IdentificationError
from twinmatch.identification.model import BoxJenkins
from twinmatch.identification.order import ORDERS, Order, parse_order
from twinmatch.identification.prediction import Problem
from twinmatch.identification.search import Outcome, search
from twinmatch.identification.start import start_values
from twinmatch.signals import FloatArray

__all__ = ["estimate", "estimate_ladder"]

ROUTE = 50
"""Steps that a start may take; the best is then searched on."""
SPARE = 10
"""Samples a window must have beyond the number of unknowns."""


def estimate(
    u: ArrayLike,
    y: ArrayLike,
    order: str | Sequence[int] = ORDERS[0],
    *,
    initial: str = "estimate",
    start: BoxJenkins | None = None,
    period: float = 1.0,
) -> BoxJenkins:
    """The Box–Jenkins model with the smallest mean squared one-step prediction error.

    Offsets are the caller's business: subtract an operating point, or leave it in and let B/F carry it.
    With estimated initial conditions a window may begin in the middle of a transient.

    C, D and F are stable: roots of D and F stay below 1 − 1e-6, those of C below 1 − 6/N, so that the
    predictor has forgotten its initial conditions by the end of the window. Orders above the second have
    many local minima; `estimate_ladder` climbs to them from below and is the more thorough way.

    Args:
        u: input, shape (N,).
        y: output, shape (N,).
        order: nb, nc, nd, nf, nk, as a string or five integers.
        initial: "estimate" the initial conditions of B/F and of the noise filter along with the
            coefficients; "zero": the data begin at rest; "backcast": those of B/F are estimated, those of
            the noise filter are weighed against what stationary noise would leave (the unconditional
            least squares of Box and Jenkins).
        start: a model of the same or a lower order to start from, beside the usual start values; the
            result is then never worse than it (its C must forget within this window too, see below).
        period: sample time, s; only passed on to the result.

    Returns:
        The model; the same data give the same model to the last bit.

    Raises:
        IdentificationError: wrong order, data that are no pair of signals, an input that does not vary,
            too few samples, or a start of a higher order.
    """
    u, y = checked_pair(u, y)
    parsed = parse_order(order)
    problem = _problem(u, y, parsed, initial)
    thetas = start_values(u, y, parsed)
    if start is not None:
        if not parsed.covers(start.order):
            msg = f"start: a model of order {start.order} cannot start one of order {parsed}"
            raise IdentificationError(msg)
        thetas.append(_padded(start, parsed))
    return _model(problem, _best(problem, thetas), period)


def estimate_ladder(
    u: ArrayLike,
    y: ArrayLike,
    orders: Iterable[str | Sequence[int]] = ORDERS,
    *,
    initial: str = "estimate",
    period: float = 1.0,
) -> dict[str, BoxJenkins]:
    """Models of several orders; one whose order contains an earlier one's never has the greater loss.

    Each starts from the best model below it too, its missing coefficients zero. Give orders from low to
    high. (With `initial="backcast"` it is the weighed sum of squares that never grows.)

    Arguments and errors as for `estimate`; the keys are the orders as strings, in the order given.
    """
    models: dict[str, BoxJenkins] = {}
    for order in orders:
        parsed = parse_order(order)
        below = [model for model in models.values() if parsed.covers(model.order)]
        start = min(below, key=lambda model: model.variance, default=None)
        models[str(parsed)] = estimate(u, y, parsed, initial=initial, start=start, period=period)
    return models


def _problem(u: FloatArray, y: FloatArray, order: Order, initial: str) -> Problem:
    if initial not in ("estimate", "zero", "backcast"):
        msg = f'initial: {initial!r} is unknown; use "estimate", "zero" or "backcast"'
        raise IdentificationError(msg)
    if np.ptp(u) <= 1e-12 * np.max(np.abs(u)):
        msg = f"input u does not vary (it is {u[0]:g} throughout); nothing can be identified from it"
        raise IdentificationError(msg)
    if initial == "backcast":
        problem: Problem = BackcastProblem(u, y, order)
    else:
        problem = Problem(u, y, order, free_start=initial == "estimate")
    if u.size < problem.size + SPARE:
        msg = f"{u.size} samples are too few for order {order}; give at least {problem.size + SPARE}"
        raise IdentificationError(msg)
    return problem


def _padded(model: BoxJenkins, order: Order) -> FloatArray:
    """θ of a lower-order model, its missing coefficients zero."""
    theta = np.zeros(order.nc + order.nd + order.nf)
    theta[: model.order.nc] = model.C[1:]
    theta[order.nc : order.nc + model.order.nd] = model.D[1:]
    theta[order.nc + order.nd :][: model.order.nf] = model.F[1:]
    return theta


def _best(problem: Problem, thetas: list[FloatArray]) -> Outcome:
    """The lowest minimum reached from any start, its last digits from the exact factorisation."""
    best = search(problem, thetas[0], iterations=ROUTE)
    for theta in thetas[1:]:
        other = search(problem, theta, iterations=ROUTE, rival=best.point.cost)
        best = min(best, other, key=lambda outcome: outcome.point.cost)
    polished = search(problem, best.point.theta, exact=True)
    return polished._replace(iterations=best.iterations + polished.iterations)


def _model(problem: Problem, outcome: Outcome, period: float) -> BoxJenkins:
    point = outcome.point
    return BoxJenkins(
        order=problem.order,
        B=point.model.B,
        C=point.model.C,
        D=point.model.D,
        F=point.model.F,
        variance=float(np.mean(point.errors**2)),
        covariance=_covariance(problem, outcome),
        initial_state=problem.initial_state(point),
        n_samples=problem.y.size,
        period=period,
        converged=outcome.converged,
        iterations=outcome.iterations,
    )


def _covariance(problem: Problem, outcome: Outcome) -> FloatArray:
    """σ² (JᵀJ)⁺ of the coefficients, the initial conditions counted as unknowns too."""
    R = problem.triangle(outcome.point, exact=True)[: problem.size, : problem.size]
    norms = np.sqrt(np.sum(R**2, axis=0))
    norms[norms == 0.0] = 1.0
    inverse = np.linalg.pinv(R / norms, rcond=1e-10) / norms[:, np.newaxis]
    noise = outcome.point.cost / (problem.y.size + outcome.point.prior.size - problem.size)
    inverse = np.delete(inverse, slice(problem.order.nb, problem.linear_size), axis=0)
    return np.asarray(noise * (inverse @ inverse.T))
