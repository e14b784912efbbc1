"""What a controller can say of a law by itself: whether the loop is stable on the plant of its own file."""

from __future__ import annotations

import math
from collections.abc import Sequence

from twinmatch.dynamics import (
    Law,
    Parameters,
    PlantError,
    largest_eigenvalue,
    linearised,
    loop_matrix,
)
from twinmatch.dynamics.pids import as_linear


def nominal_eigenvalue(
    parameters: Parameters, law: Law, levels: Sequence[float]
) -> float:
    """Size of the largest eigenvalue of the loop with a plant that rests at these outputs.

    Where nothing holds it there, or without outputs, it rests in the middle of its set-points; NaN where
    nothing holds it there either, or where the plant has no equations to be linearised.
    """
    if parameters.model.is_external:
        return math.nan
    for point in filter(len, (levels, _middle(parameters))):
        try:
            plant = linearised(parameters, point, law.period)
        except PlantError:
            continue
        return largest_eigenvalue(loop_matrix(plant, as_linear(law)))
    return math.nan


def _middle(parameters: Parameters) -> list[float]:
    """The middle of the set-points of every output."""
    outputs = parameters.model.plant.outputs.values()
    return [sum(output.set_points or output.span) / 2 for output in outputs]
