"""The family of parameter sets matched at different operating points, and Box–Jenkins models of a window:
set-point → output and set-point → input, or input → output where the loop is not known.

Where the paper leaves a choice open, it is made here; `docs/method.md` gives the reasons.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from twinmatch.comparing.graph_symbol import GraphSymbol
from twinmatch.dynamics import SKIPPED, Law, Parameters, Sensor, simulate_window
from twinmatch.fitting import ORDERS, BoxJenkins, estimate_ladder
from twinmatch.signals import FloatArray, OperatingPoint, Window, point_values

LEAD = 20
"""Samples before the first step of a window whose mean is its steady input, as a schedule keeps them."""


class OperatingLevel(NamedTuple):
    """The steady state at the start of a window; models describe deviations from it."""

    output: float
    """Level of the output, in closed loop also of the reference: integral action makes them equal at rest."""
    input: float


@dataclass(frozen=True, eq=False)
class SimoModel:
    """A model from the set-point to y and u of the loop, or, where the loop is not known, from the input u to
    the output y."""

    order: str
    y: BoxJenkins
    """r[k] → y[k], or u[k] → y[k]."""
    u: BoxJenkins | None
    """r[k+1] → u[k]; see `ahead`."""
    scale: float = 1.0
    """Scale of the input over that of the output, for a plant's graph symbol."""
    lead: int = LEAD
    """Samples before the first step of a window from which `operating_level` is taken."""

    @cached_property
    def symbol(self) -> GraphSymbol:
        """Graph symbol for the ν-gap: of [y/r; u/r], y and u in their units, as in the paper; or of y/u,
        scaled."""
        if self.u is None:
            return GraphSymbol.of_fractions(
                [(self.scale * self.y.B, self.y.F)], period=self.y.period
            )
        input_ = self.u.B[1:]  # without the delay that `ahead` put in
        return GraphSymbol.of_fractions(
            [(self.y.B, self.y.F), (input_, self.u.F)], period=self.y.period
        )


def operating_level(
    window: Window, *, driven: bool = False, lead: int = LEAD
) -> OperatingLevel:
    """The level to subtract so that the window begins at zero.

    For reference and output it is the set-point before the first step; for the input the mean of the last
    `lead` samples before that step, when the loop has settled even if the window began in a transient.

    Where the loop is not known, there is no set-point: if the input was constant before its first change, the
    level is the mean of the last samples before that change; if not, the mean over the window.
    """
    moving = window.input if driven else window.reference
    is_moved = moving != moving[0]
    step = int(is_moved.argmax()) if is_moved.any() else len(window)
    if not driven:
        newest_before = window.input[max(0, step - lead) : step]
        return OperatingLevel(float(moving[0]), float(np.mean(newest_before)))
    before = slice(step - lead, step) if step >= lead else slice(None)
    return OperatingLevel(
        float(np.mean(window.output[before])), float(np.mean(window.input[before]))
    )


def deviations(
    window: Window, level: OperatingLevel
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Reference, output and input of a window as deviations from `level`, shape (N,) each."""
    return (
        window.reference - level.output,
        window.output - level.output,
        window.input - level.input,
    )


def ahead(reference: FloatArray) -> FloatArray:
    """The set-point one tick early, shape (N,): the input of the model of u.

    The controller responds to a set-point in the same tick, so u[k] depends on r[k]; orders with nk = 1 have
    no direct feedthrough and would treat the jump of u at a step as noise. Relative to the set-point one tick
    early, the delay is one.
    """
    return np.append(reference[1:], reference[-1])


def identify(
    window: Window,
    orders: Sequence[str] = ORDERS,
    *,
    scale: float | None = None,
    lead: int = LEAD,
) -> tuple[SimoModel, ...]:
    """Box–Jenkins models of every order from a window's set-point to its output and input.

    Where the loop is not known, from its input to its output: then `scale` is the models' scale. `lead` is
    that of the schedule.

    They are the minima next to the start values, not the global ones: on windows of the rig the prediction
    errors of the global minima are only a few per cent smaller, and come from a noise model that explains
    part of the response to the set-point, so that the gains of y and u, and with them the ν-gap, mean little
    (docs/decisions/0015). `identification.estimate` searches for the global minimum.

    Raises:
        FittingError: set-point or input does not move, or there are too few samples.
    """
    r, y, u = deviations(
        window, operating_level(window, driven=scale is not None, lead=lead)
    )
    period = window.period
    if scale is not None:
        ladder = estimate_ladder(u, y, orders, hops=0, period=period)
        return tuple(
            SimoModel(order, ladder[order], None, scale, lead) for order in orders
        )
    # In parallel: both are independent, and almost all of the work is compiled code, which releases the GIL.
    # Nothing else takes long enough (docs/decisions/0167).
    with ThreadPoolExecutor(1) as executor:
        future = executor.submit(
            estimate_ladder, ahead(r), u, orders, hops=0, period=period
        )
        y_models = estimate_ladder(r, y, orders, hops=0, period=period)
    u_models = future.result()
    return tuple(
        SimoModel(order, y_models[order], u_models[order], lead=lead)
        for order in orders
    )


def twin_response(
    parameters: Parameters,
    window: Window,
    law: Law | None,
    sensor: Sensor | None,
    seed: int,
) -> Window:
    """Simulate the twin on a window, in closed loop under its reference, or driven by its input without
    a law, with the sensor.

    It starts at the window's third sample: the first two give the controller's state.
    """
    response = simulate_window(parameters, window, law=law, sensor=sensor, seed=seed)
    return replace(
        window.part(window.first + SKIPPED, window.last),
        outputs=response.outputs,
        inputs=response.inputs,
    )


@dataclass(frozen=True, eq=False)
class Candidate:
    """One parameter set of the family."""

    name: str
    operating_point: OperatingPoint
    """Set-points at the end of the window it was matched on."""
    parameters: Parameters
    window: Window | None
    """The window it was matched on; None if it was given, not matched."""
    free: tuple[str, ...] = ()
    """Names of the parameters that were fitted."""
    covariance: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    """Covariance of these, in their order and units, (n, n); empty if it was given as exact."""
    states: FloatArray | None = None
    """States of its twin at the last samples of the window, shape (N, states), if its fit gave them."""

    @property
    def remembered(self) -> bool:
        """Whether it is what earlier sessions have shown: given, with their spread as covariance."""
        return self.window is None and len(self.covariance) > 0

    @property
    def samples(self) -> tuple[int, int]:
        """First and last sample to which it was fitted; (0, -1) if it was given."""
        return (
            (self.window.first, self.window.last)
            if self.window is not None
            else (0, -1)
        )

    @property
    def known_covariance(self) -> FloatArray | None:
        """The covariance if it can be used; None: the parameters count as exact.

        Where a match left some combination unbounded, the other variances are unusable, too. The width of
        the bands then follows from past errors.
        """
        usable = len(self.covariance) > 0 and bool(np.isfinite(self.covariance).all())
        return self.covariance if usable else None

    def states_at(self, sample: int) -> FloatArray | None:
        """States of its twin at a sample, shape (states,); None where they are unknown."""
        if self.states is None or self.window is None:
            return None
        place = sample - (self.window.last - len(self.states) + 1)
        return self.states[place] if 0 <= place < len(self.states) else None


class Family:
    """At most `most` candidates, one per set-point regime; a newer match of a regime replaces the older."""

    def __init__(self, most: int = 8, regime_width: OperatingPoint = 10.0) -> None:
        """Begin empty; of more than `most` the one matched longest ago is removed. Operating points closer
        than half of `regime_width`, in the output's unit and in that of each of several, belong to one
        regime."""
        self.most = most
        self.regime_width = regime_width
        self._candidates: list[Candidate] = []

    def __len__(self) -> int:
        return len(self._candidates)

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """The candidates in the order of their operating points."""
        return tuple(
            sorted(
                self._candidates,
                key=lambda c: (point_values(c.operating_point), c.name),
            )
        )

    def standing_at(self, operating_point: OperatingPoint) -> Candidate | None:
        """The candidate whose regime contains this operating point, if any."""
        near = []
        for candidate in self._candidates:
            apart = np.abs(np.subtract(candidate.operating_point, operating_point))
            if (apart < np.divide(self.regime_width, 2)).all():
                near.append(
                    (
                        float(np.max(apart / self.regime_width)),
                        candidate.name,
                        candidate,
                    )
                )
        return min(near, key=itemgetter(0, 1))[2] if near else None

    def admit(self, candidate: Candidate) -> Candidate | None:
        """Add a candidate; return the one it replaces, if any."""
        namesakes = [c for c in self._candidates if c.name == candidate.name]
        leaving = (
            namesakes[0] if namesakes else self.standing_at(candidate.operating_point)
        )
        if leaving is None and len(self._candidates) >= self.most:
            leaving = self._candidates[0]
        if leaving is not None:
            self._candidates.remove(leaving)
        self._candidates.append(candidate)
        return leaving

    def dismiss(self, name: str) -> None:
        """Remove the candidate of this name, if present."""
        self._candidates = [c for c in self._candidates if c.name != name]
