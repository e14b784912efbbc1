"""What a plant does at its defaults and all over the bounds of its parameters."""

from __future__ import annotations

from typing import Final

import numpy as np

from twinmatch.adding.findings import Finding
from twinmatch.adding.trial import run_trial, time_constants, trial_for
from twinmatch.dynamics import Model, Parameters, PlantError, advance, begin

__all__ = ["in_bounds", "misdeclared", "pace", "ranges"]

_POINTS: Final = 24
_MANY_STEPS: Final = 40
"""Steps per sample above which a plant is slow to run: a hundred windows of a thousand samples take a
minute."""


def misdeclared(model: Model) -> list[Finding]:
    """Numbers of one structure that contradict one another."""
    found = []
    place = f"structure {model.structure_name!r}"
    for name in model.structure.free:
        if name not in model.declared:
            what = f"{place}: {name} is free, but the equations with its parts do not have it"
            found.append(
                Finding(what, f"leave {name} out of `free`, or name the part that brings it in `parts`")
            )
            continue
        (low, high), value = model.declared[name].bounds, model.defaults[name]
        if not low <= value <= high:
            what = f"{place}: {name} begins at {value:g}, outside its bounds {low:g} to {high:g}"
            found.append(Finding(what, "widen the bounds, or correct the default (or `fixed`)"))
    return found


def ranges(model: Model) -> list[Finding]:
    """Whether output and states stay where the file says they live, at the defaults.

    Raises:
        PlantError: the plant cannot be run there.
    """
    parameters = model.parameters()
    trial = trial_for(parameters)
    run, _ = run_trial(parameters, trial)
    y = model.plant.output
    found = []
    low, high = float(run.output.min()), float(run.output.max())
    if low < y.span[0] or high > y.span[1]:
        what = (
            f"{model.title}: at its defaults and over the drive's range the output goes from {low:.4g} to "
            f"{high:.4g} {y.unit}, beyond its span {y.span[0]:g} to {y.span[1]:g}"
        )
        found.append(
            Finding(what, "widen `span` of the output, or look at default values and units of the parameters")
        )
    states = begin(parameters, trial.output)
    least, most = states.copy(), states.copy()
    for u, row in zip(trial.input, trial.disturbances, strict=True):
        states = advance(parameters, states, float(u), trial.period, row)
        least, most = np.minimum(least, states), np.maximum(most, states)
    for k, name in enumerate(model.states):
        span = model.plant.states[name].span
        if least[k] < span[0] or most[k] > span[1]:
            what = (
                f"{model.title}: state {name} goes from {least[k]:.4g} to {most[k]:.4g}, beyond its span "
                f"{span[0]:g} to {span[1]:g}"
            )
            found.append(Finding(what, "widen `span` of the state: the simulation's steps are made for it"))
    return found


def pace(model: Model, period: float | None) -> tuple[list[Finding], list[str]]:
    """Time constants against the sample time, in s.

    Raises:
        PlantError: the plant cannot be run at its defaults.
    """
    parameters = model.parameters()
    lags = time_constants(parameters)
    place = f"structure {model.structure_name!r}"
    if not lags.size:
        return [], ["nothing settles by itself (an integrator)"]
    listed = ", ".join(f"{lag:.3g} s" for lag in lags)
    notes = [f"time constants at the defaults: {listed}"]
    if period is None:
        return [], notes
    found = []
    try:
        steps = parameters.steps(period)
    except PlantError as error:
        return [
            Finding(f"{place}: {error}", "give the fast part no state of its own, or sample faster")
        ], notes
    if steps > _MANY_STEPS:
        what = (
            f"{place}: its shortest time constant, {lags[0]:.3g} s, needs {steps} steps per "
            f"sample of {period:g} s"
        )
        todo = "replace the fast state by what it settles to, or narrow the spans of the states"
        found.append(Finding(what, todo))
    if lags[-1] < period:
        what = f"{place}: all has settled ({lags[-1]:.3g} s) before the next sample comes ({period:g} s)"
        found.append(Finding(what, "sample faster, or look at the units of the parameters (s, not min)"))
    return found, notes


def in_bounds(model: Model) -> list[Finding]:
    """Whether the plant can be run wherever a match may go: at points spread over the bounds."""
    from scipy.stats import qmc  # noqa: PLC0415 (half a second that only this check pays)

    free = [name for name in model.structure.free if name in model.declared]
    if not free:
        return []
    try:
        trial = trial_for(model.parameters())
    except PlantError:
        return []
    spread = qmc.Halton(len(free), seed=5).random(_POINTS)
    bad: list[tuple[str, str]] = []
    for row in spread:
        values = {n: _within(model, n, float(part)) for n, part in zip(free, row, strict=True)}
        point: Parameters = model.parameters(**values)
        where = ", ".join(f"{n} = {v:.3g}" for n, v in values.items())
        try:
            run, _ = run_trial(point, trial)
        except PlantError as error:
            bad.append((where, str(error).removeprefix(f"{model.title}: ")))
            continue
        span = np.ptp(model.plant.output.span)
        if float(np.abs(run.output).max()) > 1e4 * span:
            bad.append((where, f"its output runs away to {np.abs(run.output).max():.2g}"))
    if not bad:
        return []
    where, why = bad[0]
    what = (
        f"structure {model.structure_name!r}: within the bounds it cannot be run at {len(bad)} of {_POINTS} "
        f"points, such as {where}: {why}"
    )
    return [Finding(what, "narrow the bounds to what such a plant can have")]


def _within(model: Model, name: str, part: float) -> float:
    """A value between the bounds: even in ratios where they are positive and far apart."""
    low, high = model.declared[name].bounds
    if low > 0 and high > 10 * low:
        return float(low * (high / low) ** part)
    return low + part * (high - low)
