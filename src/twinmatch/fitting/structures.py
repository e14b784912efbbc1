"""Fits of a plant's structures to recorded windows.

A plant file lists its structures: which parts are modelled, and which parameters are unknown. `fit_structure`
estimates those from one or more windows together: the twin runs on each window from its third sample on, and
the residuals, in units of the noise, are minimised. Large ones count linearly instead of quadratically: a
sensor that pauses to correct itself, or repeats old readings when a session begins, disturbs the loop in a
way that no structure explains.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from twinmatch.dynamics import (
    FROM_PLANT_FILE,
    SKIPPED,
    Descended,
    Experiment,
    Known,
    LoopLaw,
    Model,
    Parameters,
    Plant,
    descend,
)
from twinmatch.dynamics.movement import rest_of
from twinmatch.dynamics.pace import time_constant
from twinmatch.fitting.data import FittingError
from twinmatch.fitting.problem import (
    LASTING,
    Expectation,
    Noise,
    Prior,
    checked_law,
    ended_on_bounds,
    known_of,
    unknown_parameters,
    unknown_starts,
)
from twinmatch.signals import BoolArray, FloatArray, Window

_SETTLE_SAMPLES: Final = (5, 60)
"""Least and largest number of samples at a window's start that are simulated but not compared: the largest until the
loop has forgotten the twin's initial state and the sensor its first readings."""
_SETTLE: Final = 0.6
"""Time after which they are compared where no initial state has to be forgotten, time constants of the plant: half of
what the first reading's noise has moved is gone then."""

_SEEN: Final = 2 / 3
"""Share of a window that is fitted where the rest is held back."""
_LOOK = 8
"""Evaluations after which only the best of several starts continues."""
_MAX_EVALUATIONS = 40
_NEAR_ENOUGH: Final = 0.01 * LASTING
"""Predicted decrease of the cost at which a search that is not thorough ends. The residuals of `LASTING`
samples count as one, so if the cost is quadratic there, the values are a tenth of their standard errors from
the minimum."""
STRETCH: Final = 10.0
"""Length of the stretches in which a session is fitted, time constants of the plant."""
_BLOCKS: Final = (8, 5.0)
"""Least number of blocks into which windows are divided for `observed_covariance`, and the length of one,
in `LASTING`."""
SPREAD: Final = 0.5
"""Prior standard deviation of a parameter around its typical value, in units of that value."""


@dataclass(frozen=True, eq=False)
class StructureFit:
    """A structure fitted to windows; the arrays omit the first `settling_samples` of each window."""

    parameters: Parameters
    """The fitted parameters."""
    starts: tuple[Mapping[str, float], ...]
    """Unknown states at the third sample of each window, by name."""
    measured: tuple[FloatArray, ...]
    """Outputs and, in closed loop, inputs of each window, shape (signals, M)."""
    simulated: tuple[FloatArray, ...]
    """The same for the twin."""
    seen: tuple[BoolArray, ...]
    """Which of these samples were measured, of each window, shape (M,); the others are estimates."""
    converged: bool
    """Whether the search converged."""
    cost: float
    """The minimised cost: the mean over all residuals e, in units of the noise, of 2(√(1 + e²) − 1)."""
    states: tuple[FloatArray, ...]
    """States of the twin at each of those samples, shape (M, states)."""
    covariance: FloatArray
    """Covariance of the free parameters, in their order and units, for correlated residuals; shape (n, n)."""
    charge: float
    """Minus twice the logarithm of the evidence for the structure, by Laplace's approximation for correlated
    residuals: the cost of the residuals plus that of every direction better known than before."""

    @property
    def model(self) -> Model:
        """The plant in this structure."""
        return self.parameters.model

    @property
    def bounds_hit(self) -> tuple[str, ...]:
        """Names of the parameters that ended on a bound."""
        free = self.model.structure.free
        values = np.array([self.parameters[name] for name in free])
        return ended_on_bounds(unknown_parameters(self.model, free), values)

    @property
    def n_parameters(self) -> int:
        """Number of values that the fit estimates."""
        return self.model.structure.n_parameters(len(self.measured))

    @property
    def fit(self) -> tuple[float, float]:
        """NRMSE of outputs and inputs over all windows, each the worst; 1 is perfect.

        NaN for the inputs of a driven twin.
        """
        is_received = np.concatenate(self.seen)
        measured = np.hstack(self.measured)[:, is_received]
        simulated = np.hstack(self.simulated)[:, is_received]
        spreads = np.linalg.norm(
            measured - measured.mean(axis=1, keepdims=True), axis=1
        )
        residual_norms = np.linalg.norm(measured - simulated, axis=1)
        figures = []
        for norm, spread in zip(residual_norms, spreads, strict=True):
            figures.append(1.0 - norm / spread if spread > 0 else float("nan"))
        outputs = len(self.model.plant.outputs)
        return float(np.min(figures[:outputs])), float(
            np.min(figures[outputs:] or [np.nan])
        )


def fit_structure(
    windows: Sequence[Window],
    model: Model,
    *,
    start: StructureFit | None = None,
    noise: Noise | None = None,
    law: LoopLaw = FROM_PLANT_FILE,
    thorough: bool = True,
    informed: bool = False,
    prior: Prior | None = None,
) -> StructureFit:
    """Find the unknown parameters of one structure from windows of one plant.

    Args:
        windows: recorded windows, each with more than `settling_samples` + 2 samples.
        model: the plant in the structure to fit.
        start: an earlier fit of the same structure; without it the search has several starts.
        noise: unit of the residuals; default: the plant's.
        law: that of the running controller, None if the loop is not known; default: the plant file's, at
            the windows' period.
        thorough: search from several starts to convergence; otherwise from the best one until the values seem
            to be a tenth of their standard errors from the minimum, for a few evaluations.
        informed: use the plant file's typical values as prior, as one independent residual for each
            parameter. A few minutes leave a valley of parameters that fit equally well, whose ends forecast
            badly; an hour outweighs the prior.
        prior: what earlier sessions have shown of the parameters, by name, as prior in place of those.

    Raises:
        FittingError: no window, one that is too short, or windows of different periods.
    """
    informed = informed or bool(prior)
    expectations = {**_typical(model), **(prior or {})} if informed else {}
    knowledge = known_of(expectations, max(len(windows), 1))
    problem = _Problem(
        _runs(windows, model, noise or Noise.of(model.plant), law, knowledge)
    )
    plant = model.typical() if informed else model.parameters()
    plant = plant.replace(
        **{name: expectation.mean for name, expectation in expectations.items()}
    )
    if start is not None and start.model is model:
        values = problem.values_of(start.parameters, start.starts[-1])
    else:
        # with the prior there is no second valley
        other_starts = () if informed else model.structure.starts
        firsts = [
            problem.values_of(plant.replace(**changes))
            for changes in ({}, *other_starts)
        ]
        looks = [
            problem.search(first, _LOOK if thorough or informed else 1)
            for first in firsts
        ]
        values = min(looks, key=lambda look: look.cost).values
    best = (
        problem.search(values, _MAX_EVALUATIONS)
        if thorough
        else problem.search(values, _LOOK, _NEAR_ENOUGH)
    )
    return problem.fitted(best)


def fit_session(
    model: Model,
    session: Window | Sequence[Window],
    *,
    noise: Noise | None = None,
    informed: bool = True,
    stretch: float = STRETCH,
) -> StructureFit:
    """Fit a structure to a whole session, over all outputs, under its inputs: its parameters with their
    covariance.

    Over an hour, slow disturbances that no equation has move a simulation further from the plant than its
    parameters do. So the session is fitted in stretches of some time constants, each from its own readings.

    Args:
        model: the plant in the structure to fit.
        session: its samples; of one with gaps, the windows between them.
        noise, informed: as for `fit_structure`.
        stretch: length of the stretches, time constants of the plant.

    Raises:
        FittingError: as `fit_structure`.
    """
    windows = [session] if isinstance(session, Window) else session
    parts = [
        part for window in windows for part in in_parts(model.plant, window, stretch)
    ]
    return fit_structure(parts, model, noise=noise, law=None, informed=informed)


@cache
def settling_samples(plant: type[Plant], period: float) -> int:
    """Samples at a window's start that are simulated but not compared, for a sample time in seconds.

    They are as many for all structures of a plant, which are compared with each other.
    """
    least, most = _SETTLE_SAMPLES
    slow = time_constant(plant)
    watched = [
        plant.model(name)
        for name, structure in plant.structures.items()
        if structure.watched
    ]
    if not slow or not all(map(_begins_where_it_is, watched)):
        return most
    return min(max(round(_SETTLE * slow / period), least), most)


def _begins_where_it_is(model: Model) -> bool:
    """Whether every state is read by an output or its initial value estimated; of an FMU nobody knows."""
    if model.is_external:
        return False
    parameters = model.typical()
    states, inputs = rest_of(parameters)
    slopes_of_outputs = model.kernels.slopes_at(
        parameters.vector, states, inputs, model.disturbances
    )[4]
    is_read = np.any(slopes_of_outputs != 0.0, axis=0)
    is_estimated = np.isin(model.states, model.structure.free_starts)
    return bool(np.all(is_read | is_estimated))


def in_parts(
    plant: type[Plant],
    window: Window,
    stretch: float = STRETCH,
    *,
    otherwise: float = 0.0,
) -> list[Window]:
    """A window in equal parts of about `stretch` time constants of the plant; if it has none, of about
    `otherwise` samples, 0: whole."""
    samples = stretch * time_constant(plant) / window.period or otherwise
    least = 2.0 * settling_samples(plant, window.period)
    number = max(1, round(len(window) / max(samples, least))) if samples else 1
    ends = window.first + np.linspace(0, len(window), number + 1).astype(int)
    return [window.part(first, end - 1) for first, end in pairwise(ends.tolist())]


def held_back_costs(
    fitted: StructureFit,
    windows: Sequence[Window],
    noise: Noise | None = None,
    law: LoopLaw = FROM_PLANT_FILE,
    *,
    thorough: bool = True,
) -> FloatArray:
    """The cost of a free run on the last third of each window, after a fit to the rest: means over blocks of
    `LASTING`.

    A window that is too short for that is fitted as a whole.

    Args:
        fitted: the fit to the windows, from which the search starts.
        windows, noise, law, thorough: as in `fit_structure`.
    """
    noise = noise or Noise.of(fitted.model.plant)
    ends = [math.ceil(_SEEN * len(window)) for window in windows]
    parts = []
    for window, end in zip(windows, ends, strict=True):
        settling = settling_samples(fitted.model.plant, window.period)
        size = max(end, settling + SKIPPED + 1)
        parts.append(window.part(window.first, window.first + size - 1))
    before = fit_structure(
        parts, fitted.model, start=fitted, noise=noise, law=law, thorough=thorough
    )
    problem = _Problem(_runs(windows, fitted.model, noise, law, {}))
    blocks = []
    for run, starts, end in zip(problem.runs, before.starts, ends, strict=True):
        costs = _free_run_costs(run, before.parameters, starts, noise)
        held_back = costs[end - SKIPPED :][run.window.marks[end:]]
        blocks_of_run = np.array_split(
            held_back, max(round(held_back.size / LASTING), 1)
        )
        blocks += [block.mean() for block in blocks_of_run if block.size]
    return np.array(blocks or [fitted.cost])


def _free_run_costs(
    run: Experiment, parameters: Parameters, starts: Mapping[str, float], noise: Noise
) -> FloatArray:
    """The robust cost of each sample of a free run, in the mean over the signals, shape (N − 2,)."""
    free_values = run.values_of(parameters)[: len(run.free)]
    response = run.simulate(np.append(free_values, [*starts.values()]))
    signals = len(noise.all) if run.closed else len(run.model.plant.outputs)
    simulated = np.concatenate([response.outputs.T, response.inputs.T])[:signals]
    errors = (run.measured[:signals] - simulated) / noise.all[:signals, None]
    return np.asarray(np.sum(2.0 * (np.sqrt(1.0 + errors**2) - 1.0), axis=0) / signals)


def observed_covariance(
    fitted: StructureFit,
    windows: Sequence[Window],
    noise: Noise | None = None,
    law: LoopLaw = FROM_PLANT_FILE,
) -> FloatArray:
    """Covariance of the free parameters from what parts of the windows disagree about, shape (n, n).

    The covariance of a fit takes neighbouring residuals as correlated over `LASTING` samples, whatever they
    are. Here the windows are divided into blocks, and the gradients of the cost in each, which the fit has
    balanced against each other, show how far they pull: H⁻¹·S·H⁻¹, S the sum of their outer products, H the
    slope of the gradient (the sandwich of clustered residuals; Liang and Zeger 1986). A few dozen blocks give
    its size better than its shape, so half of it is H⁻¹ at that size.

    Args:
        fitted: the fit to these windows, converged.
        windows, noise, law: as in `fit_structure`.
    """
    problem = _Problem(
        _runs(windows, fitted.model, noise or Noise.of(fitted.model.plant), law, {})
    )
    return problem.observed_covariance(fitted)


def _typical(model: Model) -> dict[str, Expectation]:
    """The plant file's typical values as prior."""
    typical = model.typical()
    expectations = {}
    for name in model.structure.free:
        declared = model.declared[name]
        spread = SPREAD * abs(typical[name]) if declared.relative else declared.scale
        expectations[name] = Expectation(typical[name], spread or declared.scale)
    return expectations


def _runs(
    windows: Sequence[Window],
    model: Model,
    noise: Noise,
    law: LoopLaw,
    known: Mapping[str, Known],
) -> list[Experiment]:
    if not windows:
        raise FittingError("structures: there is no window; give at least one")
    runs = []
    for window in windows:
        settling = settling_samples(model.plant, window.period)
        if len(window) <= settling + SKIPPED:
            raise FittingError(
                f"structures: the window from sample {window.first} has {len(window)} samples; "
                f"the first {settling + SKIPPED} are not compared, give more"
            )
        checked = checked_law(model, window, law)
        runs.append(
            Experiment(
                model.parameters(),
                model.structure.free,
                window,
                free_starts=model.structure.free_starts,
                law=checked,
                weights=tuple(1.0 / noise.all),
                robust=True,
                settle=settling,
                coarse=True,
                beforehand=known,
            )
        )
    return runs


class _Problem:
    """Robust least squares over all windows; values are free parameters and each window's initial states."""

    def __init__(self, runs: Sequence[Experiment]) -> None:
        self.runs = runs
        model = runs[0].model
        self._free = len(runs[0].free)
        self._n_starts = len(runs[0].free_starts)
        unknowns = unknown_parameters(model, runs[0].free) + unknown_starts(
            model
        ) * len(runs)
        self._lower = np.array([unknown.bounds[0] for unknown in unknowns])
        self._upper = np.array([unknown.bounds[1] for unknown in unknowns])
        self._scales = np.array([unknown.scale for unknown in unknowns])
        self._pull = runs[0].pull
        self._settling = settling_samples(model.plant, runs[0].window.period)

    def values_of(
        self, parameters: Parameters, starts: Mapping[str, float] | None = None
    ) -> FloatArray:
        """The values for given parameters, with initial states `starts` in each window, or as in the file."""
        values_of_runs = [run.values_of(parameters) for run in self.runs]
        values = [values_of_runs[0][: self._free]]
        for values_of_run in values_of_runs:
            values.append(
                np.array(list(starts.values()))
                if starts
                else values_of_run[self._free :]
            )
        return np.asarray(
            np.clip(np.concatenate(values), self._lower, self._upper), dtype=np.float64
        )

    def _places(self, window: int) -> NDArray[np.int64]:
        """Indices of the values that apply to one window."""
        first = self._free + window * self._n_starts
        return np.concatenate(
            [np.arange(self._free), np.arange(first, first + self._n_starts)]
        )

    def normal(self, values: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Sum, gradient and JᵀJ over all windows."""
        n = values.size
        cost = 0.0
        gradient = np.zeros(n)
        hessian = np.zeros((n, n))
        for window, run in enumerate(self.runs):
            places = self._places(window)
            own_cost, own_gradient, own_hessian = run.normal(values[places])
            cost += own_cost
            gradient[places] += own_gradient
            hessian[np.ix_(places, places)] += own_hessian
        return cost, gradient, hessian

    def search(
        self, start: FloatArray, evaluations: int, settled: float = 0.0
    ) -> Descended:
        """Search from one start, until the cost would hardly fall by more than `settled`."""
        box = self._lower, self._upper, self._scales, evaluations
        if len(self.runs) == 1:
            return self.runs[0].descend(start, *box, settled=settled)
        return descend(self.normal, start, *box, settled=settled)

    def fitted(self, best: Descended) -> StructureFit:
        """The fit from the result of a search."""
        parts = [best.values[self._places(window)] for window in range(len(self.runs))]
        first = self.runs[0]
        plant = first.model.plant
        settling = self._settling
        signals = len(plant.outputs) + (len(plant.drives) if first.closed else 0)
        simulated = []
        states = []
        for run, part in zip(self.runs, parts, strict=True):
            response = run.simulate(part)
            both = np.concatenate([response.outputs.T, response.inputs.T])
            simulated.append(both[:signals, settling:])
            states.append(response.states[settling:-1])
        if not all(np.isfinite(rows).all() for rows in simulated):
            msg = f"structures: {first.model.title} has no finite response at the best parameters"
            raise FittingError(msg)
        is_received = tuple(run.window.marks[SKIPPED + settling :] for run in self.runs)
        n_received = sum(int(marks.sum()) for marks in is_received)
        return StructureFit(
            parameters=first.parameters_at(parts[0]),
            starts=tuple(
                run.starts_at(part) for run, part in zip(self.runs, parts, strict=True)
            ),
            measured=tuple(run.measured[:signals, settling:] for run in self.runs),
            simulated=tuple(simulated),
            seen=is_received,
            converged=best.converged,
            cost=best.cost / (signals * n_received),
            states=tuple(states),
            covariance=self._covariance(best.hessian)[: self._free, : self._free],
            charge=self._charge(best),
        )

    def observed_covariance(self, fitted: StructureFit) -> FloatArray:
        """As the function of that name."""
        initial = [list(starts.values()) for starts in fitted.starts]
        values = self.values_of(fitted.parameters)
        values[self._free :] = np.concatenate(initial)
        scores, slope = self._scores_by_block(values)
        # In units of the scales; without the windows, a value was as uncertain as its scale.
        units = np.outer(self._scales, self._scales)
        model = np.linalg.inv(slope * units + np.eye(values.size))
        pulls = scores * self._scales @ model
        count = len(scores)
        observed = pulls.T @ pulls * count / max(count - values.size, 1)
        size = float(np.trace(np.linalg.solve(model, observed))) / values.size
        both = 0.5 * (observed + size * model) * units
        return np.asarray(both[: self._free, : self._free])

    def _scores_by_block(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The gradients of the cost in each block of samples, shape (blocks, n), and their slope, (n, n)."""
        length = sum(run.measured.shape[1] - self._settling for run in self.runs)
        size = min(round(_BLOCKS[1] * LASTING), max(length // _BLOCKS[0], 1))
        scores = []
        slope = np.zeros((values.size, values.size))
        for window, run in enumerate(self.runs):
            places = self._places(window)
            scores_of_run, slope_of_run = run.scores(values[places])
            slope[np.ix_(places, places)] += slope_of_run
            settled = scores_of_run[self._settling :]
            for block in np.array_split(settled, max(round(len(settled) / size), 1)):
                scores.append(
                    np.bincount(places, block.sum(axis=0), minlength=values.size)
                )
        return np.array(scores), slope

    def _precision(self, hessian: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Precision of the values, in units of their scales, after and before the windows: (n, n) and (n,).

        Without a prior, a value was as uncertain as its scale.
        """
        before = (
            np.append(
                self._pull * len(self.runs), np.zeros(self._scales.size - self._free)
            )
            / LASTING
        )
        before *= self._scales**2
        unknown = np.where(before > 0.0, 0.0, 1.0)
        after = hessian * np.outer(self._scales, self._scales) / LASTING + np.diag(
            unknown
        )
        return after, before + unknown

    def _covariance(self, hessian: FloatArray) -> FloatArray:
        after, _ = self._precision(hessian)
        return np.asarray(np.linalg.inv(after) * np.outer(self._scales, self._scales))

    def _charge(self, best: Descended) -> float:
        after, before = self._precision(best.hessian)
        return float(
            best.cost / LASTING + np.linalg.slogdet(after)[1] - np.sum(np.log(before))
        )
