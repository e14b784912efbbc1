"""What happens when a law runs on a twin, in the compiled loop: over a profile, and after a load."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from twinmatch.dynamics import (
    Law,
    Linear,
    LinearLaw,
    Output,
    Parameters,
    Plant,
    PlantError,
    SensorRealisation,
    TwoLevel,
    simulate_closed_loop,
)
from twinmatch.dynamics.laws import LOW
from twinmatch.signals import FloatArray

SETTLED: Final = 0.05
"""Share of a set-point's step within which the output has settled; at least three times its noise."""
_SEEN: Final = 3.0
"""Movement that counts, in the noise of an output."""
_GREATER: Final = 0.5
"""Share of the time that is its greater part."""
LOAD: Final = 0.1
"""Load at an input, as a share of the drive's range."""


class Run(NamedTuple):
    """One simulated course, sample by sample."""

    references: FloatArray
    """Shape (N, r)."""
    outputs: FloatArray
    """The outputs themselves, without the noise of their readings, shape (N, o)."""
    inputs: FloatArray
    """Shape (N, m)."""


def loaded(law: Law, load: FloatArray) -> Law:
    """The same law with a load at the plant's inputs, shape (m,): the plant receives command plus load."""
    if isinstance(law, TwoLevel):
        step = float(load[0])
        return replace(law, off=law.off + step, on=law.on + step)
    assert isinstance(law, LinearLaw)  # noqa: S101 (callers convert)
    return replace(
        law,
        offset=law.offset + load,
        low=law.low + load,
        high=law.high + load,
        shift=law.shift - law.G @ load,
        drives=None if law.drives is None else law.drives + load,
    )


def taken_by(plant: type[Plant], law: Law) -> Law:
    """The same law where a drive takes less than its limits, of which it does not know.

    Raises:
        PlantError: a drive takes none of its commands.
    """
    low, high = np.array([drive.limits for drive in plant.drives.values()]).T
    if isinstance(law, TwoLevel):
        off_level, on_level = np.clip((law.off, law.on), low[0], high[0]).tolist()
        return replace(law, off=off_level, on=on_level)
    assert isinstance(law, LinearLaw)  # noqa: S101 (callers convert)
    limits = np.array([np.maximum(law.low, low), np.minimum(law.high, high)])
    if not (limits[0] < limits[1]).all():
        raise PlantError("the law's limits leave nothing of what the drives take; give limits within theirs")
    return law if np.array_equal(limits, [law.low, law.high]) else replace(law, drives=limits)


def limits_of(law: Law) -> FloatArray:
    """Least and greatest commands that reach the plant, shape (2, m)."""
    if isinstance(law, LinearLaw) and law.drives is not None:
        return law.drives
    return law.code[LOW : LOW + 2 * law.n_inputs].reshape(2, -1)


def counted_range(output: Output) -> tuple[float, float]:
    """The range that an output must not leave: what is declared safe, its span where nothing is."""
    low, high = (
        safe if math.isfinite(safe) else end for safe, end in zip(output.safe, output.span, strict=True)
    )
    return low, high


def conduct_of(run: Run, size: int, law: Law, plant: type[Plant]) -> dict[str, bool]:
    """What a safe course never does, in words, and whether this one does.

    The run is over a profile of `size` samples and, without noise, longer at its last set-points.
    """
    conduct: dict[str, bool] = {}
    end = size + 2 * (len(run.outputs) - size) // 3
    steps = np.abs(np.diff(run.references, axis=0)).max(axis=0, initial=0.0)
    for j, (name, output) in enumerate(plant.outputs.items()):
        y = run.outputs[:, j]
        low, high = counted_range(output)
        conduct[f"{name} leaves {low:g} to {high:g} {output.unit}"] = not ((low <= y) & (y <= high)).all()
        if isinstance(law, LinearLaw):
            step = steps[j] or LOAD * np.ptp(output.set_points or output.span)
            moves = not np.ptp(y[end:]) <= max(SETTLED * step, _SEEN * output.noise)
            conduct[f"{name} does not settle after the profile"] = moves
    if isinstance(law, TwoLevel):
        u = run.inputs[:, 0]
        away = np.abs(run.outputs[:, 0] - run.references[:, 0])
        gone = np.ptp(u[size:]) == 0 and away[-1] > away[size]
        return conduct | {"it no longer switches": bool(gone or np.ptp(u) == 0)}
    limited = (run.inputs <= limits_of(law)[0]) | (run.inputs >= limits_of(law)[1])
    for i, name in enumerate(plant.drives):
        most = np.mean(limited[:, i]) > _GREATER or limited[end:, i].all()
        conduct[f"{name} is at a limit for the greater part of the time"] = bool(most)
    return conduct


def state_holding(law: Law, references: FloatArray, outputs: FloatArray, inputs: FloatArray) -> FloatArray:
    """The state in which a law gives these commands at these readings for as long as they last, shape (q,).

    A law without integral action has none that fits exactly; then the nearest.
    """
    if isinstance(law, TwoLevel):
        on = float(inputs[0] > 0.5 * (law.off + law.on))
        return np.array([on, law.least_on + law.least_off, float(outputs[0])])
    assert isinstance(law, LinearLaw)  # noqa: S101 (callers convert)
    state_part = law.B @ outputs + law.F @ references + law.G @ inputs + law.shift
    command_part = inputs - law.D @ outputs - law.E @ references - law.offset
    rows = np.vstack([law.C, np.eye(law.n_states) - law.A])
    state: FloatArray = np.linalg.lstsq(rows, np.concatenate([command_part, state_part]), rcond=None)[0]
    return state


def run_law(
    parameters: Parameters,
    law: Law,
    references: FloatArray,
    start: Linear,
    *,
    before: FloatArray,
    states: FloatArray | None = None,
    state: FloatArray | None = None,
    load: FloatArray | None = None,
    disturbances: FloatArray | None = None,
    noise: FloatArray | None = None,
    slow: FloatArray | None = None,
) -> Run:
    """Run a law over set-points, shape (N, r), from where the plant is held, or from other states on.

    The law takes over without a bump at the set-points `before`, shape (r,), the readings and the commands of
    that moment, or begins in its own `state`, shape (q,). `load` acts from the first sample on, shape (m,);
    `noise` is that of readings, shape (N, o), and `slow` is how far the outputs are from the twin's.
    """
    begun = start.rest.states if states is None else states
    inputs = start.rest.inputs
    model = parameters.model
    size = len(references)
    row = model.disturbance_row(disturbances)
    readings: FloatArray = model.kernels.outputs_at(parameters.vector, begun, inputs, row)[0]
    zeros = np.zeros((size, readings.size))
    shaken, apart = (zeros if deviation is None else deviation for deviation in (noise, slow))
    run = simulate_closed_loop(
        parameters,
        references,
        states=begun,
        law=law if load is None else loaded(law, load),
        controller=state_holding(law, before, readings, inputs) if state is None else state,
        disturbances=np.tile(row, (size, 1)),
        sensor=SensorRealisation(shaken + apart, np.zeros(size, dtype=np.bool_), 0.0),
    )
    return Run(references, run.outputs - shaken, run.inputs if load is None else run.inputs - load)


class StepFigures(NamedTuple):
    """How an output follows the steps of its set-point; NaN without a step."""

    overshoot: float
    """Largest distance beyond the new set-point, in the output's unit."""
    settling: float
    """Longest time until it stays within `SETTLED` of a step, s; infinite if it does not before the next."""


def step_figures(reference: FloatArray, output: FloatArray, noise: float, period: float) -> StepFigures:
    """Over all steps of a set-point, each until the next one; arrays of shape (N,)."""
    places = np.flatnonzero(np.diff(reference)) + 1
    beyond = []
    times = []
    for first, last in pairwise([*places, reference.size]):
        step = reference[first] - reference[first - 1]
        error = (output[first:last] - reference[first]) * math.copysign(1.0, step)
        away = np.flatnonzero(~(np.abs(error) <= max(SETTLED * abs(step), _SEEN * noise)))
        beyond.append(max(float(error.max()), 0.0))
        ended = away.size and away[-1] == error.size - 1
        times.append(math.inf if ended else period * (away[-1] + 1 if away.size else 0))
    return StepFigures(max(beyond, default=math.nan), max(times, default=math.nan))


@dataclass(frozen=True, slots=True)
class CourseFigure:
    """What is measured of a course."""

    name: str
    signal: str
    """Name of the output or drive; empty: of the whole loop."""
    unit: str


def quantities_of(
    run: Run, still: Run, loads: Sequence[Run], model_of: Parameters, law: Law
) -> dict[CourseFigure, float]:
    """All figures of a course over a profile, and of those after a load at each input, beside one without."""
    plant = model_of.model.plant
    period = law.period
    figures: dict[CourseFigure, float] = {}
    errors = run.outputs - run.references
    with np.errstate(over="ignore", invalid="ignore"):
        for j, (name, output) in enumerate(plant.outputs.items()):
            steps = step_figures(run.references[:, j], run.outputs[:, j], output.noise, period)
            figures[CourseFigure("mean squared error", name, f"{output.unit}²")] = float(
                np.mean(errors[:, j] ** 2)
            )
            figures[CourseFigure("overshoot", name, output.unit)] = steps.overshoot
            figures[CourseFigure("settling time", name, "s")] = steps.settling
            figures[CourseFigure("lowest", name, output.unit)] = float(run.outputs[:, j].min())
            figures[CourseFigure("highest", name, output.unit)] = float(run.outputs[:, j].max())
            for drive, load in zip(plant.drives, loads, strict=True):
                from_ = "" if len(plant.drives) == 1 else f" at {drive}"
                worst = float(np.abs(load.outputs[:, j] - still.outputs[:, j]).max())
                figures[CourseFigure(f"excursion after a load{from_}", name, output.unit)] = worst
        units = {output.unit for output in plant.outputs.values()}
        if len(plant.outputs) > 1 and len(units) == 1:
            whole = float(np.mean(np.sum(errors**2, axis=1)))
            figures[CourseFigure("mean squared error", "all outputs", f"{units.pop()}²")] = whole
        if isinstance(law, TwoLevel):
            return figures | _cycle(run, next(iter(plant.outputs.values())).unit, period)
        for i, (name, declared) in enumerate(plant.drives.items()):
            u = run.inputs[:, i]
            low, high = limits_of(law)[:, i]
            moved = float(np.abs(np.diff(u)).sum()) * 60.0 / (period * max(u.size - 1, 1))
            figures[CourseFigure("travel a minute", name, declared.unit)] = moved
            limited = float(np.mean((u <= low) | (u >= high)))
            figures[CourseFigure("time at a limit", name, "%")] = 100.0 * limited
    return figures


def _cycle(run: Run, unit: str, period: float) -> dict[CourseFigure, float]:
    """Cycle and switching rate of two levels, over the whole course."""
    on = run.inputs[:, 0] > run.inputs[:, 0].mean()
    starts = np.flatnonzero(~on[:-1] & on[1:])
    cycle = period * float(np.diff(starts).mean()) if starts.size > 1 else math.inf
    swing = [np.ptp(run.outputs[a:b, 0]) for a, b in pairwise(starts)]
    return {
        CourseFigure("cycle", "", "s"): cycle,
        CourseFigure("switchings an hour", "", ""): 3600.0 / period * float(np.mean(on[:-1] != on[1:])),
        CourseFigure("swing of a cycle", "", unit): float(np.median(swing)) if swing else math.nan,
    }
