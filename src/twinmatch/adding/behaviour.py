"""Checks of a plant's behaviour at its defaults and within the bounds of its parameters."""

from __future__ import annotations

from typing import Final

import numpy as np

from twinmatch.adding.findings import Finding
from twinmatch.adding.trial import modes, run_trial, time_constants, trial_for
from twinmatch.dynamics import Model, Parameters, Plant, PlantError, advance, begin

__all__ = ["coarse", "in_bounds", "misdeclared", "pace", "ranges"]

_POINTS: Final = 24
_SLOW_STEPS: Final = 40
"""With more steps per sample a plant is slow to simulate: a hundred windows of a thousand samples take a
minute …"""
_MANY_STEPS: Final = 400
"""… and ten here, too long beside a running plant."""
_MANY_SAMPLES: Final = 1e5
"""A time constant of more sampling periods needs recordings that are too long to be matched."""
_GROWS: Final = 1e-6
"""Growth rates below this share of the plant's fastest rate are rounding."""


def coarse(plant: type[Plant]) -> list[Finding]:
    """Whether steps that stand out from the output's noise fit into its span."""
    y = plant.output
    low, high = y.span
    if y.least_step <= high - low:
        return []
    what = (
        f"{y.name}: with a noise of {y.noise:g} {y.unit}, a step that stands out is {y.least_step:g} "
        f"{y.unit}, more than its span {low:g} to {high:g}"
    )
    return [Finding(what, "correct `noise`, the scatter of a reading at rest, or `span`")]


def misdeclared(model: Model) -> list[Finding]:
    """Contradictory declarations of one structure."""
    found = []
    place = f"structure {model.structure_name!r}"
    for name in model.structure.free:
        if name not in model.declared:
            what = f"{place}: {name} is free, but does not occur in the equations with the structure's parts"
            found.append(Finding(what, f"remove {name} from `free`, or add the part that uses it to `parts`"))
            continue
        (low, high), value = model.declared[name].bounds, model.defaults[name]
        if not low <= value <= high:
            what = f"{place}: the default of {name}, {value:g}, is outside its bounds {low:g} to {high:g}"
            found.append(Finding(what, "widen the bounds, or correct the default (or `fixed`)"))
    return found


def ranges(model: Model) -> list[Finding]:
    """Whether output and states stay within their spans, at the defaults.

    Raises:
        PlantError: the plant cannot be simulated there.
    """
    parameters = model.parameters()
    trial = trial_for(parameters)
    run, _ = run_trial(parameters, trial)
    y = model.plant.output
    found = []
    low, high = float(run.output.min()), float(run.output.max())
    if low < y.span[0] or high > y.span[1]:
        what = (
            f"{model.title}: with the defaults, over the drive's range, the output goes from {low:.4g} to "
            f"{high:.4g} {y.unit}, beyond its span {y.span[0]:g} to {y.span[1]:g}"
        )
        found.append(
            Finding(what, "widen `span` of the output, or check default values and units of the parameters")
        )
    states = begin(parameters, trial.output, input=float(trial.input[0]))
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
            found.append(Finding(what, "widen `span` of the state: it determines the simulation's step"))
    return found


def pace(model: Model, period: float | None) -> tuple[list[Finding], list[str]]:
    """Compare time constants and sampling period, s.

    Raises:
        PlantError: the plant cannot be simulated at its defaults.
    """
    parameters = model.parameters()
    lags = time_constants(parameters)
    place = f"structure {model.structure_name!r}"
    if not lags.size:
        return [], ["there is no finite time constant (an integrator)"]
    found = _growing(place, parameters)
    listed = ", ".join(f"{lag:.3g} s" for lag in lags)
    notes = [f"time constants at the defaults: {listed}"]
    if period is None:
        return found, notes
    try:
        steps = parameters.steps(period)
    except PlantError as error:
        todo = "replace the fast state by its steady-state value, or sample faster"
        return [*found, Finding(f"{place}: {error}", todo)], notes
    if steps > _SLOW_STEPS:
        what = (
            f"{place}: a sample of {period:g} s takes {steps} simulation steps; its shortest time constant "
            f"is {lags[0]:.3g} s"
        )
        if steps > _MANY_STEPS:
            todo = "replace the fast state by its steady-state value, or narrow the spans of the states"
            found.append(Finding(what, todo))
        else:
            notes.append(f"{what}: fits are slow")
    if lags[-1] < period:
        what = f"{place}: its slowest time constant, {lags[-1]:.3g} s, is below the period of {period:g} s"
        found.append(Finding(what, "sample faster, or check the units of the parameters (s, not min)"))
    if lags[-1] > _MANY_SAMPLES * period:
        what = (
            f"{place}: its slowest time constant, {lags[-1]:.3g} s, is {lags[-1] / period:.2g} periods of "
            f"{period:g} s: no window can show it"
        )
        found.append(Finding(what, "sample less often, hold that state, or check units (s, not h)"))
    return found, notes


def _growing(place: str, parameters: Parameters) -> list[Finding]:
    """Modes that grow by themselves in the middle of the plant's range."""
    found = modes(parameters)
    growth = float(found.real.max(initial=0.0))
    if growth <= _GROWS * float(np.abs(found).max(initial=0.0)):
        return []
    what = f"{place}: it is unstable at its defaults: deviations grow by e in {1 / growth:.3g} s"
    return [Finding(what, "look for a wrong sign in the rates; an unstable plant needs a known `loop`")]


def in_bounds(model: Model) -> list[Finding]:
    """Whether the plant can be simulated within the bounds, at points spread over them."""
    from scipy.stats import qmc  # noqa: PLC0415 (takes half a second, used only here)

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
            bad.append((where, f"its output diverges to {np.abs(run.output).max():.2g}"))
    if not bad:
        return []
    where, why = bad[0]
    what = (
        f"structure {model.structure_name!r}: cannot be simulated at {len(bad)} of {_POINTS} points within "
        f"the bounds, such as {where}: {why}"
    )
    return [Finding(what, "narrow the bounds to values that are physically possible")]


def _within(model: Model, name: str, part: float) -> float:
    """A value between the bounds: on a logarithmic scale where they are positive and far apart."""
    low, high = model.declared[name].bounds
    if low > 0 and high > 10 * low:
        return float(low * (high / low) ** part)
    return low + part * (high - low)
