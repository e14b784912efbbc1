"""Box–Jenkins models and their estimation: several starts, a final search, the ladder of nested orders."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.fitting.data import (
    ORDERS,
    FittingError,
    Order,
    checked_pair,
    checked_signal,
    parse_order,
)
from twinmatch.fitting.descent import Rules, descend
from twinmatch.fitting.polynomials import continue_outputs
from twinmatch.fitting.prediction import (
    Place,
    Polynomials,
    Task,
    errors_of,
    linear_size,
    linearise,
    smallest_errors,
    task_of,
    unknowns,
)
from twinmatch.fitting.starts import Hops, start_values
from twinmatch.signals import FloatArray

Outcome = tuple[Place, bool, int]
"""Final place of a search, whether it converged, and the number of steps."""

ROUTE = 50
"""Largest number of steps from a start; the search then continues from the best."""
COARSE = 1e-6
"""`Rules.settled` for the starts."""


class Ends(NamedTuple):
    """When the searches for a model end."""

    faith: float
    """`Rules.faith` of all starts but the first."""
    fine: float
    """`Rules.settled` for the final search."""
    lost: float
    """Share of the cost by which the two factorisations may differ before the search is repeated with QR."""


THOROUGH: Final = Ends(faith=5.0, fine=1e-11, lost=1e-8)
EARLY: Final = Ends(faith=2.0, fine=1e-8, lost=1e-6)
"""Without hops, for orders with a higher degree than `CLEAR`."""
CLEAR: Final = 3
"""Highest degree of C, D and F with which the data of a window, and not their last bits, decide into which of
several minima a search falls."""
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


@dataclass(frozen=True, eq=False)
class BoxJenkins:
    """y(t) = B(q)/F(q) u(t) + C(q)/D(q) e(t), polynomials in q⁻¹, one sample per `period`."""

    order: Order
    """nb, nc, nd, nf, nk."""
    B: FloatArray
    """Numerator with its nk leading zeros, shape (nk + nb,)."""
    C: FloatArray
    """Monic numerator of the noise, shape (nc + 1,)."""
    D: FloatArray
    """Monic denominator of the noise, shape (nd + 1,)."""
    F: FloatArray
    """Monic denominator, shape (nf + 1,)."""
    variance: float
    """V, mean squared one-step prediction error of the data it was estimated on; NaN when unknown."""
    initial_state: FloatArray
    """Initial conditions of the predictor on those data: m of C F e = D F y − D B u + Σ mⱼ δ(t−j)."""
    n_samples: int
    """N of those data; 0 for a model that was not estimated."""
    period: float = 1.0
    """Sample time, s."""
    converged: bool = True
    """Whether the search converged."""
    iterations: int = 0
    """Steps taken by the best search."""
    found: tuple[Task, Place] | None = None
    """Where the search ended; None for a model that was not estimated."""

    def __post_init__(self) -> None:
        for name in ("B", "C", "D", "F", "initial_state"):
            values = np.array(getattr(self, name), dtype=np.float64)
            values.flags.writeable = False
            object.__setattr__(self, name, values)

    @property
    def polynomials(self) -> Polynomials:
        """B, C, D and F, as writable copies: kernels are compiled only for those."""
        return Polynomials(self.B.copy(), self.C.copy(), self.D.copy(), self.F.copy())

    @property
    def coefficients(self) -> FloatArray:
        """The free coefficients in the order of `covariance`, shape (n_parameters,)."""
        return np.concatenate(
            (self.B[self.order.nk :], self.C[1:], self.D[1:], self.F[1:])
        )

    @property
    def n_parameters(self) -> int:
        """Number of coefficients; initial conditions are not counted."""
        return self.order.coefficients

    @cached_property
    def covariance(self) -> FloatArray:
        """Covariance of the coefficients in the order B (without its zeros), C, D, F (without their ones);
        NaN for a model that was not estimated.

        It is σ² (JᵀJ)⁺, with the initial conditions as further unknowns.
        """
        if self.found is None:
            return np.full((self.n_parameters, self.n_parameters), math.nan)
        task, place = self.found
        size = unknowns(task)
        R = linearise(task, place, True)[:size, :size]
        norms = np.sqrt(np.sum(R**2, axis=0))
        norms[norms == 0.0] = 1.0
        inverse = np.linalg.pinv(R / norms, rcond=1e-10) / norms[:, np.newaxis]
        noise = place.cost / (task.y.size - size)
        inverse = np.delete(inverse, slice(self.order.nb, linear_size(task)), axis=0)
        return np.asarray(noise * (inverse @ inverse.T))

    @property
    def standard_errors(self) -> FloatArray:
        """One standard deviation of each of `coefficients`, shape (n_parameters,)."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    def simulate(self, u: ArrayLike, *, outputs: ArrayLike = ()) -> FloatArray:
        """The output of B/F alone for input u, without noise; shape (N,).

        It starts from rest, or from recorded outputs: then the first len(outputs) samples are `outputs`
        and the difference equation continues from them. The paper's information gain copies len(F) samples
        in this way.

        Raises:
            FittingError: u is not a valid signal, or outputs are longer than u.
        """
        input_ = checked_signal(u, "input u")
        recorded = np.array(outputs, dtype=np.float64, ndmin=1)
        if recorded.size > input_.size:
            msg = f"simulate: {recorded.size} recorded outputs for {input_.size} inputs; give at most as many"
            raise FittingError(msg)
        return np.asarray(
            continue_outputs(self.B.copy(), self.F.copy(), input_, recorded)
        )

    def prediction_errors(
        self, u: ArrayLike, y: ArrayLike, initial: str | ArrayLike = "estimate"
    ) -> FloatArray:
        """One-step prediction errors on any data; shape (N,).

        Args:
            u: input, shape (N,).
            y: output, shape (N,).
            initial: "estimate" (initial conditions by least squares on these data), "zero" (rest), or
                initial conditions such as `initial_state`.

        Raises:
            FittingError: invalid signals, or an unknown `initial`.
        """
        u, y = checked_pair(u, y)
        if not isinstance(initial, str):
            m = np.array(initial, dtype=np.float64)
        elif initial == "estimate":
            return np.asarray(
                smallest_errors(u, y, self.polynomials, self.order.predictor_state)
            )
        elif initial == "zero":
            m = np.zeros(0)
        else:
            raise FittingError(
                f'initial: {initial!r} is unknown; use "estimate", "zero" or an array'
            )
        return np.asarray(errors_of(u, y, self.polynomials, m))

    def loss(
        self, u: ArrayLike, y: ArrayLike, initial: str | ArrayLike = "estimate"
    ) -> float:
        """Mean squared prediction error on any data; arguments as for `prediction_errors`."""
        return float(np.mean(self.prediction_errors(u, y, initial) ** 2))


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
        FittingError: invalid order or signals, an input that does not vary, too few samples, a
            start of a higher order, or a negative number of hops.
    """
    u, y = checked_pair(u, y)
    parsed = parse_order(order)
    task = _task(u, y, parsed, initial)
    if start is not None and not parsed.covers(start.order):
        raise FittingError(
            f"start: a model of order {start.order} cannot start one of order {parsed}; give a lower one"
        )
    (thetas,) = _starts(u, y, [parsed])
    return _estimated(task, parsed, thetas, start, hops=hops, period=period)


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
    u, y = checked_pair(u, y)
    parsed_orders = [parse_order(order) for order in orders]
    tasks = [_task(u, y, order, initial) for order in parsed_orders]
    starts = _starts(u, y, parsed_orders)
    models: dict[str, BoxJenkins] = {}
    for order, task, thetas in zip(parsed_orders, tasks, starts, strict=True):
        below = [model for model in models.values() if order.covers(model.order)]
        start = min(below, key=lambda model: model.variance, default=None)
        models[str(order)] = _estimated(
            task, order, thetas, start, hops=hops, period=period
        )
    return models


def _starts(
    u: FloatArray, y: FloatArray, orders: Sequence[Order]
) -> list[list[FloatArray]]:
    """The starts that the window gives for every order."""
    if not orders:
        return []
    thetas_of_orders = start_values(u, y, np.array(orders, dtype=np.int64))
    return [
        [theta[: order.nc + order.nd + order.nf].copy() for theta in thetas]
        for order, thetas in zip(orders, thetas_of_orders, strict=True)
    ]


def _estimated(
    task: Task,
    order: Order,
    thetas: list[FloatArray],
    start: BoxJenkins | None,
    *,
    hops: int | None,
    period: float,
) -> BoxJenkins:
    """The model of this order, from `start` and from other starts θ."""
    if hops is None:
        shared = min(max(HOPPED // task.u.size, HOPS[0]), HOPS[1])
        hops = shared // max(order.nc + order.nd + order.nf, 1)
    if hops < 0:
        raise FittingError(f"hops: {hops} starts requested; give 0 or more")
    if start is not None:
        # First: the lower the cost to beat, the sooner the other starts are abandoned.
        thetas = [_pad(start, order), *thetas]
    return _model(task, order, _best(task, order, thetas, hops), period)


def _task(u: FloatArray, y: FloatArray, order: Order, initial: str) -> Task:
    task = task_of(u, y, order, initial)
    if np.ptp(u) <= 1e-12 * np.max(np.abs(u)):
        raise FittingError(
            f"input u is constant ({u[0]:g}); nothing can be identified from it"
        )
    if u.size < unknowns(task) + SPARE:
        msg = f"{u.size} samples are too few for order {order}; give at least {unknowns(task) + SPARE}"
        raise FittingError(msg)
    return task


def _pad(model: BoxJenkins, order: Order) -> FloatArray:
    """θ of a lower-order model, its missing coefficients zero."""
    theta = np.zeros(order.nc + order.nd + order.nf)
    theta[: model.order.nc] = model.C[1:]
    theta[order.nc : order.nc + model.order.nd] = model.D[1:]
    theta[order.nc + order.nd :][: model.order.nf] = model.F[1:]
    return theta


def _best(task: Task, order: Order, thetas: list[FloatArray], hops: int) -> Outcome:
    """The lowest minimum from all starts, refined with the exact factorisation."""
    ends = _ends(order, hops)
    best, _, steps = descend(task, thetas[0], Rules(ROUTE, COARSE))
    around = Hops(order)
    for k in range(1, len(thetas) + (hops if around.possible else 0)):
        theta = thetas[k] if k < len(thetas) else around.from_model(best.theta)
        rival = best.cost * (1.0 - WORTH)
        retried, _, steps_taken = descend(
            task, theta, Rules(ROUTE, COARSE, rival, faith=ends.faith)
        )
        if retried.cost < best.cost:
            best = retried
            steps = steps_taken
    best, converged, steps_taken = descend(task, best.theta, Rules(LAST, ends.fine))
    steps += steps_taken
    polished, _, _ = descend(task, best.theta, Rules(0, ends.fine, exact=True))
    if abs(polished.cost - best.cost) > ends.lost * best.cost:
        # the normal equations had lost digits
        polished, converged, steps_taken = descend(
            task, best.theta, Rules(LAST, ends.fine, exact=True)
        )
        steps += steps_taken
    return polished, converged, steps


def _ends(order: Order, hops: int) -> Ends:
    """When the searches for a model of this order end; hops are for the global minimum."""
    is_clear = max(order.nc, order.nd, order.nf) <= CLEAR
    return THOROUGH if is_clear or hops > 0 else EARLY


def _model(task: Task, order: Order, outcome: Outcome, period: float) -> BoxJenkins:
    place, converged, steps = outcome
    return BoxJenkins(
        order=order,
        B=place.model.B,
        C=place.model.C,
        D=place.model.D,
        F=place.model.F,
        variance=float(np.mean(place.errors**2)),
        initial_state=place.x[order.nb :],
        n_samples=task.y.size,
        period=period,
        converged=converged,
        iterations=steps,
        found=(task, place),
    )
