"""What a law is guaranteed to stabilise beyond the twins it was tried on: b(P, C) against ν-gaps.

Vinnicombe's theorem: a law that stabilises P with margin b(P, C) stabilises every linear plant whose ν-gap
to P is smaller than b. P is here one twin at one operating point, the one in the middle; the plants compared
with it are all twins at all operating points, and some draws of each. The theorem is about small movements
within the limits of the drives; the units are those that prove most.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from twinmatch.comparing import Scaling, StateSpace, best_scaling, having_value, matrix_nu_gap, spans_of
from twinmatch.comparing.matrix_gap import beside, frequencies_of, gaps_of
from twinmatch.comparing.state_space import half_plane
from twinmatch.controllers.stability import MemberStability, Point
from twinmatch.dynamics import LinearLaw, Plant

MAX_SEARCHED: Final = 24
"""Plants with which units are searched; the gaps are then those to all."""


class Guarantee(NamedTuple):
    """A margin, the ν-gaps it is compared with, and what they are between."""

    member: str
    """Name of the twin in the middle."""
    point: Point
    """Its operating point."""
    scaling: Scaling
    """The units, b(P, C), and the largest ν-gap to a twin at any of the operating points."""
    drawn: float
    """The largest ν-gap to a draw."""
    plants: int
    """Number of plants compared, twins at operating points and draws."""

    @property
    def holds(self) -> bool:
        """Whether the margin is greater than all gaps."""
        return self.scaling.margin > max(self.scaling.gap, self.drawn)


@having_value("the margin beside the gaps between the plants")
def guarantee_of(plant: type[Plant], stability: Sequence[MemberStability], law: LinearLaw) -> Guarantee:
    """The margin at the plant in the middle, in the units in which it exceeds the ν-gaps most.

    Raises:
        DiscriminationError: a plant or the law has no valid linear model, or a gap or margin has no value.
    """
    named = [(loop.member.name, point, linear) for loop in stability for point, linear in loop.plants.items()]
    spaces = [StateSpace.of(linear) for *_, linear in named]
    outputs, inputs = spans_of(plant)
    middle = _middle([space.scaled(outputs, inputs) for space in spaces])
    name, point, _ = named[middle]
    origin = spaces[middle]
    controller = StateSpace.of(law)
    stride = max(len(spaces) // MAX_SEARCHED, 1)
    best = best_scaling(origin, spaces[::stride], controller, outputs=outputs, inputs=inputs)
    scaled = origin.scaled(best.outputs, best.inputs)

    def largest(systems: Sequence[StateSpace]) -> float:
        gaps = (matrix_nu_gap(scaled, system.scaled(best.outputs, best.inputs)) for system in systems)
        return max(gaps, default=0.0)

    draws = [StateSpace.of(linear) for loop in stability for linear in loop.others]
    gap = best.gap if stride == 1 else largest(spaces)
    scaling = best._replace(gap=gap)
    return Guarantee(name, point, scaling, largest(draws), len(spaces) + len(draws))


def _middle(spaces: Sequence[StateSpace]) -> int:
    """Number of the system whose largest pointwise gap to another is smallest."""
    mapped = half_plane(*spaces)
    poles = np.concatenate([np.linalg.eigvals(system.A) for system in mapped])
    frequencies = beside(frequencies_of(poles)[::4], poles)
    responses = np.array([system.response(frequencies) for system in mapped])
    size = len(mapped)
    flat = responses.reshape(-1, *responses.shape[2:])
    worst = [
        gaps_of(np.tile(responses[k], (size, 1, 1)), flat).max() for k in range(size)
    ]  # fmt: skip
    return int(np.argmin(worst))
