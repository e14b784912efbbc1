"""The plant of a twin, linearised where its loop holds it at a set-point.

Twins are compared at shared operating points, but not every twin has an equilibrium at each of them: with
little convection, the temperature of a heat sink keeps falling for as long as the plate is heated, and what
the loop controls is the plant during the minutes in which a set-point is held. So the closed loop is
simulated on a constant set-point, from a start that only the output determines, for as long as a set-point
regime lasts before it is judged. Where the drive's limits keep the output from the set-point, the plant is
linearised where the loop does hold it. For plants without slow states this is the equilibrium. Where the loop
is not known, the plant is linearised at its equilibrium under a constant input.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.comparing.errors import DiscriminationError
from twinmatch.comparing.graph_symbol import GraphSymbol
from twinmatch.comparing.loop import Scales
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
"""Frequencies at which responses are computed, radians per sample: zero, and from a quarter of the lowest
that a regime resolves to the Nyquist frequency."""

STEP = 1e-3
"""Change of a parameter for a difference quotient, in units of its scale: the response of a plant is smooth
over it, and the point at which the plant is held is accurate to a millionth."""

_OFF = 1e-6
"""The response of an integrator is infinite at frequency zero. If a pole lies within a tenth of this distance
of a frequency, the response is computed this far beside it, radians per sample: it is then so large that only
its phase matters."""


class Held(NamedTuple):
    """The loop in which twins are held; hashable, so that results can be cached."""

    gains: PidGains | None
    """Gains of the controller; None if it is not known."""
    scales: Scales
    """Scales of output and input."""
    samples: int = HOLD
    """How long a set-point is held, samples."""
    period: float = 1.0
    """Sample time if the loop is not known, s; otherwise the controller's is used."""


def held(parameters: Parameters, set_point: float, terms: Held) -> Linear:
    """Linearise the plant where its loop holds it, in the units of output and input.

    Raises:
        DiscriminationError: the loop does not hold it: its states diverge.
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
    """Frequency response of that plant at `ANGLES`, scaled, and its derivatives with respect to `free`.

    Shapes (frequencies,) and (n, frequencies). Raises as `held`.
    """
    response = _response(parameters, set_point, terms)
    slopes = np.zeros((len(free), ANGLES.size), dtype=np.complex128)
    for row, name in zip(slopes, free, strict=True):
        declared, value = parameters.model.declared[name], parameters[name]
        moved = value + STEP * declared.scale
        if not declared.possible(moved):
            moved = value - STEP * declared.scale
        row[:] = (_response(parameters.replace(**{name: moved}), set_point, terms) - response) / (
            moved - value
        )
    return response, slopes


def _response(parameters: Parameters, set_point: float, terms: Held) -> NDArray[np.complex128]:
    linear = held(parameters, set_point, terms)
    poles = np.linalg.eigvals(linear.A)
    singular = np.abs(np.exp(1j * ANGLES)[:, None] - poles).min(axis=1) < _OFF / 10
    z = np.exp(1j * np.where(singular, ANGLES + _OFF, ANGLES))
    resolvent = z[:, None, None] * np.eye(len(linear.A)) - linear.A
    states = np.linalg.solve(resolvent, np.broadcast_to(linear.B, (z.size, *linear.B.shape)))
    return np.asarray(terms.scales.ratio * (linear.C @ states)[:, 0, 0], dtype=np.complex128)
