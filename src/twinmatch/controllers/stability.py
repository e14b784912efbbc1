"""Whether a law holds every twin that a recording allows, and on what that hangs where it is open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import Final

import numpy as np

from twinmatch.controllers.members import Holding, TriedTwin
from twinmatch.controllers.whole_loop import ChannelMargins, WholeLoop
from twinmatch.dynamics import (
    Linear,
    LinearLaw,
    Parameters,
    PlantError,
    begin,
    simulate_driven,
)
from twinmatch.signals import FloatArray

MAX_UNSTABLE: Final = 0.01
"""Share of unstable draws up to which a law is sound on a twin; from one minus that on it fails."""
COMPARED: Final = 2
"""Draws of each twin whose plants are kept, to be compared with others."""
STEP: Final = 0.1
"""Step of a drive that is suggested, as a share of its range."""
UNBOUNDED: Final = 2.0
"""Eigenvalue as which an infinite one counts beside finite ones: unstable, and still with a mean."""
Point = tuple[float, ...]
"""An operating point: a level for each output."""


@dataclass(frozen=True, eq=False)
class MemberStability:
    """The whole loop of a law with one twin, over all operating points."""

    member: TriedTwin
    eigenvalue: float
    """The largest, over the points, with the twin's own parameters."""
    point: Point
    """Where that is."""
    drawn: tuple[Parameters, ...]
    """The draws that can be held at one of these points at least."""
    eigenvalues: FloatArray
    """The largest of every draw, shape (draws,)."""
    margins: tuple[ChannelMargins, ...]
    """The least over the points, of every command; with the twin's own parameters."""
    sensitivity: float
    """Maximum sensitivity of the whole loop."""
    plants: Mapping[Point, Linear]
    """The twin, linearised at the operating points at which it can be held."""
    others: tuple[Linear, ...]
    """Some draws, likewise."""

    @cached_property
    def unstable(self) -> float:
        """Probability that the loop is unstable."""
        return float(np.mean(self.eigenvalues >= 1.0))

    @property
    def fails(self) -> bool:
        """Whether the loop is unstable, as far as the recording tells."""
        return self.eigenvalue >= 1.0 and self.unstable >= 1.0 - MAX_UNSTABLE

    @property
    def sound(self) -> bool:
        """Whether the loop is stable, as far as the recording tells."""
        return self.eigenvalue < 1.0 and self.unstable <= MAX_UNSTABLE


def stability_of(
    member: TriedTwin,
    law: LinearLaw,
    points: Sequence[Point],
    holding: Holding,
    drawn: Sequence[Parameters],
) -> MemberStability:
    """The whole loop at those operating points at which the twin can be held.

    Raises:
        PlantError: it can be held at none of them.
    """
    disturbances = member.disturbances
    loops, error = _loops(member.parameters, law, points, holding, disturbances)
    if not loops:
        raise PlantError(error)
    sizes = {point: loop.eigenvalue for point, loop in loops.items()}
    worst = max(sizes, key=sizes.__getitem__)
    margins = [loop.margins() for loop in loops.values()]
    held_draws = []
    loops_of_draws = []
    for draw in drawn:
        loops_of_draw, _ = _loops(draw, law, list(loops), holding, disturbances)
        if loops_of_draw:
            held_draws.append(draw)
            loops_of_draws.append(list(loops_of_draw.values()))
    if not held_draws:
        held_draws = [member.parameters]
        loops_of_draws = [list(loops.values())]
    return MemberStability(
        member=member,
        eigenvalue=sizes[worst],
        point=worst,
        drawn=tuple(held_draws),
        eigenvalues=np.array(
            [_largest_eigenvalue(loops_of_draw) for loops_of_draw in loops_of_draws]
        ),
        margins=tuple(
            _least_margins(channel) for channel in zip(*margins, strict=True)
        ),
        sensitivity=max(loop.sensitivity() for loop in loops.values()),
        plants={point: loop.plant for point, loop in loops.items()},
        others=tuple(
            loop.plant for loop in chain.from_iterable(loops_of_draws[:COMPARED])
        ),
    )


def _largest_eigenvalue(loops: Sequence[WholeLoop]) -> float:
    return max(loop.eigenvalue for loop in loops)


def _loops(
    parameters: Parameters,
    law: LinearLaw,
    points: Sequence[Point],
    holding: Holding,
    disturbances: FloatArray | None,
) -> tuple[dict[Point, WholeLoop], str]:
    """The loop at every point at which the plant can be held, and why it cannot at the last other one."""
    loops = {}
    error = ""
    for point in points:
        try:
            loops[point] = WholeLoop(
                holding.linear(parameters, point, disturbances), law
            )
        except PlantError as reason:
            error = str(reason)
    return loops, error


def _least_margins(margins: Sequence[ChannelMargins]) -> ChannelMargins:
    """What remains of each margin where it is least."""
    return ChannelMargins(
        max(m.gain_down for m in margins),
        min(m.gain_up for m in margins),
        min(m.delay for m in margins),
        max(m.sensitivity for m in margins),
    )


@dataclass(frozen=True, slots=True)
class OpenQuestion:
    """What a decision hangs on, and the experiment that would settle it."""

    parameter: str
    """Name of the parameter with which the largest eigenvalue moves most."""
    drive: str
    """Name of the drive whose step shows that parameter most."""
    step: float
    """That step, in the drive's unit."""


def open_question(
    stability: MemberStability, point: Sequence[float], holding: Holding
) -> OpenQuestion:
    """The parameter that decides over the draws, and the step after which the outputs show it most."""
    name = _deciding_parameter(stability)
    values = [draw[name] for draw in stability.drawn]
    parameters = stability.member.parameters
    lowest = parameters.replace(**{name: min(values)})
    highest = parameters.replace(**{name: max(values)})
    steps = {
        drive: STEP * (declared.limits[1] - declared.limits[0])
        for drive, declared in parameters.model.plant.drives.items()
    }
    differences = {
        drive: _difference((lowest, highest), drive, step, point, holding)
        for drive, step in steps.items()
    }
    best = max(differences, key=differences.__getitem__)
    return OpenQuestion(name, best, steps[best])


def _deciding_parameter(stability: MemberStability) -> str:
    """Name of the open parameter with which the largest eigenvalue moves most over the draws."""
    free = stability.member.free
    rows = []
    for draw in stability.drawn:
        rows.append([draw[name] for name in free])
    values = np.array(rows)
    sizes = np.where(
        np.isfinite(stability.eigenvalues), stability.eigenvalues, UNBOUNDED
    )
    with np.errstate(all="ignore"):
        deviations = (values - values.mean(axis=0)) / values.std(axis=0)
        related = np.nan_to_num(np.abs(deviations.T @ (sizes - sizes.mean())))
    return free[int(np.argmax(related))]


def _difference(
    pair: tuple[Parameters, Parameters],
    drive: str,
    step: float,
    point: Sequence[float],
    holding: Holding,
) -> float:
    """RMS difference of two plants after a step of a drive, in the outputs' noise."""
    model = pair[0].model
    change = np.array([step * (name == drive) for name in model.plant.drives])
    first = _movement(pair[0], change, point, holding)
    second = _movement(pair[1], change, point, holding)
    return float(np.sqrt(np.mean(((first - second) / model.noise) ** 2)))


def _movement(
    parameters: Parameters, change: FloatArray, point: Sequence[float], holding: Holding
) -> FloatArray:
    """The outputs without a change of the inputs minus those after it, shape (N, o)."""
    states = begin(parameters, point)
    size = holding.samples
    rest = parameters.model.rest
    still = simulate_driven(
        parameters, np.tile(rest, (size, 1)), states=states, period=holding.period
    )
    driven = simulate_driven(
        parameters,
        np.tile(rest + change, (size, 1)),
        states=states,
        period=holding.period,
    )
    return np.asarray(still.outputs - driven.outputs)
