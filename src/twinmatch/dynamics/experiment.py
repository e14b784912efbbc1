"""A recorded window as a function of the plant's unknowns, with exact tangents."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.dynamics.declarations import PlantError
from twinmatch.dynamics.descent import Descended, new_search, search_result
from twinmatch.dynamics.loop import PidState, controller_state
from twinmatch.dynamics.plant import Parameters
from twinmatch.dynamics.runs import LeastSquares
from twinmatch.dynamics.simulation import FROM_PLANT_FILE, NO_GAINS, SKIPPED, LoopGains, Response, gains_for
from twinmatch.signals import FloatArray, Window

_COARSE = 0.5
"""Longest step of a coarse run, in units of the fastest time constant."""


class Known(NamedTuple):
    """Prior knowledge of a parameter."""

    expected: float
    """Expected value, in the parameter's unit."""
    pull: float
    """Weight of its squared distance from that in the cost, in 1/unit²."""


class Tangents(NamedTuple):
    """A run and its derivatives."""

    output: FloatArray
    """y, shape (N,)."""
    input: FloatArray
    """u, shape (N,)."""
    by: FloatArray
    """Derivatives of output and input by the unknowns, shape (2, N, n)."""
    by_state: FloatArray
    """Derivatives of the states one period later by the states, shape (N, nx, nx)."""
    by_drive: FloatArray
    """Derivatives of the states one period later by u, shape (N, nx)."""
    free: FloatArray
    """1 where the controller was not limited, else 0, shape (N,)."""
    seen: FloatArray
    """Derivatives of the output by the states, shape (N, nx)."""


class Experiment:
    """The twin on one window: in closed loop if the controller is known, otherwise driven by the recorded u.

    The closed-loop twin gets the window's reference from the third sample on, because the first two determine
    the controller's state; the driven twin starts there, too. The unknowns are parameters and, after them,
    initial states; all other states start at the plant file's values.
    """

    def __init__(
        self,
        base: Parameters,
        free: Sequence[str],
        window: Window,
        *,
        free_starts: Sequence[str] = (),
        gains: LoopGains = FROM_PLANT_FILE,
        weights: tuple[float, float] = (1.0, 1.0),
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
            gains: gains of the running controller, None for the driven twin; default: the plant file's, at
                the window's period.
            weights: weights of the residuals of output and input in the normal equations.
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
        for names, known in ((free, model.names), (free_starts, model.states)):
            unknown = [name for name in names if name not in known]
            if unknown:
                msg = f"{model.title}: {unknown[0]!r} cannot be free; there are {', '.join(known)}"
                raise PlantError(msg)
        self.model, self.base, self.window = model, base, window
        self.free, self.free_starts = tuple(free), tuple(free_starts)
        loop = gains_for(model.plant, window.period, gains)
        self.closed, self.gains = loop is not None, loop or NO_GAINS
        if self.closed and self.gains.period != window.period:
            raise PlantError(
                f"{model.title}: the controller runs every {self.gains.period} s but the window's samples "
                f"come every {window.period} s; give both the same period"
            )
        self.controller = controller_state(window, self.gains) if self.closed else PidState()
        self.measured = np.ascontiguousarray(np.stack([window.output, window.input])[:, SKIPPED:])
        self._kernels = model.kernels_by(self.free)
        weighed = np.repeat(np.array(weights, dtype=np.float64)[:, None], self.measured.shape[1], 1)
        weighed[:, :settle] = 0.0
        if window.seen is not None:
            weighed[:, ~window.seen[SKIPPED:]] = 0.0
        expected, pull = np.zeros((2, self.size))
        for name, value in (beforehand or {}).items():
            place = self.free.index(name)
            expected[place], pull[place] = value.expected, value.pull
        self._problem = LeastSquares(
            base=base.vector,
            which=_indices(self._kernels.UNKNOWN, self.free),
            places=_indices(model.names, self.free),
            started=_indices(model.states, self.free_starts),
            first=float(window.output[SKIPPED]),
            input_before=float(window.input[SKIPPED - 1]),
            closed=self.closed,
            gains=self.gains.constants,
            reference=np.array(window.reference[SKIPPED:]),
            measured=self.measured,
            weights=weighed,
            robust=bool(robust),
            disturbances=model.disturbance_rows(window.disturbances, len(window))[SKIPPED:],
            default_disturbances=model.disturbances,
            corners=model.corners,
            drives=model.drives,
            integral=float(self.controller.integral),
            previous=float(self.controller.previous),
            period=float(window.period),
            rate_limit=_COARSE if coarse else self._kernels.RATE_LIMIT,
            expected=expected,
            pull=pull,
        )
        problem = self._problem
        self._signals = (
            problem.closed, problem.gains, problem.reference, self.measured[1], problem.disturbances,
        )  # fmt: skip

    @property
    def pull(self) -> FloatArray:
        """Weight of the prior of each free parameter in the cost, shape (n,)."""
        return self._problem.pull[: len(self.free)].copy()

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.free) + len(self.free_starts)

    def parameters_at(self, values: FloatArray) -> Parameters:
        """The plant with these values of the unknowns, shape (n,)."""
        return self.base.replace(**dict(zip(self.free, values.tolist(), strict=False)))

    def starts_at(self, values: FloatArray) -> dict[str, float]:
        """The unknown initial states, by name."""
        return dict(zip(self.free_starts, values[len(self.free) :].tolist(), strict=True))

    def values_of(self, parameters: Parameters) -> FloatArray:
        """The unknowns for given parameters; initial states are the plant file's, shape (n,)."""
        initial, _, _ = self._initial(parameters.vector)
        named = [parameters[name] for name in self.free]
        return np.array([*named, *initial[self._problem.started]], dtype=np.float64)

    def simulate(self, values: FloatArray) -> Response:
        """Run without derivatives; output and input have shape (N − 2,)."""
        vector, states, _, steps = self._start(values)
        problem, size = self._problem, self.measured.shape[1]
        still = np.zeros(size), np.zeros(size, dtype=np.bool_), 0.0
        output, input_, passed = self._kernels.run(
            vector, states, *self._signals, *still, problem.integral, problem.previous, problem.period, steps
        )
        return Response(output, input_, passed, steps)

    def normal(self, values: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Cost, gradient Jᵀr, shape (n,), and JᵀJ, shape (n, n), of the weighed residuals.

        The cost is their sum of squares, or Σ 2(√(1 + r²) − 1) if robust, with rows weighted by 1/√(1 + r²);
        infinite where the plant is too fast for the period.
        """
        found: tuple[float, FloatArray, FloatArray] = self._kernels.normal_at(self._problem, values, np.inf)
        return found

    def descend(  # noqa: PLR0917 (as the search itself)
        self,
        start: FloatArray,
        lower: FloatArray,
        upper: FloatArray,
        scales: FloatArray,
        most_evaluations: int,
        found: Descended | None = None,
    ) -> Descended:
        """Minimise the cost from one start inside the bounds, like `twinmatch.dynamics.descend`."""
        search = new_search(start, lower, upper, scales, most_evaluations, found)
        self._kernels.search(self._problem, search)
        return search_result(search, found)

    def tangents(self, values: FloatArray) -> Tangents:
        """Run with all derivatives."""
        vector, states, columns, steps = self._start(values)
        problem = self._problem
        found: tuple[FloatArray, ...] = self._kernels.run_with_tangents(
            vector, problem.which, states, columns, *self._signals, problem.integral, problem.previous,
            problem.period, steps, problem.measured, problem.weights, problem.robust, True, np.inf,
        )  # fmt: skip
        return Tangents(*found[:7])

    @cached_property
    def start_slope(self) -> FloatArray:
        """Derivatives of the initial states by the first output, shape (nx,); zero for unknown ones."""
        slope = self._initial(self.base.vector)[1]
        slope[self._problem.started] = 0.0
        return np.asarray(slope, dtype=np.float64)

    def _initial(self, vector: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        initial: tuple[FloatArray, FloatArray, FloatArray] = self._kernels.begin(
            vector, self._problem.first, self._problem.input_before, self._problem.disturbances[0]
        )
        return initial

    def _start(self, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, int]:
        """Parameters, states, their derivatives by the unknowns, and steps per sample."""
        vector, states, columns, steps = self._kernels.start_at(self._problem, values)
        if steps > self._kernels.MOST_STEPS:
            self.model.steps(vector, self.window.period)  # raises the error
        return vector, states, columns, steps


def _indices(known: Sequence[str], names: Sequence[str]) -> NDArray[np.int64]:
    return np.array([known.index(name) for name in names], dtype=np.int64)
