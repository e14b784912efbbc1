"""Findings of a plant check; a simulated experiment on a plant file, and which parameters it can tell apart.

Every input steps over its drive's whole range. The exact tangents of the experiment are the sensitivities of
the outputs to each parameter. If a combination of parameters has no effect on the output at any of several
points of the parameter space, no recording can determine it. One point where the tangents have full rank
proves the opposite (local structural identifiability; Walter & Pronzato, Identification of Parametric Models,
1997, section 2.6).
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.dynamics import (
    Experiment,
    Model,
    Parameters,
    PlantError,
    Response,
    begin,
    simulate_driven,
)
from twinmatch.dynamics.declarations import Parameter
from twinmatch.dynamics.equations import written_equations
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray, Window


class Finding(NamedTuple):
    """A fault, and what to do about it."""

    what: str
    todo: str


@dataclass(frozen=True)
class CheckedPlant:
    """Result of a check."""

    title: str
    findings: tuple[Finding, ...] = ()
    notes: tuple[str, ...] = ()
    """Remarks that are not faults."""
    unusable: str = ""
    """Why the plant cannot be simulated at all; empty: it can."""

    @property
    def exit_code(self) -> int:
        """0: no findings; 1: findings; 2: the plant cannot be used."""
        return 2 if self.unusable else 1 if self.findings else 0


SAMPLES: Final = 400


class _TrialCourse(Rule):
    """The course of the simulated experiment."""

    per_lag: float = 20.0
    """Samples per slowest time constant: 400 samples span twenty of them."""
    halvings: int = 20
    """Halvings of the period until a sample of it does not take too many steps."""
    seed: int = 7
    """Of the inputs."""


_COURSE: Final = _TrialCourse()


class Trial(NamedTuple):
    """Inputs, (N, m), disturbances, (N, d), sampling period, s, and initial outputs, (o,)."""

    inputs: FloatArray
    disturbances: FloatArray
    period: float
    outputs: FloatArray


def middle_of(model: Model) -> FloatArray:
    """The outputs in the middle of the plant's operating range, shape (o,)."""
    first = model.plant.states[model.states[0]].span if model.states else (0.0, 0.0)
    ranges = [y.set_points or y.span for y in model.plant.outputs.values()]
    return np.array(
        [sum(ends if np.isfinite(ends).all() else first) / 2 for ends in ranges]
    )


def modes(parameters: Parameters) -> NDArray[np.complex128]:
    """Eigenvalues of the plant linearised in the middle of its range, 1/s.

    Raises:
        PlantError: the equations have no finite values there.
    """
    model = parameters.model
    inputs = np.array([sum(drive.limits) / 2 for drive in model.plant.drives.values()])
    middle = np.array([sum(model.plant.states[name].span) / 2 for name in model.states])
    for states in (begin(parameters, middle_of(model), input=inputs), middle):
        # a power may begin at 0
        slopes = model.kernels.slopes_at(
            parameters.vector, states, inputs, model.disturbances
        )[1]
        if np.isfinite(slopes).all():
            break
    else:
        msg = f"{model.title}: the derivatives of its rates are not finite in the middle of its range"
        raise PlantError(msg + _advice(model))
    return np.asarray(np.linalg.eigvals(slopes), dtype=np.complex128)


def _advice(model: Model) -> str:
    """What to write instead of a power that has no value where its base is negative; empty without one."""
    from sympy import Pow, sympify  # noqa: PLC0415

    rates = written_equations(model.plant(), model.structure.parts).rates.values()
    signals = {*model.states, *model.plant.drives}
    powers = sorted(
        {power for rate in rates for power in sympify(rate).atoms(Pow)}, key=str
    )
    for base, exponent in (power.args for power in powers if not power.exp.is_integer):
        if signals & {str(symbol) for symbol in base.free_symbols}:
            return (
                f": ({base})**({exponent}) has no value where {base} is negative; write "
                f"maximum({base}, 1e-6)**({exponent}), or to keep the sign "
                f"({base})*(({base})**2 + 1e-6)**(({exponent} - 1)/2)"
            )
    return ""


def time_constants(parameters: Parameters) -> FloatArray:
    """Time constants of the plant linearised in the middle of its range, s, rising, without integrators."""
    rates = np.abs(modes(parameters))
    return np.sort(1.0 / rates[rates > 0])


def trial_for(parameters: Parameters, period: float | None = None) -> Trial:
    """Design the experiment for a plant with these parameters.

    It is sampled twenty times in its slowest time constant, or more often: every `period` s, if that is
    given, and as often as a stiff plant needs, whose fastest state lies far below its slowest.
    """
    model = parameters.model
    lags = time_constants(parameters)
    slow = float(lags[-1]) / _COURSE.per_lag if lags.size else 1.0
    period = affordable(
        parameters, float(f"{min(max(slow, 1e-6), 1e6, period or math.inf):.2g}")
    )
    random = np.random.default_rng(_COURSE.seed)
    inputs = np.empty((SAMPLES, len(model.plant.drives)))
    for column, drive in zip(inputs.T, model.plant.drives.values(), strict=True):
        first = 0
        while first < SAMPLES:
            hold = int(random.integers(5, 60))
            column[first : first + hold] = random.uniform(*drive.limits)
            first += hold
    moved = np.repeat(
        random.uniform(-1.0, 1.0, (SAMPLES // 50, model.disturbances.size)), 50, axis=0
    )
    disturbances = (
        model.disturbances + 0.1 * np.maximum(np.abs(model.disturbances), 1.0) * moved
    )
    return Trial(inputs, disturbances, period, middle_of(model))


def trials_for(parameters: Parameters) -> list[Trial]:
    """The experiment for the plant's slowest time constant, and further ones for those that end between two of
    its samples: what such a time constant does shows in no sample of the first."""
    trials = [trial_for(parameters)]
    for lag in time_constants(parameters)[::-1].tolist():
        if lag < trials[-1].period:
            trials.append(trial_for(parameters, lag / _COURSE.per_lag))
    return trials


def affordable(parameters: Parameters, period: float) -> float:
    """The longest of a period and its halves of which a sample does not take too many steps, s."""
    for shorter in period * 0.5 ** np.arange(_COURSE.halvings):
        with suppress(PlantError):
            parameters.steps(shorter)
            return float(shorter)
    return period  # simulating it raises the error


def run_trial(parameters: Parameters, trial: Trial) -> tuple[Response, Window]:
    """Simulate the experiment; returns the response, also as a window.

    Raises:
        PlantError: the plant is too fast for the period, or an output is not finite.
    """
    states = begin(parameters, trial.outputs, input=trial.inputs[0])
    run = simulate_driven(
        parameters,
        trial.inputs,
        states=states,
        period=trial.period,
        disturbances=trial.disturbances,
    )
    finite = np.isfinite(run.outputs).all(axis=1)
    if not finite.all():
        first_bad = int(np.flatnonzero(~finite)[0])
        time = first_bad * trial.period
        msg = f"{parameters.model.title}: its output is not a finite number after {time:g} s"
        raise PlantError(msg)
    references = np.tile(trial.outputs, (len(trial.inputs), 1))
    measured = trial.disturbances
    return run, Window(
        references,
        run.outputs,
        trial.inputs,
        period=trial.period,
        disturbances=measured,
    )


class _CombinationSearch(Rule):
    """Where combinations of parameters without effect are looked for, and what counts as one."""

    points: int = 4
    """Points of the parameter space."""
    away: float = 1.5
    """Largest factor, either way, between a point and the defaults."""
    flat: float = 1e-6
    """A column is linearly dependent if its residual is below this share of its length. Tangents are exact to
    about 1e-12; parameters with different effects mostly differ by more than 1e-4."""
    takes_part: float = 0.02
    """Parameters with a smaller share in a combination are not listed."""


_SEARCH: Final = _CombinationSearch()


class _Combination(NamedTuple):
    """Parameters that can change together without effect on the output."""

    names: tuple[str, ...]
    shares: tuple[float, ...]
    """Relative changes; for parameters without a meaningful zero, changes in units of their scale."""


def inseparable(model: Model) -> list[Finding]:
    """Combinations of the structure's free parameters that no data can determine."""
    free = tuple(name for name in model.structure.free if name in model.declared)
    tried: list[list[_Combination]] = []
    for point in _points(model, free) if free else ():
        with suppress(PlantError):  # reported by the check of the bounds
            tried.append(_combinations(point, free))
        if tried and not tried[-1]:
            break
    return [
        _finding(model, combination) for combination in min(tried, key=len, default=[])
    ]


def _points(model: Model, free: tuple[str, ...]) -> list[Parameters]:
    random = np.random.default_rng(11)
    points = [model.parameters()]
    for _ in range(_SEARCH.points - 1):
        steps = {name: float(random.uniform(-1.0, 1.0)) for name in free}
        moved = {
            name: _move(model.declared[name], model.defaults[name], steps[name])
            for name in free
        }
        points.append(model.parameters(**moved))
    return points


def _move(declared: Parameter, value: float, step: float) -> float:
    low, high = declared.bounds
    if declared.relative and value:
        moved = value * _SEARCH.away**step
    else:
        moved = value + step * min(declared.scale, (high - low) / 4)
    return moved if declared.possible(moved) else value


def _combinations(parameters: Parameters, free: tuple[str, ...]) -> list[_Combination]:
    """Columns of the tangents that depend linearly on the columns before them."""
    starts = parameters.model.structure.free_starts
    names = (*free, *(f"start of {name}" for name in starts))
    tangents, first_noise = _weighted_tangents(parameters, free)
    columns = tangents * np.array(_sizes(parameters, free))
    least = 1e-9 * first_noise * math.sqrt(columns.shape[0])
    combinations: list[_Combination] = []
    # Initial values first: they are always estimated, so a dependence is attributed to a parameter.
    order = [*range(len(free), len(names)), *range(len(free))]
    basis: list[int] = []
    for j in order:
        length = float(np.linalg.norm(columns[:, j]))
        if length <= least:
            combinations.append(_Combination((names[j],), (1.0,)))
            continue
        shares, residual = _project(columns[:, basis], columns[:, j])
        if residual > _SEARCH.flat * length:
            basis.append(j)
            continue
        taking_part = [
            k for k, share in enumerate(shares) if abs(share) > _SEARCH.takes_part
        ]
        names_in_part = (names[j], *(names[basis[k]] for k in taking_part))
        shares_in_part = (1.0, *(-float(shares[k]) for k in taking_part))
        combinations.append(_Combination(names_in_part, shares_in_part))
    return combinations


def _weighted_tangents(
    parameters: Parameters, free: tuple[str, ...]
) -> tuple[FloatArray, float]:
    """Tangents of all outputs in all trials, one below the other in units of the first one's noise, and that
    noise.

    Raises:
        PlantError: a sensitivity is not finite.
    """
    model = parameters.model
    noise = np.array([y.noise for y in model.plant.outputs.values()])
    rows = []
    for trial in trials_for(parameters):
        _, window = run_trial(parameters, trial)
        experiment = Experiment(
            parameters, free, window, free_starts=model.structure.free_starts, law=None
        )
        by_signal = experiment.tangents(experiment.values_of(parameters)).by
        rows += [*(by_signal[: noise.size] * (noise[0] / noise)[:, None, None])]
    tangents = np.concatenate(rows)
    if not np.isfinite(tangents).all():
        raise PlantError(
            f"{model.title}: the sensitivities of its output are not finite"
        )
    return tangents, noise[0]


def _sizes(parameters: Parameters, free: tuple[str, ...]) -> list[float]:
    """By how much the free parameters and starts change, so that the effects of all are comparable."""
    model = parameters.model
    sizes = []
    for name in free:
        declared = model.declared[name]
        value = parameters[name]
        sizes.append(abs(value) if declared.relative and value else declared.scale)
    for name in model.structure.free_starts:
        sizes.append(max(abs(model.plant.states[name].scale), 1e-12))
    return sizes


def _project(basis: FloatArray, column: FloatArray) -> tuple[FloatArray, float]:
    """Least-squares coefficients of a column in a basis, and the length of the residual."""
    if not basis.shape[1]:
        return np.empty(0), float(np.linalg.norm(column))
    lengths = np.linalg.norm(basis, axis=0)
    shares = np.linalg.lstsq(basis / lengths, column, rcond=None)[0]
    residual = float(np.linalg.norm(column - basis / lengths @ shares))
    return np.asarray(shares / lengths, dtype=np.float64), residual


def _finding(model: Model, combination: _Combination) -> Finding:
    place = f"structure {model.structure_name!r}"
    names, shares = combination
    if len(names) == 1:
        problem = f"{place}: the output does not depend on {names[0]}, which is free"
        return Finding(
            problem, f"remove {names[0]} from `free`, or check the equations"
        )
    relative = all(model.declared[n].relative for n in names if n in model.declared)
    is_ratio = all(abs(abs(s) - 1.0) < 0.02 for s in shares) and relative
    listed = f"{', '.join(names[:-1])} and {names[-1]}"
    if is_ratio and len(names) == 2:
        quantity = (
            f"{names[0]}/{names[1]}"
            if shares[0] * shares[1] > 0
            else f"{names[0]}·{names[1]}"
        )
        problem = f"{place}: no data can determine {listed} separately, only {quantity}"
    elif is_ratio and all(s > 0 for s in shares):
        problem = (
            f"{place}: no data can determine {listed} separately, only their ratios"
        )
    else:
        problem = f"{place}: {listed} can change together without effect on the output"
    todo = (
        "remove one of them from `free`, best the one you know or need least (its default, or a value in "
        "`fixed`, is used), or write the equations with the combination"
    )
    return Finding(problem, todo)
