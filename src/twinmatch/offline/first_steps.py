"""What to do before a twin is trusted: which course to record, and which PID to begin with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from twinmatch.controllers import (
    ControllerAnswer,
    ControllerDecision,
    ControllerError,
    ControllerQuestion,
    Holding,
    TriedTwin,
    try_controller,
)
from twinmatch.controllers.first_course import FirstCourse, draws_of_file, first_course
from twinmatch.controllers.first_pid import FirstPid, first_pid, reduced
from twinmatch.controllers.responses import counted_range
from twinmatch.dynamics import Parameters, Plant, begin, simulate_driven
from twinmatch.dynamics.pace import plant_scale
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import FittingError, StructureFit, fit_session
from twinmatch.offline.controllers import FITS, Ground, usual_profile
from twinmatch.offline.separation import Inseparable, inseparable_in
from twinmatch.signals import stretches
from twinmatch.twin import TwinSettings
from twinmatch.twin.schedule import ScheduleSettings

_NUMBER: Final = 60
"""Draws of what a plant file, or a recording, leaves open."""
_SLOWER: Final = (1.0, 2.0, 4.0, 8.0)
"""Factors on the time constant of the loop that is asked for, until a PID is safe."""
_BEYOND: Final = 0.5
"""How far beyond the readings a course may go, as a share of their range."""
_ANSWERED: Final = 3.0
"""Time for which a step is held, in the plant's lag and dead time: 95 % of the way."""
_SETTLED: Final = 10.0
"""Time after which a plant rests, in its time constants."""
_LATER_HOLD: Final = 0.6
"""Length of the later steps, as a share of that of the first."""


@dataclass(frozen=True, eq=False)
class ProposedPid:
    """A first PID, tried on everything that is possible."""

    pid: FirstPid
    answer: ControllerAnswer
    level: float
    """Output around which it was tried."""


@dataclass(frozen=True, eq=False)
class FirstSteps:
    """What is known of a recording whose twin is not trusted, and what to do next."""

    reason: str
    """Why the twin is not trusted."""
    inseparable: Inseparable | None
    twins: tuple[TriedTwin, ...]
    course: FirstCourse
    pid: ProposedPid | None
    """None if no PID is safe on all that is possible."""
    why_no_pid: str = ""


def course_from_file(
    plant: type[Plant],
    period: float | None = None,
    within: Sequence[float] | None = None,
) -> tuple[FirstCourse, float]:
    """The first course of a plant of which nothing is recorded, and the sample time that it is made for, s.

    Raises:
        ControllerError: the plant has several loops, or no step keeps its range.
    """
    _require_single(plant)
    sampling = period or _usual_period(plant)
    schedule = ScheduleSettings.of(plant, sampling)
    draws = draws_of_file(plant, _NUMBER)
    before = _resting_output(plant.model().typical(), sampling)
    rest = schedule.min_span + schedule.lead
    shape = ((0.0, rest * sampling), (1.0, schedule.span * sampling))
    return first_course(draws, before, shape, sampling, within), sampling


def first_steps(
    ground: Ground, reason: str, within: Sequence[float] | None = None
) -> FirstSteps:
    """What to record after a recording whose twin is not trusted, for this `reason`, and a first PID.

    Raises:
        ControllerError: the plant has several loops, no structure can be fitted, or no step keeps the range.
    """
    plant = ground.plant
    _require_single(plant)
    assert ground.terms is not None  # noqa: S101
    settings = ground.terms.settings
    windows = stretches(ground.session.samples, ground.session.period)
    twins = _loose_twins(ground)
    draws: list[Parameters] = []
    for number, twin in enumerate(twins):
        drawn = twin.drawn(max(_NUMBER // len(twins), 1), number)
        draws += [draw for draw in drawn if _is_within_bounds(draw, twin.free)] or [
            twin.parameters
        ]
    before = float(ground.session.samples[0].output)
    kept = _near_readings(ground) if within is None else within
    shape = _shape_after_log(settings, _response_time(ground, twins))
    course = first_course(draws, before, shape, settings.period, kept)
    pid, why_no_pid = pid_or_reason(ground, twins)
    return FirstSteps(
        reason, inseparable_in(windows, plant), twins, course, pid, why_no_pid
    )


def _is_within_bounds(draw: Parameters, free: Sequence[str]) -> bool:
    """Whether the free parameters are within the bounds of the plant file."""
    declared = draw.model.declared
    return all(
        declared[name].bounds[0] <= draw[name] <= declared[name].bounds[1]
        for name in free
    )


def _near_readings(ground: Ground) -> tuple[float, float]:
    """The range of the readings and a part of it on both sides: farther nobody has been yet."""
    outputs = [sample.output for sample in ground.session.samples]
    beyond = _BEYOND * (max(outputs) - min(outputs))
    return min(outputs) - beyond, max(outputs) + beyond


def pid_or_reason(
    ground: Ground, twins: Sequence[TriedTwin]
) -> tuple[ProposedPid | None, str]:
    """A first PID that is safe on all twins and their draws; without one why."""
    level = _middle(ground)
    low, high = counted_range(ground.plant.output)
    if not low < level < high:
        return (
            None,
            f"the recording lies outside the safe range {low:g} to {high:g} {ground.plant.output.unit}",
        )
    period = ground.session.period
    holding = Holding(None, period, ground.holding.samples)
    reason = ""
    for slower in _SLOWER:
        try:
            pid = first_pid(twins, [level], holding, slower)
            answer = _tried(pid, twins, level, holding, ground.plant)
        except TwinmatchError as error:
            return None, str(error)
        if answer.decision is ControllerDecision.SAFE:
            return ProposedPid(pid, answer, level), ""
        reason = answer.sentence
    return None, reason


def _tried(
    pid: FirstPid,
    twins: Sequence[TriedTwin],
    level: float,
    holding: Holding,
    plant: type[Plant],
) -> ControllerAnswer:
    levels = np.array([level])
    references = usual_profile(plant, levels, holding.samples)
    # courses begin where it is held
    rested = [replace(twin, states=None, inputs=None) for twin in twins]
    return try_controller(
        rested, ControllerQuestion(pid.gains, references, levels, holding, draws=100)
    )


def _require_single(plant: type[Plant]) -> None:
    if not plant.single:
        raise ControllerError(
            f"experiment: plant {plant.name} has {len(plant.outputs)} outputs and {len(plant.drives)} "
            "inputs; before a twin is trusted, a course is proposed for one of each: record steps of every "
            "input, one after the other"
        )


def _usual_period(plant: type[Plant]) -> float:
    """The sample time of the plant's loop, s; of another one a hundredth of its time constant."""
    if plant.loop is not None:
        return float(plant.loop.period)
    return float(f"{plant_scale(plant, 1.0):.2g}")


def _resting_output(parameters: Parameters, period: float) -> float:
    """The output with the drive at rest, once it has come to rest."""
    model = parameters.model
    low, high = model.plant.output.span
    samples = round(_SETTLED * 100.0 * plant_scale(model.plant, period) / period)
    states = begin(parameters, 0.5 * (low + high))
    run = simulate_driven(
        parameters, np.tile(model.rest, (samples, 1)), states=states, period=period
    )
    return float(run.output[-1])


def _shape_after_log(
    settings: TwinSettings, response_time: float
) -> tuple[tuple[float, float], ...]:
    """A rest and a step, what a twin is matched to; then four other levels, on which its forecasts are
    tested. Steps are held for as long as a window, and until the plant has answered."""
    schedule = settings.schedule
    rest = (schedule.min_span + schedule.lead) * settings.period
    hold = max(schedule.span * settings.period, _ANSWERED * response_time)
    later = _LATER_HOLD * hold
    return (
        (0.0, rest),
        (1.0, hold),
        (0.2, later),
        (0.6, later),
        (0.35, later),
        (0.8, later),
    )


def _response_time(ground: Ground, twins: Sequence[TriedTwin]) -> float:
    """Lag and dead time of the slowest twin in the middle of the readings, s; 0 if none can be held there."""
    holding = Holding(None, ground.session.period, ground.holding.samples)
    times = [0.0]
    for twin in twins:
        try:
            plant = reduced(
                holding.linear(twin.parameters, [_middle(ground)], twin.disturbances)
            )
        except TwinmatchError:
            continue
        times.append(plant.lag + plant.dead_time)
    return max(times)


def _middle(ground: Ground) -> float:
    """The output in the middle of the readings."""
    outputs = [sample.output for sample in ground.session.samples]
    return 0.5 * (min(outputs) + max(outputs))


def _loose_twins(ground: Ground) -> tuple[TriedTwin, ...]:
    """Fits to the whole recording of the structures that explain it, with the plant file's typical values as
    prior; each with its covariance."""
    plant = ground.plant
    windows = stretches(ground.session.samples, ground.session.period)
    fits: list[StructureFit] = []
    error = "there is no structure"
    for name, structure in plant.structures.items():
        if structure.external is None:
            try:
                fits.append(fit_session(plant.model(name), windows))
            except TwinmatchError as reason:
                error = str(reason)
    if not fits:
        raise FittingError(f"session {ground.session.name}: {error}")
    least = min(fit.charge for fit in fits)
    newest = ground.session.samples[-1].disturbances
    row = np.array(newest) if newest else None
    twins = []
    for fit in fits:
        if fit.charge <= least + FITS.most_charge:
            free = fit.model.structure.free
            twin = TriedTwin(
                fit.model.structure_name,
                fit.parameters,
                free,
                fit.covariance,
                disturbances=row,
            )
            twins.append(ground.seen_by(twin))
    return tuple(twins)
