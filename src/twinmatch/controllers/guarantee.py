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

from twinmatch.comparing import (
    Scaling,
    StateSpace,
    best_scaling,
    having_value,
    matrix_nu_gap,
    spans_of,
)
from twinmatch.comparing.matrix_gap import beside, frequencies_of, gaps_of
from twinmatch.comparing.state_space import half_plane
from twinmatch.controllers.stability import MemberStability, Point
from twinmatch.dynamics import LinearLaw, Plant

MAX_SEARCHED: Final = 24
"""Plants with which units are searched; the gaps are then those to all."""
_MIDDLE_STRIDE: Final = 4
"""Every fourth frequency is enough to see which plant is in the middle."""


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
def guarantee_of(
    plant: type[Plant], stability: Sequence[MemberStability], law: LinearLaw
) -> Guarantee:
    """The margin at the plant in the middle, in the units in which it exceeds the ν-gaps most.

    Raises:
        DiscriminationError: a plant or the law has no valid linear model, or a gap or margin has no value.
    """
    names = []
    points = []
    systems = []
    draws = []
    for loop in stability:
        for point, linear in loop.plants.items():
            names.append(loop.member.name)
            points.append(point)
            systems.append(StateSpace.of(linear))
        draws += [StateSpace.of(linear) for linear in loop.others]
    outputs, inputs = spans_of(plant)
    middle = _middle([system.scaled(outputs, inputs) for system in systems])
    origin = systems[middle]
    stride = max(len(systems) // MAX_SEARCHED, 1)
    scaling = best_scaling(
        origin, systems[::stride], StateSpace.of(law), outputs=outputs, inputs=inputs
    )
    if stride > 1:
        scaling = scaling._replace(gap=_largest_gap(origin, systems, scaling))
    drawn = _largest_gap(origin, draws, scaling)
    return Guarantee(
        names[middle], points[middle], scaling, drawn, len(systems) + len(draws)
    )


def _largest_gap(
    origin: StateSpace, systems: Sequence[StateSpace], scaling: Scaling
) -> float:
    """The largest ν-gap between a system and others, in the units of a scaling."""
    y = scaling.outputs
    u = scaling.inputs
    scaled = origin.scaled(y, u)
    return max(
        (matrix_nu_gap(scaled, system.scaled(y, u)) for system in systems), default=0.0
    )


def _middle(systems: Sequence[StateSpace]) -> int:
    """Number of the system whose largest pointwise gap to another is smallest."""
    mapped = half_plane(*systems)
    poles = np.concatenate([np.linalg.eigvals(system.A) for system in mapped])
    frequencies = beside(frequencies_of(poles)[::_MIDDLE_STRIDE], poles)
    responses = np.array([system.response(frequencies) for system in mapped])
    all_responses = responses.reshape(-1, *responses.shape[2:])
    largest_gaps = []
    for response in responses:
        repeated = np.tile(response, (len(mapped), 1, 1))
        largest_gaps.append(gaps_of(repeated, all_responses).max())
    return int(np.argmin(largest_gaps))
