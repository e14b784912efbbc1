"""A twin as its loop holds it at a set-point, and its plant linearised there.

Twins are compared at operating points that all of them share, and not every twin can rest at every one of
them: where a heat sink has little convection, its temperature goes on falling for as long as the plate is
heated, and the plant as the loop meets it is that of the minutes in which a set-point is held. So the loop
runs: from a start of which nothing but the output is known, on a constant set-point, as long as a set-point
regime lasts before it is judged. Where the drive's limits keep the output from the set-point, the plant is
linearised where it is held instead. Of plants without slow states this is the rest. Where the loop is not
known, nothing holds a twin but a constant input: the plant is linearised where it rests.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.discrimination.errors import DiscriminationError
from twinmatch.discrimination.graph_symbol import GraphSymbol
from twinmatch.discrimination.loop import Scales
from twinmatch.dynamics import (
    Linear,
    Parameters,
    PidGains,
    begin,
    linearised,
    linearised_at,
    simulate_closed_loop,
)
from twinmatch.signals import FloatArray

__all__ = ["ANGLES", "HOLD", "Held", "held", "held_slopes", "held_symbol"]

HOLD = 240
"""Samples for which a set-point is held."""

ANGLES: FloatArray = np.concatenate([[0.0], np.geomspace(1e-3, np.pi, 8)])
"""Frequencies at which responses are known, radians per sample: zero, and from a quarter of what a regime
resolves to the highest there is."""

STEP = 1e-3
"""Change of a parameter for a difference quotient, in units of its scale: the response of a plant is smooth
over a fraction of that, and the search for the point at which it is held is right to a millionth."""


class Held(NamedTuple):
    """On which terms twins are held; hashable, so that nothing is computed twice."""

    gains: PidGains | None
    """Of the controller that holds them; None: it is not known."""
    scales: Scales
    """What counts as 1 of output and input."""
    samples: int = HOLD
    """For how long."""
    period: float = 1.0
    """Sample time of a plant whose loop is not known, s; a loop has its controller's."""


def held(parameters: Parameters, set_point: float, terms: Held) -> Linear:
    """The plant around where its loop holds it, in the units of output and input.

    Raises:
        DiscriminationError: the loop does not hold it: its states grow beyond all bounds.
        PlantError: the plant is too fast for the period; without a loop, no input holds it there.
    """
    if terms.gains is None:
        return linearised(parameters, float(set_point), terms.period)
    reference = np.full(terms.samples, float(set_point))
    run = simulate_closed_loop(
        parameters, reference, states=begin(parameters, float(set_point)), gains=terms.gains
    )
    states, input_ = run.states[-2], float(run.input[-1])
    finite = np.isfinite(states).all() and np.isfinite(input_)
    linear = linearised_at(parameters, states, input_, terms.gains.period) if finite else None
    if linear is None or not all(np.isfinite(matrix).all() for matrix in linear[:3]):
        model = parameters.model
        msg = f"ν-gap: the loop of {model.title} does not hold it at {set_point:g} {model.plant.output.unit}"
        raise DiscriminationError(msg)
    return linear


@lru_cache(maxsize=1024)  # a candidate stays in the family for many verdicts
def held_symbol(parameters: Parameters, set_point: float, terms: Held) -> GraphSymbol:
    """Graph symbol of the plant from input to output where it is held, scaled; raises as `held`."""
    a, b, c, period = held(parameters, set_point, terms)[:4]
    return GraphSymbol.of_state_space(a, b, c * terms.scales.ratio, np.zeros((1, 1)), period)


@lru_cache(maxsize=1024)
def held_slopes(
    parameters: Parameters, free: tuple[str, ...], set_point: float, terms: Held
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Frequency response of that plant at `ANGLES`, scaled, and its derivatives by some parameters.

    Shapes (frequencies,) and (n, frequencies). Raises as `held`.
    """
    still = _response(parameters, set_point, terms)
    slopes = np.zeros((len(free), ANGLES.size), dtype=np.complex128)
    for row, name in zip(slopes, free, strict=True):
        declared, value = parameters.model.declared[name], parameters[name]
        moved = value + STEP * declared.scale
        if not declared.possible(moved):
            moved = value - STEP * declared.scale
        row[:] = (_response(parameters.replace(**{name: moved}), set_point, terms) - still) / (moved - value)
    return still, slopes


def _response(parameters: Parameters, set_point: float, terms: Held) -> NDArray[np.complex128]:
    linear = held(parameters, set_point, terms)
    z = np.exp(1j * ANGLES)
    resolvent = z[:, None, None] * np.eye(len(linear.A)) - linear.A
    states = np.linalg.solve(resolvent, np.broadcast_to(linear.B, (z.size, *linear.B.shape)))
    return np.asarray(terms.scales.ratio * (linear.C @ states)[:, 0, 0], dtype=np.complex128)
