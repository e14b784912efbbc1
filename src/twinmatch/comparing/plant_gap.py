"""ν-gaps between the plants of a family, linearised at operating points that all of them share.

Twins are compared at shared operating points, but not every twin has an equilibrium at each of them: with
little convection, the temperature of a heat sink keeps falling for as long as the plate is heated, and what
the loop controls is the plant during the minutes in which a set-point is held. So the closed loop is
simulated on a constant set-point, from a start that only the output determines, for as long as a set-point
regime lasts before it is judged. Where the drive's limits keep the output from the set-point, the plant is
linearised where the loop does hold it. For plants without slow states this is the equilibrium. Where the loop
is not known, the plant is linearised at its equilibrium under a constant input.

Two twins behave alike in the loop if the ν-gap between their plants is small wherever the loop takes them. So
their equations are linearised where the loop holds them (`linearised_in_loop`) at
every operating point of the family, and
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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.comparing.graph_symbol import GraphSymbol
from twinmatch.comparing.margin import Scales
from twinmatch.comparing.matrix_gap import matrix_nu_gap
from twinmatch.comparing.nu_gap import nu_gap
from twinmatch.comparing.polynomials import DiscriminationError
from twinmatch.comparing.state_space import StateSpace
from twinmatch.comparing.undefined import UndefinedError
from twinmatch.dynamics import (
    Law,
    Linear,
    Parameters,
    Plant,
    begin,
    linearised,
    linearised_at,
    simulate_closed_loop,
)
from twinmatch.errors import TwinmatchError
from twinmatch.signals import FloatArray, OperatingPoint, finite, point_of, point_values

HOLD = 240
"""Samples for which a set-point is held."""

ANGLES: FloatArray = np.concatenate([[0.0], np.geomspace(1e-3, np.pi, 8)])
"""Frequencies at which responses are computed, radians per sample: zero, and from a quarter of the lowest
that a regime resolves to the Nyquist frequency."""

STEP = 1e-3
"""Change of a parameter for a difference quotient, in units of its scale: the response of a plant is smooth
over it, and the point at which the plant is held is accurate to a millionth."""

_OFF = 1e-6
"""The response of an integrator is infinite at frequency zero. If a pole lies within a tenth of this distance
of a frequency, the response is computed this far beside it, radians per sample: it is then so large that only
its phase matters."""


class LoopConditions(NamedTuple):
    """The loop in which twins are held; hashable, so that results can be cached."""

    law: Law | None
    """The controller; None if it is not known."""
    scales: Scales
    """Scales of output and input."""
    samples: int = HOLD
    """How long a set-point is held, samples."""
    period: float = 1.0
    """Sample time if the loop is not known, s; otherwise the controller's is used."""


@lru_cache(maxsize=1024)  # for the response and for the graph symbol
def linearised_in_loop(
    parameters: Parameters, set_point: OperatingPoint, loop: LoopConditions
) -> Linear:
    """Linearise the plant where its loop holds it, in the units of output and input.

    Raises:
        DiscriminationError: the loop does not hold it: its states diverge.
        PlantError: the plant is too fast for the period; without a loop, no input holds it there.
    """
    if loop.law is None:
        return linearised(parameters, set_point, loop.period)
    row = np.array(set_point, dtype=np.float64, ndmin=1)
    run = simulate_closed_loop(
        parameters,
        np.full((loop.samples, row.size), row),
        states=begin(parameters, row),
        law=loop.law,
    )
    states = run.states[-2]
    inputs = run.inputs[-1]
    is_finite = finite(states) and finite(inputs)
    linear = (
        linearised_at(parameters, states, inputs, loop.law.period)
        if is_finite
        else None
    )
    if linear is None or not all(map(finite, linear[:3])):
        model = parameters.model
        in_words = " and ".join(
            f"{y:g} {output.unit}".rstrip()
            for y, output in zip(row, model.plant.outputs.values(), strict=True)
        )
        raise DiscriminationError(
            f"ν-gap: the loop of {model.title} does not hold it at {in_words}"
        )
    return linear


@lru_cache(maxsize=1024)  # a candidate stays in the family for many verdicts
def symbol_in_loop(
    parameters: Parameters, set_point: OperatingPoint, loop: LoopConditions
) -> GraphSymbol | StateSpace:
    """Graph symbol of the plant from input to output where it is held, scaled; of several, in state space.

    Raises as `linearised_in_loop`.
    """
    linear = linearised_in_loop(parameters, set_point, loop)
    a, b, c, period = linear[:4]
    if len(c) > 1 or b.shape[1] > 1:
        return StateSpace.of(linear).scaled(loop.scales.output, loop.scales.input)
    return GraphSymbol.of_state_space(
        a, b, c * loop.scales.ratio, np.zeros((1, 1)), period
    )


@lru_cache(maxsize=1024)
def response_slopes(
    parameters: Parameters,
    free: tuple[str, ...],
    set_point: OperatingPoint,
    loop: LoopConditions,
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Frequency response of that plant at `ANGLES`, scaled, and its derivatives with respect to `free`.

    Shapes (frequencies,) and (n, frequencies). Raises as `linearised_in_loop`.
    """
    twins = [parameters]
    steps = []
    for name in free:
        declared = parameters.model.declared[name]
        value = parameters[name]
        moved = value + STEP * declared.scale
        if not declared.possible(moved):
            moved = value - STEP * declared.scale
        twins.append(parameters.replace(**{name: moved}))
        steps.append(moved - value)
    response, *moved_responses = _responses(
        [linearised_in_loop(twin, set_point, loop) for twin in twins], loop.scales
    )
    slopes = np.zeros((len(free), ANGLES.size), dtype=np.complex128)
    for row, moved_response, step in zip(slopes, moved_responses, steps, strict=True):
        row[:] = (moved_response - response) / step
    return response, slopes


def _responses(plants: Sequence[Linear], scales: Scales) -> NDArray[np.complex128]:
    """Of each plant, shape (plants, frequencies)."""
    A = np.stack([plant.A for plant in plants])[:, None]
    B = np.stack([plant.B for plant in plants])[:, None]
    C = np.stack([plant.C for plant in plants])[:, None]
    poles = np.linalg.eigvals(A)
    to_nearest_pole = np.abs(np.exp(1j * ANGLES)[:, None] - poles).min(axis=2)
    angles = np.where(to_nearest_pole < _OFF / 10, ANGLES + _OFF, ANGLES)
    z = np.exp(1j * angles)
    resolvent = z[:, :, None, None] * np.eye(A.shape[-1]) - A
    states = np.linalg.solve(resolvent, np.broadcast_to(B, (*z.shape, *B.shape[2:])))
    return np.asarray(scales.ratio * (C @ states)[..., 0, 0], dtype=np.complex128)


def spans_of(plant: type[Plant]) -> Scales:
    """Half the span of the set-points and half the drive's range."""
    outputs = [output.set_points or output.span for output in plant.outputs.values()]
    inputs = [drive.limits for drive in plant.drives.values()]
    return Scales(_half_ranges(outputs), _half_ranges(inputs))


def _half_ranges(ranges: Sequence[tuple[float, float]]) -> OperatingPoint:
    return point_of([(high - low) / 2 for low, high in ranges])


@dataclass(frozen=True, eq=False)
class PlantGaps:
    """ν-gaps between the plants of some twins."""

    points: tuple[OperatingPoint, ...]
    """Operating points at which all of them were linearised, ascending, in the outputs' units."""
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


def plant_gaps(
    twins: Sequence[Parameters], points: Sequence[OperatingPoint], loop: LoopConditions
) -> PlantGaps:
    """ν-gaps between the plants of all pairs of twins, of any structures of one plant.

    A point at which one of them cannot be linearised, or a ν-gap has no value, is left out for all. If no
    shared point remains, the ν-gaps are 1, since nothing shows that the twins are alike.
    """
    shared = []
    rows = []
    left_out = []
    for point in sorted(set(points), key=point_values):
        try:
            rows.append(
                _gaps_between([symbol_in_loop(twin, point, loop) for twin in twins])
            )
        except UndefinedError as error:
            left_out.append(f"at {point} {error}")
        except TwinmatchError as error:
            left_out.append(str(error))
        else:
            shared.append(point)
    gaps = np.array(rows) if rows else (1.0 - np.eye(len(twins)))[None]
    return PlantGaps(tuple(shared), gaps, tuple(left_out))


def _gaps_between(symbols: Sequence[GraphSymbol | StateSpace]) -> FloatArray:
    matrix = np.zeros((len(symbols), len(symbols)))
    for i in range(len(symbols)):
        for j in range(i):
            matrix[i, j] = matrix[j, i] = _gap(symbols[j], symbols[i])
    return matrix


def _gap(first: GraphSymbol | StateSpace, second: GraphSymbol | StateSpace) -> float:
    if isinstance(first, StateSpace) and isinstance(second, StateSpace):
        return matrix_nu_gap(first, second)
    return nu_gap(first, second)


def plant_gap(
    one: Parameters,
    other: Parameters,
    points: Sequence[OperatingPoint],
    loop: LoopConditions,
) -> float:
    """The largest ν-gap between the plants of two twins over some operating points."""
    return float(plant_gaps((one, other), points, loop).matrix[0, 1])
