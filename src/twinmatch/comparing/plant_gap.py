"""ν-gaps between the plants of a family, at operating points that all of them share.

Two twins behave alike in the loop if the ν-gap between their plants is small wherever the loop takes them. So
their equations are linearised where the loop holds them (`held`) at every operating point of the family, and
the distance of two candidates is the largest ν-gap over these points, which is again a metric. A controller
whose stability margin with one plant exceeds this distance at each of the points stabilises the other, too.

The ν-gap depends on units. Here the output is in halves of the span of its set-points and the input in halves
of the drive's range, so that the static gain of the plant counts as much as the controller's response
(docs/decisions/0022 has the figures for the alternatives).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from twinmatch.comparing.graph_symbol import GraphSymbol
from twinmatch.comparing.held import Held, held_symbol
from twinmatch.comparing.loop import Scales
from twinmatch.comparing.nu_gap import nu_gap_of
from twinmatch.dynamics import Parameters, Plant
from twinmatch.errors import TwinmatchError
from twinmatch.signals import FloatArray

__all__ = ["PlantGaps", "plant_gap", "plant_gaps", "spans_of"]


def spans_of(plant: type[Plant]) -> Scales:
    """Half the span of the set-points and half the drive's range."""
    low, high = plant.output.set_points or plant.output.span
    least, most = plant.drive.limits
    return Scales((high - low) / 2, (most - least) / 2)


@dataclass(frozen=True, eq=False)
class PlantGaps:
    """ν-gaps between the plants of some twins."""

    points: tuple[float, ...]
    """Operating points at which all of them were linearised, ascending, in the output's unit."""
    at: FloatArray
    """ν-gaps at each point, shape (points, n, n); all 1 if there is no point."""
    left_out: tuple[str, ...]
    """Why requested points are missing, one sentence each."""

    @property
    def matrix(self) -> FloatArray:
        """The largest over the points, shape (n, n), symmetric with a zero diagonal."""
        return np.asarray(self.at.max(axis=0), dtype=np.float64)

    def of(self, count: int) -> PlantGaps:
        """The ν-gaps between the first `count` twins."""
        return PlantGaps(self.points, self.at[:, :count, :count], self.left_out)


def plant_gaps(twins: Sequence[Parameters], points: Sequence[float], terms: Held) -> PlantGaps:
    """ν-gaps between the plants of all pairs of twins, of any structures of one plant.

    A point at which one of them cannot be linearised is left out for all. If no shared point remains, the
    ν-gaps are 1, since nothing shows that the twins are alike.
    """
    shared, rows, left_out = [], [], []
    for point in sorted(set(points)):
        try:
            rows.append([held_symbol(twin, point, terms) for twin in twins])
        except TwinmatchError as error:
            left_out.append(str(error))
        else:
            shared.append(point)
    n = len(twins)
    at = np.zeros((len(rows), n, n))
    for matrix, symbols in zip(at, rows, strict=True):
        for i in range(n):
            for j in range(i):
                matrix[i, j] = matrix[j, i] = _gap(symbols[j], symbols[i])
    return PlantGaps(tuple(shared), at if rows else (1.0 - np.eye(n))[None], tuple(left_out))


def plant_gap(one: Parameters, other: Parameters, points: Sequence[float], terms: Held) -> float:
    """The largest ν-gap between the plants of two twins over some operating points."""
    return float(plant_gaps((one, other), points, terms).matrix[0, 1])


@lru_cache(maxsize=8192)
def _gap(one: GraphSymbol, other: GraphSymbol) -> float:
    return nu_gap_of(one, other)
