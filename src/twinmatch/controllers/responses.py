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
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

SETTLED: Final = 0.05
"""Share of a set-point's step within which the output has settled; at least three times its noise."""
LOAD: Final = 0.1
"""Load at an input, as a share of the drive's range."""


class _SafeConduct(Rule):
    """What a safe course does, beside staying in its range.

    Its outputs come to rest, as far as that can be seen in their noise, and its drives are within their
    limits for more than half of the time.
    """

    noise: float = 3.0
    """Movement that counts, in the noise of an output."""
    limited: float = 0.5
    """Share of the time at a limit that is its greater part."""


_SAFE: Final = _SafeConduct()


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
    assert isinstance(law, LinearLaw)  # noqa: S101
    return replace(
        law,
        offset=law.offset + load,
        low=law.low + load,
        high=law.high + load,
        shift=law.shift - law.G @ load,
        drives=None if law.drives is None else law.drives + load,
    )


def taken_by(plant: type[Plant], law: Law) -> Law:
    """The law as it acts on a plant whose drives take less than the law's own limits; the law does not know.

    Raises:
        PlantError: a drive takes none of its commands.
    """
    drive_low, drive_high = np.array(
        [drive.limits for drive in plant.drives.values()]
    ).T
    if isinstance(law, TwoLevel):
        levels = np.clip((law.off, law.on), drive_low[0], drive_high[0]).tolist()
        return replace(law, off=levels[0], on=levels[1])
    assert isinstance(law, LinearLaw)  # noqa: S101
    low = np.maximum(law.low, drive_low)
    high = np.minimum(law.high, drive_high)
    if not (low < high).all():
        raise PlantError(
            "the law's limits leave nothing of what the drives take; give limits within theirs"
        )
    if np.array_equal(low, law.low) and np.array_equal(high, law.high):
        return law
    return replace(law, drives=np.array([low, high]))


def limits_of(law: Law) -> FloatArray:
    """Least and greatest commands that reach the plant, shape (2, m)."""
    if isinstance(law, LinearLaw) and law.drives is not None:
        return law.drives
    return law.code[LOW : LOW + 2 * law.n_inputs].reshape(2, -1)


def counted_range(output: Output) -> tuple[float, float]:
    """The range that an output must not leave: what is declared safe, its span where nothing is."""
    low, high = (
        safe if math.isfinite(safe) else end
        for safe, end in zip(output.safe, output.span, strict=True)
    )
    return low, high


def conduct_of(run: Run, size: int, law: Law, plant: type[Plant]) -> dict[str, bool]:
    """What a safe course never does, in words, and whether this one does.

    The run is over a profile of `size` samples and, without noise, longer at its last set-points.
    """
    conduct: dict[str, bool] = {}
    end = size + 2 * (len(run.outputs) - size) // 3
    for j, (name, output) in enumerate(plant.outputs.items()):
        y = run.outputs[:, j]
        low, high = counted_range(output)
        conduct[f"{name} leaves {low:g} to {high:g} {output.unit}"] = not (
            (low <= y) & (y <= high)
        ).all()
        if isinstance(law, LinearLaw):
            settles = _settles(y[end:], run.references[:, j], output)
            conduct[f"{name} does not settle after the profile"] = not settles
    if isinstance(law, TwoLevel):
        conduct["it no longer switches"] = _stops_switching(run, size)
        return conduct
    low_limits, high_limits = limits_of(law)
    is_limited = (run.inputs <= low_limits) | (run.inputs >= high_limits)
    for i, name in enumerate(plant.drives):
        mostly_limited = (
            np.mean(is_limited[:, i]) > _SAFE.limited or is_limited[end:, i].all()
        )
        conduct[f"{name} is at a limit for the greater part of the time"] = bool(
            mostly_limited
        )
    return conduct


def _settles(last_outputs: FloatArray, references: FloatArray, output: Output) -> bool:
    """Whether an output hardly moves at the end of a course with these set-points, shape (N,)."""
    largest_step = np.abs(np.diff(references)).max(initial=0.0)
    step = largest_step or LOAD * np.ptp(output.set_points or output.span)
    return bool(np.ptp(last_outputs) <= max(SETTLED * step, _SAFE.noise * output.noise))


def _stops_switching(run: Run, size: int) -> bool:
    """Whether two levels never switch, or not after `size` samples while the output departs."""
    u = run.inputs[:, 0]
    distance = np.abs(run.outputs[:, 0] - run.references[:, 0])
    departs = np.ptp(u[size:]) == 0 and distance[-1] > distance[size]
    return bool(departs or np.ptp(u) == 0)


def state_holding(
    law: Law, references: FloatArray, outputs: FloatArray, inputs: FloatArray
) -> FloatArray:
    """The state in which a law gives these commands at these readings for as long as they last, shape (q,).

    A law without integral action has none that fits exactly; then the nearest.
    """
    if isinstance(law, TwoLevel):
        is_on = float(inputs[0] > 0.5 * (law.off + law.on))
        return np.array([is_on, law.least_on + law.least_off, float(outputs[0])])
    assert isinstance(law, LinearLaw)  # noqa: S101
    # u = C·x + D·y + E·r + offset and x = A·x + B·y + F·r + G·u + shift
    of_command = inputs - law.D @ outputs - law.E @ references - law.offset
    of_state = law.B @ outputs + law.F @ references + law.G @ inputs + law.shift
    rows = np.vstack([law.C, np.eye(law.n_states) - law.A])
    state: FloatArray = np.linalg.lstsq(
        rows, np.concatenate([of_command, of_state]), rcond=None
    )[0]
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
    readings: FloatArray = model.kernels.outputs_at(
        parameters.vector, begun, inputs, row
    )[0]
    zeros = np.zeros((size, readings.size))
    reading_noise = zeros if noise is None else noise
    distance = zeros if slow is None else slow
    run = simulate_closed_loop(
        parameters,
        references,
        states=begun,
        law=law if load is None else loaded(law, load),
        controller=state_holding(law, before, readings, inputs)
        if state is None
        else state,
        disturbances=np.tile(row, (size, 1)),
        sensor=SensorRealisation(
            reading_noise + distance, np.zeros(size, dtype=np.bool_), 0.0
        ),
    )
    return Run(
        references,
        run.outputs - reading_noise,
        run.inputs if load is None else run.inputs - load,
    )


class StepFigures(NamedTuple):
    """How an output follows the steps of its set-point; NaN without a step."""

    overshoot: float
    """Largest distance beyond the new set-point, in the output's unit."""
    settling: float
    """Longest time until it stays within `SETTLED` of a step, s; infinite if it does not before the next."""


def step_figures(
    reference: FloatArray, output: FloatArray, noise: float, period: float
) -> StepFigures:
    """How an output follows all steps of its set-point, each until the next one; arrays of shape (N,)."""
    places = np.flatnonzero(np.diff(reference)) + 1
    overshoots = []
    times = []
    for first, last in pairwise([*places, reference.size]):
        step = reference[first] - reference[first - 1]
        error = (output[first:last] - reference[first]) * math.copysign(1.0, step)
        overshoots.append(max(float(error.max()), 0.0))
        times.append(
            period
            * _samples_to_settle(error, max(SETTLED * abs(step), _SAFE.noise * noise))
        )
    return StepFigures(max(overshoots, default=math.nan), max(times, default=math.nan))


def _samples_to_settle(error: FloatArray, tolerance: float) -> float:
    """Samples until an error stays within a tolerance; infinite if it is not there at the end."""
    is_away = ~(np.abs(error) <= tolerance)  # true for NaN, too
    if is_away[-1]:
        return math.inf
    return float(np.flatnonzero(is_away)[-1] + 1) if is_away.any() else 0.0


@dataclass(frozen=True, slots=True)
class CourseFigure:
    """What is measured of a course."""

    name: str
    signal: str
    """Name of the output or drive; empty: of the whole loop."""
    unit: str


def quantities_of(
    run: Run, still: Run, loads: Sequence[Run], twin: Parameters, law: Law
) -> dict[CourseFigure, float]:
    """All figures of a law on a twin.

    They are taken from its `run` over a profile, and from its runs after a load at each input (`loads`)
    beside the one without a load (`still`).
    """
    plant = twin.model.plant
    outputs = list(plant.outputs.values())
    figures: dict[CourseFigure, float] = {}
    with np.errstate(over="ignore", invalid="ignore"):
        for j, (name, output) in enumerate(plant.outputs.items()):
            figures |= _figures_of_output(run, j, name, output, law.period)
            for drive_name, load in zip(plant.drives, loads, strict=True):
                place = "" if len(plant.drives) == 1 else f" at {drive_name}"
                excursion = CourseFigure(
                    f"excursion after a load{place}", name, output.unit
                )
                figures[excursion] = float(
                    np.abs(load.outputs[:, j] - still.outputs[:, j]).max()
                )
        if len(outputs) > 1 and len({output.unit for output in outputs}) == 1:
            error_of_all = CourseFigure(
                "mean squared error", "all outputs", f"{outputs[0].unit}²"
            )
            figures[error_of_all] = _mean_squared_error(run)
        if isinstance(law, TwoLevel):
            return figures | _cycle(run, outputs[0].unit, law.period)
        for i, (name, drive) in enumerate(plant.drives.items()):
            figures |= _figures_of_drive(
                run.inputs[:, i], limits_of(law)[:, i], name, drive.unit, law.period
            )
    return figures


def _mean_squared_error(run: Run) -> float:
    """Sum over the outputs, in the mean over the samples."""
    errors = run.outputs - run.references
    return float(np.mean(np.sum(errors**2, axis=1)))


def _figures_of_output(
    run: Run, j: int, name: str, output: Output, period: float
) -> dict[CourseFigure, float]:
    """The figures of output number j over a profile."""
    reference = run.references[:, j]
    y = run.outputs[:, j]
    steps = step_figures(reference, y, output.noise, period)
    return {
        CourseFigure("mean squared error", name, f"{output.unit}²"): float(
            np.mean((y - reference) ** 2)
        ),
        CourseFigure("overshoot", name, output.unit): steps.overshoot,
        CourseFigure("settling time", name, "s"): steps.settling,
        CourseFigure("lowest", name, output.unit): float(y.min()),
        CourseFigure("highest", name, output.unit): float(y.max()),
    }


def _figures_of_drive(
    u: FloatArray, limits: FloatArray, name: str, unit: str, period: float
) -> dict[CourseFigure, float]:
    """The figures of one command of a linear law, shape (N,), within its limits, shape (2,)."""
    low, high = limits
    travel = float(np.abs(np.diff(u)).sum()) * 60.0 / (period * max(u.size - 1, 1))
    share_limited = float(np.mean((u <= low) | (u >= high)))
    return {
        CourseFigure("travel a minute", name, unit): travel,
        CourseFigure("time at a limit", name, "%"): 100.0 * share_limited,
    }


def _cycle(run: Run, unit: str, period: float) -> dict[CourseFigure, float]:
    """Cycle and switching rate of two levels, over the whole course."""
    is_on = run.inputs[:, 0] > run.inputs[:, 0].mean()
    starts = np.flatnonzero(~is_on[:-1] & is_on[1:])
    cycle = period * float(np.diff(starts).mean()) if starts.size > 1 else math.inf
    swings = [np.ptp(run.outputs[first:last, 0]) for first, last in pairwise(starts)]
    swing = float(np.median(swings)) if swings else math.nan
    switchings = 3600.0 / period * float(np.mean(is_on[:-1] != is_on[1:]))
    return {
        CourseFigure("cycle", "", "s"): cycle,
        CourseFigure("switchings an hour", "", ""): switchings,
        CourseFigure("swing of a cycle", "", unit): swing,
    }
