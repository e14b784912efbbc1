"""What the approximation of a dead time has shifted in an estimate.

A dead time in a plant's equations is a chain of a few states, which rounds off the corners of what it delays.
A loop that switches at what it sees then has another gain and another lag in place of the plant's: by more
than the noise explains, and in each of its cycles alike, so that neither longer windows nor the residuals show
it. But the twin itself shows it: run on inputs that are late by all whole periods, with the rest of the dead time
alone as a chain, it has corners. The difference of both runs is what the fit has had to make up for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np

from twinmatch.dynamics import (
    SKIPPED,
    DeadTime,
    Model,
    Parameters,
    PlantError,
    dead_times_of,
)
from twinmatch.dynamics.equations import written_equations
from twinmatch.fitting.problem import Problem
from twinmatch.signals import FloatArray, Window

_LEAST_LEFT: Final = 0.25
"""Least of a dead time that stays a chain, in periods: the steps of the simulation become shorter with it. Only
whole periods are taken away, as an input that changes within a period has a corner less, too."""


@dataclass(frozen=True, slots=True)
class _DelayedDrive:
    """A drive that acts after a dead time."""

    drive: int
    """Its index among the inputs."""
    dead_time: str
    """The parameter, s."""
    mean: str
    """The state that holds the mean of the drive over the dead time."""
    shapes: tuple[str, ...]
    """The other states of the chain, which are 0 while the drive rests."""


class _Delayed(NamedTuple):
    """A drive as it was some time ago."""

    values: FloatArray
    """Its samples, shape (N,)."""
    before: float
    """Its value before the twin starts."""


def shift_by_dead_times(problem: Problem, values: FloatArray) -> FloatArray:
    """By how much the estimates `values` lie above those that exact dead times would give, shape (n,).

    Zero for a twin without a dead time of a drive, and in a known loop, where the twin's own inputs are delayed.
    """
    shift = np.zeros(values.size)
    if problem.law is not None:
        return shift
    approximate = problem.experiment.parameters_at(values)
    exact = approximate
    window = problem.window
    starts = problem.experiment.starts_at(values)
    for delayed_drive in _delayed_drives(problem.base.model):
        # of several drives that act after one dead time each is delayed by all of it
        dead_time = approximate[delayed_drive.dead_time] / window.period
        whole = math.floor(dead_time - _LEAST_LEFT)
        if whole < 1:
            continue
        delayed = _delayed(window, delayed_drive, dead_time, whole, starts)
        inputs = window.inputs.copy()
        inputs[:, delayed_drive.drive] = delayed.values
        window = replace(window, inputs=inputs)
        left = (dead_time - whole) * window.period
        exact = exact.replace(**{delayed_drive.dead_time: left})
        for state in starts.keys() & set(delayed_drive.shapes):
            starts[state] = 0.0
        if delayed_drive.mean in starts:
            starts[delayed_drive.mean] = delayed.before
    if window is problem.window:
        return shift
    tangents = problem.experiment.tangents(values)
    try:
        outputs = _outputs(replace(problem, window=window), exact, starts)
    except PlantError:  # a chain of many states that cannot be as short
        return shift
    misfit = outputs - tangents.outputs
    is_finite = np.isfinite(misfit).all() and np.isfinite(tangents.by).all()
    return _least_squares(problem, misfit, tangents.by) if is_finite else shift


def started_chains(problem: Problem) -> frozenset[str]:
    """The states of dead times of drives whose values at the window's start are fitted."""
    if problem.law is not None or not problem.base.model.structure.free_starts:
        return frozenset()
    names: set[str] = set()
    for delayed_drive in _delayed_drives(problem.base.model):
        names.update((delayed_drive.mean, *delayed_drive.shapes))
    return frozenset(names & set(problem.base.model.structure.free_starts))


def _least_squares(
    problem: Problem, misfit: FloatArray, by_unknowns: FloatArray
) -> FloatArray:
    """The change of the unknowns that explains most of a misfit of the outputs, shape (N, o)."""
    outputs = misfit.shape[1]
    weights = problem.weights[:outputs] * problem.seen
    rows = (by_unknowns[:outputs] * weights[:, :, None]).reshape(
        -1, by_unknowns.shape[2]
    )
    scales = problem.scales
    change = np.linalg.lstsq(
        rows * scales, (misfit.T * weights).reshape(-1), rcond=None
    )[0]
    return np.asarray(change * scales, dtype=np.float64)


def _outputs(
    problem: Problem, parameters: Parameters, starts: dict[str, float]
) -> FloatArray:
    """The outputs of a twin with these parameters and states at the start, shape (N, o)."""
    of_starts = replace(problem, free=(), base=parameters)
    values = np.array([starts[name] for name in of_starts.names])
    return of_starts.experiment.simulate(values).outputs


def _delayed(
    window: Window,
    delayed_drive: _DelayedDrive,
    dead_time: float,
    whole: int,
    starts: dict[str, float],
) -> _Delayed:
    """A drive as it was `whole` periods ago, of a dead time in periods.

    Before the window it had the constant value with which its mean over the dead time, at the twin's start, is
    that of the estimate; without an estimate it rested.
    """
    drive = window.inputs[:, delayed_drive.drive]
    before = drive[0]
    if delayed_drive.mean in starts and dead_time > SKIPPED:
        sum_before = starts[delayed_drive.mean] * dead_time - sum(drive[:SKIPPED])
        before = sum_before / (dead_time - SKIPPED)
    with_past = np.concatenate([np.full(whole + 1, before), drive])
    values = with_past[1 : len(drive) + 1]
    return _Delayed(values, float(with_past[SKIPPED]))


@cache
def _delayed_drives(model: Model) -> tuple[_DelayedDrive, ...]:
    """The drives of a structure that act after a dead time which is a parameter."""
    plant = model.plant
    if model.is_external:
        return ()
    chains = [
        dead_time
        for dead_time in dead_times_of(plant)
        if _mean_of(dead_time) in model.states
    ]
    if not chains:
        # written equations need SymPy, whose import takes as long as a match
        return ()
    rates = written_equations(plant(), model.structure.parts).rates
    rate_of = {str(state): rate for state, rate in rates.items()}
    delayed_drives = []
    for chain in chains:
        mean = _mean_of(chain)
        delayed_drive = _drive_before(model, mean, rate_of[mean])
        if delayed_drive is not None:
            delayed_drives.append(delayed_drive)
    return tuple(delayed_drives)


def _mean_of(chain: DeadTime) -> str:
    """The state that holds the mean of what a chain delays over the dead time."""
    return f"{chain.name}_0"


def _drive_before(model: Model, mean: str, rate: Any) -> _DelayedDrive | None:
    """The drive that a chain delays; None if it delays something else, or by a time that is not a parameter.

    The mean over a dead time θ changes at (signal − mean − …)/θ.
    """
    symbols = {str(symbol): symbol for symbol in rate.free_symbols}
    dead_time = (-1 / rate.diff(symbols[mean])).simplify()
    if str(dead_time) not in model.declared:
        return None
    chain = mean.removesuffix("_0")
    shapes = tuple(
        name
        for name in model.states
        if name.startswith(f"{chain}_") and name in symbols and name != mean
    )
    signal = (rate * dead_time).subs({symbols[name]: 0 for name in (mean, *shapes)})
    drives = [*model.plant.drives]
    if str(signal.simplify()) not in drives:
        return None
    index = drives.index(str(signal.simplify()))
    return _DelayedDrive(index, str(dead_time), mean, shapes)
