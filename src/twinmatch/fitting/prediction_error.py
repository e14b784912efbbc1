"""Estimation of Box–Jenkins models: several starts, a final search, and the ladder of nested orders."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.fitting.data import checked_pair
from twinmatch.fitting.derivatives import linearise
from twinmatch.fitting.descent import Rules, descend
from twinmatch.fitting.errors import IdentificationError
from twinmatch.fitting.hops import Hops
from twinmatch.fitting.model import BoxJenkins
from twinmatch.fitting.order import ORDERS, Order, parse_order
from twinmatch.fitting.prediction import Place, Task, linear_size, task_of, unknowns
from twinmatch.fitting.start import start_values
from twinmatch.signals import FloatArray

__all__ = ["estimate", "estimate_ladder"]

Outcome = tuple[Place, bool, int]
"""Final place of a search, whether it converged, and the number of steps."""

ROUTE = 50
"""Largest number of steps from a start; the search then continues from the best."""
COARSE, FINE = 1e-6, 1e-11
"""`Rules.settled` for the starts, and for the final search."""
LOST = 1e-8
"""Share of the cost by which the two factorisations may differ before the search is repeated with QR."""
WORTH = 1e-4
"""A start that seems to gain less than this share over the best is abandoned."""
HOPS = (36, 108)
"""Fewest and most starts around the best minimum, divided by the number of coefficients of C, D and F: low
orders, with short searches, get more."""
HOPPED = 54000
"""Between these limits, this many samples divided by the window's: long windows cost more."""
LAST = 100
"""Largest number of steps of the final search."""
SPARE = 10
"""Samples a window must have beyond the number of unknowns."""


def estimate(
    u: ArrayLike,
    y: ArrayLike,
    order: str | Sequence[int] = ORDERS[0],
    *,
    initial: str = "estimate",
    start: BoxJenkins | None = None,
    hops: int | None = None,
    period: float = 1.0,
) -> BoxJenkins:
    """Estimate the Box–Jenkins model with the smallest mean squared one-step prediction error.

    Offsets are left to the caller: subtract an operating point, or let B/F describe it. With estimated
    initial conditions a window may begin in the middle of a transient.

    C, D and F are stable: roots of F stay below 1 − 1e-6, those of C and D below 1 − 6/N, so that the
    predictor has forgotten its initial conditions by the end of the window. Orders above the second have
    many local minima; `estimate_ladder` approaches them from lower orders and is more thorough.

    Args:
        u: input, shape (N,).
        y: output, shape (N,).
        order: nb, nc, nd, nf, nk, as a string or five integers.
        initial: "estimate": estimate the initial conditions of B/F and of the noise filter with the
            coefficients; "zero": the data begin at rest.
        start: a model of the same or a lower order as additional start; the result is then never worse
            than it (if its C meets the bound on roots for this window).
        hops: number of additional starts around the best minimum, 0 or more; default 18, 12, 9, 7 for the
            orders of the ladder up to 500 samples, down to a third for longer windows. Each costs about as
            much as one of the usual starts; more of them come nearer to the global minimum.
        period: sample time, s; only stored in the result.

    Returns:
        The model; the same data give the same model to the last bit.

    Raises:
        IdentificationError: invalid order or signals, an input that does not vary, too few samples, a
            start of a higher order, or a negative number of hops.
    """
    u, y = checked_pair(u, y)
    parsed = parse_order(order)
    task = _task(u, y, parsed, initial)
    if hops is None:
        shared = min(max(HOPPED // u.size, HOPS[0]), HOPS[1])
        hops = shared // max(parsed.nc + parsed.nd + parsed.nf, 1)
    if hops < 0:
        msg = f"hops: {hops} starts requested; give 0 or more"
        raise IdentificationError(msg)
    thetas = list(start_values(u, y, task.counts))
    if start is not None:
        if not parsed.covers(start.order):
            msg = (
                f"start: a model of order {start.order} cannot start one of order {parsed}; give a lower one"
            )
            raise IdentificationError(msg)
        # Inserted first: the lower the cost to beat, the sooner the other starts are abandoned.
        thetas.insert(0, _padded(start, parsed))
    return _model(task, parsed, _best(task, parsed, thetas, hops), period)


def estimate_ladder(
    u: ArrayLike,
    y: ArrayLike,
    orders: Iterable[str | Sequence[int]] = ORDERS,
    *,
    initial: str = "estimate",
    hops: int | None = None,
    period: float = 1.0,
) -> dict[str, BoxJenkins]:
    """Estimate several orders; a model whose order contains an earlier one's never has the larger loss.

    Each is also started from the best model of a lower order, with missing coefficients set to zero. Give
    orders from low to high.

    Arguments and errors as for `estimate`; the keys are the orders as strings, in the given order.
    """
    models: dict[str, BoxJenkins] = {}
    for order in orders:
        parsed = parse_order(order)
        below = [model for model in models.values() if parsed.covers(model.order)]
        start = min(below, key=lambda model: model.variance, default=None)
        models[str(parsed)] = estimate(u, y, parsed, initial=initial, start=start, hops=hops, period=period)
    return models


def _task(u: FloatArray, y: FloatArray, order: Order, initial: str) -> Task:
    task = task_of(u, y, order, initial)
    if np.ptp(u) <= 1e-12 * np.max(np.abs(u)):
        msg = f"input u is constant ({u[0]:g}); nothing can be identified from it"
        raise IdentificationError(msg)
    if u.size < unknowns(task) + SPARE:
        msg = f"{u.size} samples are too few for order {order}; give at least {unknowns(task) + SPARE}"
        raise IdentificationError(msg)
    return task


def _padded(model: BoxJenkins, order: Order) -> FloatArray:
    """θ of a lower-order model, its missing coefficients zero."""
    theta = np.zeros(order.nc + order.nd + order.nf)
    theta[: model.order.nc] = model.C[1:]
    theta[order.nc : order.nc + model.order.nd] = model.D[1:]
    theta[order.nc + order.nd :][: model.order.nf] = model.F[1:]
    return theta


def _best(task: Task, order: Order, thetas: list[FloatArray], hops: int) -> Outcome:
    """The lowest minimum from all starts, refined with the exact factorisation."""
    best, _, steps = descend(task, thetas[0], Rules(ROUTE, COARSE))
    around = Hops(order)
    for k in range(1, len(thetas) + (hops if around.possible else 0)):
        theta = thetas[k] if k < len(thetas) else around.from_model(best.theta)
        other, _, taken = descend(task, theta, Rules(ROUTE, COARSE, best.cost * (1.0 - WORTH)))
        if other.cost < best.cost:
            best, steps = other, taken
    best, converged, taken = descend(task, best.theta, Rules(LAST, FINE))
    steps += taken
    polished, _, _ = descend(task, best.theta, Rules(0, FINE, exact=True))
    if abs(polished.cost - best.cost) > LOST * best.cost:  # the normal equations had lost digits
        polished, converged, taken = descend(task, best.theta, Rules(LAST, FINE, exact=True))
        steps += taken
    return polished, converged, steps


def _model(task: Task, order: Order, outcome: Outcome, period: float) -> BoxJenkins:
    place, converged, steps = outcome
    return BoxJenkins(
        order=order,
        B=place.model.B,
        C=place.model.C,
        D=place.model.D,
        F=place.model.F,
        variance=float(np.mean(place.errors**2)),
        covariance=_covariance(task, place),
        initial_state=place.x[order.nb :],
        n_samples=task.y.size,
        period=period,
        converged=converged,
        iterations=steps,
    )


def _covariance(task: Task, place: Place) -> FloatArray:
    """σ² (JᵀJ)⁺ of the coefficients, with the initial conditions as further unknowns."""
    size = unknowns(task)
    R = linearise(task, place, True)[:size, :size]
    norms = np.sqrt(np.sum(R**2, axis=0))
    norms[norms == 0.0] = 1.0
    inverse = np.linalg.pinv(R / norms, rcond=1e-10) / norms[:, np.newaxis]
    noise = place.cost / (task.y.size - size)
    inverse = np.delete(inverse, slice(int(task.counts[0]), linear_size(task)), axis=0)
    return np.asarray(noise * (inverse @ inverse.T))
