"""The course to record first: a rest, then steps of the input that keep a plant in its range which is known
only by its file, or by a recording that leaves much open."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from twinmatch.controllers.answer import ControllerError
from twinmatch.controllers.responses import counted_range
from twinmatch.dynamics import Parameters, Plant, begin, simulate_driven
from twinmatch.signals import BoolArray, FloatArray

FACTOR: Final = 2.0
"""Factor by which a value of a plant file that nothing was recorded of may be wrong, one standard
deviation."""
_SHARES: Final = tuple(np.linspace(1.0, 0.05, 20).tolist())
"""Sizes of a step that are considered, the largest first, as shares of what the drive has on that side."""
_KEPT: Final = 0.95
"""Share of the draws that have to stay in the range."""
_MARGIN: Final = 0.1
"""Share of the range that is kept free at both ends."""
_APART: Final = 20.0
"""Least distance from where the output rests to the ends of the range, in its noise."""
_SHOWN: Final = 20.0
"""Movement from which a step shows well, in the output's noise."""


@dataclass(frozen=True, eq=False)
class FirstCourse:
    """A rest and steps of a drive, with what the output may do meanwhile."""

    plant: type[Plant]
    levels: tuple[float, ...]
    """Levels of the drive; the first is its rest."""
    holds: tuple[float, ...]
    """How long each of them is held, s."""
    ends: tuple[float, float]
    """Range that the output is to keep."""
    band: tuple[float, float]
    """Lowest and highest output of nine draws in ten."""
    size: float
    """Movement of the output in the middle of the draws."""

    @property
    def duration(self) -> float:
        """Its length, s."""
        return float(sum(self.holds))

    @property
    def shows(self) -> bool:
        """Whether it moves the output far above its noise."""
        return self.size >= _SHOWN * self.plant.output.noise

    def inputs(self, period: float) -> FloatArray:
        """The input sample by sample, shape (N,), for a sample time, s."""
        counts = [max(round(hold / period), 1) for hold in self.holds]
        return np.repeat(self.levels, counts)


def draws_of_file(plant: type[Plant], number: int, seed: int = 31) -> list[Parameters]:
    """Parameters that a plant file allows before anything was recorded: draws around its typical values, in
    turn in each structure that is watched, within the bounds.

    A value counts as known up to a factor of `FACTOR`. Where zero is arbitrary, as that of the output at
    rest, the typical value stays: a course begins where the plant rests, wherever that is.
    """
    rng = np.random.default_rng(seed)
    names = [name for name, structure in plant.structures.items() if structure.watched]
    draws = []
    for k in range(number):
        model = plant.model(names[k % len(names)])
        typical = model.typical()
        values = {}
        for name in model.structure.free:
            declared = model.declared[name]
            if declared.relative:
                low, high = declared.bounds
                value = typical[name] * FACTOR ** float(rng.standard_normal())
                values[name] = min(max(value, low), high)
        draws.append(typical.replace(**values))
    return draws


def first_course(
    draws: Sequence[Parameters],
    before: float,
    shape: Sequence[tuple[float, float]],
    period: float,
    within: Sequence[float] | None = None,
) -> FirstCourse:
    """The largest course of a shape that keeps nearly all draws in the range.

    Args:
        draws: what the plant may be; all of one plant with one output and one drive.
        before: the output until now.
        shape: levels as shares of the largest, each with its duration, s; the first is the rest.
        period: the sample time, s.
        within: narrower range of the output; None: what counts as safe.

    Raises:
        ControllerError: the range is empty, or even the smallest step would leave it.
    """
    plant = draws[0].model.plant
    low, high = counted_range(plant.output)
    if within is not None:
        low = max(low, within[0])
        high = min(high, within[1])
    if not low < high:
        raise ControllerError(
            "experiment: the range leaves nothing of the safe one; give LOW below HIGH, inside it"
        )
    margin = _MARGIN * (high - low)
    apart = _APART * plant.output.noise
    ends = (
        max(low, min(low + margin, before - apart)),
        min(high, max(high - margin, before + apart)),
    )
    search = _CourseSearch(tuple(draws), before, tuple(shape), period, ends)
    for largest in _largest_levels(plant):
        course = search.course(largest)
        if course is not None:
            return course
    raise ControllerError(
        f"experiment: even a small step of {plant.drive.name} may leave {low:g} to {high:g} "
        f"{plant.output.unit} from {before:g} on; widen `safe` in the plant file, or begin further from its "
        "ends"
    )


@dataclass(frozen=True, eq=False)
class _CourseSearch:
    """Courses of one shape on what a plant may be."""

    draws: tuple[Parameters, ...]
    before: float
    """Output until now."""
    shape: tuple[tuple[float, float], ...]
    """Levels as shares of the largest, each with its duration, s."""
    period: float
    """Sample time, s."""
    ends: tuple[float, float]
    """Range that the output is to keep."""

    @property
    def plant(self) -> type[Plant]:
        return self.draws[0].model.plant

    def course(self, largest: float) -> FirstCourse | None:
        """The course with this largest level; None if too many draws leave the range."""
        planned = self._planned(largest)
        outputs = self._outputs(planned)
        if np.mean(self._keep(outputs, self._calm_outputs)) < _KEPT:
            return None
        low = float(np.quantile(outputs.min(axis=1), 0.05))
        high = float(np.quantile(outputs.max(axis=1), 0.95))
        return replace(
            planned, band=(low, high), size=float(np.median(np.ptp(outputs, axis=1)))
        )

    def _planned(self, largest: float) -> FirstCourse:
        """The course with this largest level, of which nothing is known yet."""
        rest = self.plant.drive.rest
        levels = tuple(
            float(f"{rest + share * (largest - rest):.3g}") for share, _ in self.shape
        )
        holds = tuple(hold for _, hold in self.shape)
        return FirstCourse(self.plant, levels, holds, self.ends, self.ends, 0.0)

    def _outputs(self, course: FirstCourse) -> FloatArray:
        """The outputs of every draw, shape (draws, N); what is not finite counts as infinite."""
        inputs = course.inputs(self.period)
        courses = []
        for draw in self.draws:
            states = begin(draw, self.before)
            courses.append(
                simulate_driven(draw, inputs, states=states, period=self.period).output
            )
        return np.nan_to_num(np.array(courses), nan=math.inf)

    @cached_property
    def _calm_outputs(self) -> FloatArray:
        """The outputs of every draw if nothing is moved, shape (draws, N)."""
        return self._outputs(self._planned(self.plant.drive.rest))

    def _keep(self, outputs: FloatArray, calm: FloatArray) -> BoolArray:
        """Which draws stay in the range, or leave it no further than if nothing were moved: that is not the
        course's doing. Shape (draws,)."""
        low, high = self.ends
        # The approximation of a dead time first moves the other way by a part of the step.
        slack = _APART * self.plant.output.noise
        is_above = (outputs > high) & (outputs > calm + slack)
        is_below = (outputs < low) & (outputs < calm - slack)
        return np.asarray(~np.any(is_above | is_below, axis=1))


def _largest_levels(plant: type[Plant]) -> list[float]:
    """Levels of the drive to which a step may go: towards the end that is further from rest, the largest
    first; then towards the other one."""
    rest = plant.drive.rest
    ends = sorted(plant.drive.limits, key=lambda end: -abs(end - rest))
    levels = []
    for end in ends:
        if end != rest:
            levels += [float(f"{rest + share * (end - rest):.3g}") for share in _SHARES]
    return levels
