"""Whether a law holds every twin that a recording allows, and on what that hangs where it is open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from twinmatch.controllers.members import Holding, TriedTwin
from twinmatch.controllers.whole_loop import ChannelMargins, WholeLoop
from twinmatch.dynamics import Linear, LinearLaw, Parameters, PlantError, begin, simulate_driven
from twinmatch.signals import FloatArray

MAX_UNSTABLE: Final = 0.01
"""Share of unstable draws up to which a law is sound on a twin; from one minus that on it fails."""
COMPARED: Final = 2
"""Draws of each twin whose plants are kept, to be compared with others."""
STEP: Final = 0.1
"""Step of a drive that is suggested, as a share of its range."""
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
    row = member.disturbances
    loops, error = _loops(member.parameters, law, points, holding, row)
    if not loops:
        raise PlantError(error)
    sizes = {point: loop.eigenvalue for point, loop in loops.items()}
    worst = max(sizes, key=sizes.__getitem__)
    margins = [loop.margins() for loop in loops.values()]
    held_draws = [(draw, _loops(draw, law, list(loops), holding, row)[0]) for draw in drawn]
    held_draws = [(draw, loops_of_draw) for draw, loops_of_draw in held_draws if loops_of_draw] or [
        (member.parameters, loops)
    ]
    return MemberStability(
        member,
        sizes[worst],
        worst,
        tuple(draw for draw, _ in held_draws),
        np.array(
            [max(loop.eigenvalue for loop in loops_of_draw.values()) for _, loops_of_draw in held_draws]
        ),
        tuple(_least(channel) for channel in zip(*margins, strict=True)),
        max(loop.sensitivity() for loop in loops.values()),
        {point: loop.plant for point, loop in loops.items()},
        tuple(loop.plant for _, loops_of_draw in held_draws[:COMPARED] for loop in loops_of_draw.values()),
    )


def _loops(
    parameters: Parameters, law: LinearLaw, points: Sequence[Point], holding: Holding, row: FloatArray | None
) -> tuple[dict[Point, WholeLoop], str]:
    """The loop at every point at which the plant can be held, and why not at another."""
    loops = {}
    error = ""
    for point in points:
        try:
            loops[point] = WholeLoop(holding.linear(parameters, point, row), law)
        except PlantError as found:
            error = str(found)
    return loops, error


def _least(margins: Sequence[ChannelMargins]) -> ChannelMargins:
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


def open_question(found: MemberStability, point: Sequence[float], holding: Holding) -> OpenQuestion:
    """The parameter that decides over the draws, and the step after which the outputs show it most."""
    free = found.member.free
    drawn = found.drawn
    values = np.array([[draw[name] for name in free] for draw in drawn])
    spread = values.std(axis=0)
    finite = np.isfinite(found.eigenvalues)
    sizes = np.where(finite, found.eigenvalues, 2.0)
    with np.errstate(all="ignore"):
        moved = (values - values.mean(axis=0)) / spread
        related = np.nan_to_num(np.abs(moved.T @ (sizes - sizes.mean())))
    name = free[int(np.argmax(related))]
    ends = [drawn[int(f(values[:, free.index(name)]))] for f in (np.argmin, np.argmax)]
    parameters = found.member.parameters
    shown = {}
    for drive, declared in parameters.model.plant.drives.items():
        step = STEP * (declared.limits[1] - declared.limits[0])
        pair = [parameters.replace(**{name: end[name]}) for end in ends]
        shown[drive] = (_difference(pair, drive, step, point, holding), step)
    best = max(shown, key=lambda drive: shown[drive][0])
    return OpenQuestion(name, best, shown[best][1])


def _difference(
    pair: Sequence[Parameters], drive: str, step: float, point: Sequence[float], holding: Holding
) -> float:
    """RMS difference of two plants after a step of a drive, in the outputs' noise."""
    model = pair[0].model
    change = np.array([step * (name == drive) for name in model.plant.drives])
    moves: list[FloatArray] = []
    for parameters in pair:
        states = begin(parameters, point)
        runs = (
            simulate_driven(
                parameters,
                np.tile(model.rest + movement, (holding.samples, 1)),
                states=states,
                period=holding.period,
            )
            for movement in (0.0 * change, change)
        )
        moves.append(np.subtract(*(run.outputs for run in runs)))
    return float(np.sqrt(np.mean(((moves[0] - moves[1]) / model.noise) ** 2)))
