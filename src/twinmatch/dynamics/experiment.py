"""A recorded window as a function of the plant's unknowns, with exact tangents."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.dynamics.declarations import PlantError
from twinmatch.dynamics.descent import Descended, new_search, search_result
from twinmatch.dynamics.plant import Parameters
from twinmatch.dynamics.runs import LeastSquares, RunData, Start, Tangents
from twinmatch.dynamics.simulation import (
    FROM_PLANT_FILE,
    SKIPPED,
    LoopLaw,
    Response,
    law_code,
    law_for,
    n_references,
    signal_rows,
)
from twinmatch.signals import FloatArray, Window

_COARSE = 0.5
"""Longest step of a coarse run, in units of the fastest time constant."""


class Known(NamedTuple):
    """Prior knowledge of a parameter."""

    expected: float
    """Expected value, in the parameter's unit."""
    pull: float
    """Weight of its squared distance from that in the cost, in 1/unit²."""


class Experiment:
    """The twin on one window: in closed loop if the controller is known, otherwise driven by the recorded u.

    The closed-loop twin gets the window's reference from the third sample on, because the first two determine
    the controller's state; the driven twin starts there, too. The unknowns are parameters, then gains of the
    controller, then initial states; all other states start at the plant file's values.
    """

    def __init__(
        self,
        base: Parameters,
        free: Sequence[str],
        window: Window,
        *,
        free_starts: Sequence[str] = (),
        free_gains: Sequence[str] = (),
        law: LoopLaw = FROM_PLANT_FILE,
        weights: Sequence[float] | None = None,
        robust: bool = False,
        settle: int = 0,
        coarse: bool = False,
        beforehand: Mapping[str, Known] | None = None,
    ) -> None:
        """Set up the experiment.

        Args:
            base: values of all other parameters.
            free: names of the unknown parameters of the structure.
            window: recorded samples.
            free_starts: names of the states whose initial value is unknown.
            free_gains: names of the controller's unknown gains, such as "proportional" of a PID. Its state at
                the start is that of the given gains.
            law: the running controller, None for the driven twin; default: the plant file's, at the
                window's period.
            weights: weights of the residuals of outputs and inputs in the normal equations, shape (o + m,);
                default: 1.
            robust: let large residuals count linearly instead of quadratically.
            settle: number of samples after the start that are ignored.
            coarse: use steps as long as half the fastest time constant, for structures with fast parts; the
                error is a hundredth of a per cent of the fast part's contribution.
            beforehand: prior knowledge of free parameters, by name.

        Raises:
            PlantError: an unknown name, fewer than three samples, or a controller of another period.
        """
        model = base.model
        if len(window) <= SKIPPED:
            msg = f"{model.title}: the window has {len(window)} samples; the twin starts at the third"
            raise PlantError(msg)
        loop = law_for(model.plant, window.period, law)
        gains = {} if loop is None else loop.GAINS
        _require_known(model.title, free, model.names)
        _require_known(model.title, free_gains, gains)
        _require_known(model.title, free_starts, model.states)
        self.model = model
        self.base = base
        self.window = window
        self.free = tuple(free)
        self.free_starts = tuple(free_starts)
        self.free_gains = tuple(free_gains)
        self.closed = loop is not None
        if loop is not None:
            loop.require_period(window.period)
        code, memory = law_code(loop, None if loop is None else loop.state(window))
        references = window.inputs if loop is None else window.references
        columns = n_references(model.plant, loop)
        all_measured = np.concatenate([window.outputs, window.inputs], axis=1)
        self.measured = all_measured[SKIPPED:].T.copy()
        self._kernels = model.kernels_by(self.free)
        tuned = [gains[name] for name in self.free_gains]
        self._data = RunData(
            which=_indices(self._kernels.UNKNOWN, self.free),
            tuned=np.array(tuned, dtype=np.int64),
            memory=memory,
            references=signal_rows(
                model.title, "reference", references[SKIPPED:], columns
            ),
            disturbances=model.disturbance_rows(window.disturbances, len(window))[
                SKIPPED:
            ],
            measured=self.measured,
            weights=self._weights_by_sample(weights, settle),
            robust=bool(robust),
            period=float(window.period),
        )
        expected, pull = self._prior(beforehand or {})
        # an instant output follows from the input of its own sample, any other from the one before
        inputs_before = window.inputs[SKIPPED - (not model.instant)]
        self._problem = LeastSquares(
            data=self._data,
            base=base.vector,
            places=_indices(model.names, self.free),
            started=_indices(model.states, self.free_starts),
            first=model.row_of("outputs", window.outputs[SKIPPED]),
            inputs_before=model.row_of("inputs", inputs_before),
            law=code,
            default_disturbances=model.disturbances,
            corners=model.corners,
            drives=model.drives,
            rate_limit=_COARSE if coarse else self._kernels.RATE_LIMIT,
            expected=expected,
            pull=pull,
        )

    def _weights_by_sample(
        self, weights: Sequence[float] | None, settle: int
    ) -> FloatArray:
        """Weights of all residuals, shape (o + m, N): 0 while the plant settles, and of lost samples."""
        signals, samples = self.measured.shape
        of_signals = np.ones(signals) if weights is None else np.array(weights, float)
        by_sample = np.repeat(of_signals[:, None], samples, 1)
        by_sample[:, :settle] = 0.0
        if self.window.seen is not None:
            by_sample[:, ~self.window.seen[SKIPPED:]] = 0.0
        return by_sample

    def _prior(self, beforehand: Mapping[str, Known]) -> tuple[FloatArray, FloatArray]:
        """Expected values of the unknowns and the weights of their squared distances, shape (n,) each."""
        expected, pull = np.zeros((2, self.size))
        for name, known in beforehand.items():
            place = self.free.index(name)
            expected[place] = known.expected
            pull[place] = known.pull
        return expected, pull

    @property
    def controller(self) -> FloatArray:
        """State of the controller at the start, shape (q,)."""
        return self._data.memory.copy()

    @property
    def pull(self) -> FloatArray:
        """Weight of the prior of each free parameter in the cost, shape (n,)."""
        return self._problem.pull[: len(self.free)].copy()

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.free) + len(self.free_gains) + len(self.free_starts)

    def parameters_at(self, values: FloatArray) -> Parameters:
        """The plant with these values of the unknowns, shape (n,)."""
        return self.base.replace(**dict(zip(self.free, values.tolist(), strict=False)))

    def starts_at(self, values: FloatArray) -> dict[str, float]:
        """The unknown initial states, by name."""
        return dict(
            zip(
                self.free_starts,
                values[self.size - len(self.free_starts) :].tolist(),
                strict=True,
            )
        )

    def values_of(self, parameters: Parameters) -> FloatArray:
        """The unknowns, shape (n,): given parameters, the given gains, the plant file's initial states."""
        initial, _, _ = self._initial(parameters.vector)
        named = [parameters[name] for name in self.free]
        gains = self._problem.law[self._data.tuned]
        return np.array(
            [*named, *gains, *initial[self._problem.started]], dtype=np.float64
        )

    def simulate(self, values: FloatArray) -> Response:
        """Run without derivatives, from the third sample on."""
        start = self._start(values)
        data = self._data
        still = np.zeros((self.measured.shape[1], self._problem.first.size))
        never = np.zeros(self.measured.shape[1], dtype=np.bool_)
        outputs, inputs, states = self._kernels.run(
            start.vector,
            start.x,
            start.law,
            data.memory,
            data.references,
            data.disturbances,
            still,
            never,
            0.0,
            data.period,
            start.steps,
        )
        return Response(outputs, inputs, states, start.steps)

    def normal(
        self, values: FloatArray, most: float = math.inf
    ) -> tuple[float, FloatArray, FloatArray]:
        """Cost, gradient Jᵀr, shape (n,), and JᵀJ, shape (n, n), of the weighed residuals.

        The cost is their sum of squares, or Σ 2(√(1 + r²) − 1) if robust, with rows weighted by 1/√(1 + r²);
        infinite where the plant is too fast for the period. A run ends where its cost comes above `most`; then
        the figures are those of the samples until there.
        """
        # a search that ends with its first point: a kernel of its own would be compiled, too
        unbounded = np.full(values.size, np.inf)
        search = new_search(values, -unbounded, unbounded, unbounded, 1)
        search.best[0] = most
        self._kernels.search(self._problem, search)
        return float(search.best[0]), search.gradient, search.hessian

    def scores(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What every sample adds to the gradient Jᵀr of `normal`, shape (N − 2, n), and the slope of their
        sum, shape (n, n): robust residuals weigh 1/(1 + r²)^(3/2) in it, less than in JᵀJ."""
        tangents = self.tangents(values)
        response = self.simulate(values)
        weights = self._data.weights
        simulated = np.concatenate([response.outputs, response.inputs], axis=1).T
        residuals = (self.measured - simulated) * weights
        squares = (
            np.square(residuals) if self._data.robust else np.zeros_like(residuals)
        )
        rows = -tangents.by[:, :, : values.size] * weights[:, :, None]
        if not self.closed:
            rows[len(self._problem.first) :] = 0.0
        scores = np.einsum("sk,skn->kn", residuals / np.sqrt(1.0 + squares), rows)
        slope = np.einsum(
            "sk,ski,skj->ij", (1.0 + squares) ** -1.5, rows, rows, optimize=True
        )
        return np.asarray(scores), np.asarray(slope)

    def descend(  # noqa: PLR0917
        self,
        start: FloatArray,
        lower: FloatArray,
        upper: FloatArray,
        scales: FloatArray,
        most_evaluations: int,
        found: Descended | None = None,
        settled: float = 0.0,
    ) -> Descended:
        """Minimise the cost from one start inside the bounds, like `twinmatch.dynamics.descend`."""
        search = new_search(
            start, lower, upper, scales, most_evaluations, found, settled
        )
        self._kernels.search(self._problem, search)
        return search_result(search, found)

    def tangents(self, values: FloatArray) -> Tangents:
        """Run with all derivatives."""
        tangents: Tangents
        tangents, _ = self._kernels.run_with_tangents(
            self._start(values), self._data, True, np.inf
        )
        return tangents

    @cached_property
    def start_slope(self) -> FloatArray:
        """Derivatives of the initial states by the first outputs, shape (nx, o); zero for unknown ones."""
        slope = self._initial(self.base.vector)[1]
        slope[self._problem.started] = 0.0
        return np.asarray(slope, dtype=np.float64)

    def _initial(self, vector: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        initial: tuple[FloatArray, FloatArray, FloatArray] = self._kernels.begin(
            vector,
            self._problem.first,
            self._problem.inputs_before,
            self._data.disturbances[0],
        )
        return initial

    def _start(self, values: FloatArray) -> Start:
        start: Start = self._kernels.start_at(self._problem, values)
        if start.steps > self._kernels.MAX_STEPS:
            self.model.steps(start.vector, self.window.period)  # raises the error
        return start


def _require_known(title: str, names: Sequence[str], known: Collection[str]) -> None:
    """Raise if one of the names is not among the known ones."""
    unknown = [name for name in names if name not in known]
    if unknown:
        msg = f"{title}: {unknown[0]!r} cannot be free; there are {', '.join(known)}"
        raise PlantError(msg)


def sensitivities(
    parameters: Parameters,
    free: Sequence[str],
    inputs: FloatArray,
    states: FloatArray,
    *,
    period: float,
    disturbances: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Outputs under inputs, shape (N, m), from known states on, and their exact derivatives by the parameters
    in `free`; shapes (N, o) and (N, o, n). Disturbances have shape (N, d), the period is in s.

    Raises:
        PlantError: the plant is too fast for the period.
    """
    model = parameters.model
    kernels = parameters.model.kernels_by(free)
    unread = np.zeros((len(model.plant.outputs) + len(model.plant.drives), len(inputs)))
    code, memory = law_code(None)
    none = np.zeros(0, dtype=np.int64)
    references = np.ascontiguousarray(inputs)
    known_disturbances = np.ascontiguousarray(disturbances)
    free_places = _indices(kernels.UNKNOWN, free)
    data = RunData(
        free_places,
        none,
        memory,
        references,
        known_disturbances,
        unread,
        unread,
        False,
        float(period),
    )
    columns = np.zeros((states.size, len(free)))
    start = Start(
        parameters.vector, code, states.copy(), columns, parameters.steps(period)
    )
    tangents, _ = kernels.run_with_tangents(start, data, True, np.inf)
    derivatives = tangents.by[: len(model.plant.outputs), :, : len(free)]
    return tangents.outputs, np.moveaxis(derivatives, 0, 1)


def _indices(known: Sequence[str], names: Sequence[str]) -> NDArray[np.int64]:
    return np.array([known.index(name) for name in names], dtype=np.int64)
