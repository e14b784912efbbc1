"""How far a plant's outputs are expected to move, as its inputs move."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from twinmatch.dynamics.declarations import PlantError
from twinmatch.dynamics.linear import Linear, linearised_at, rest_at
from twinmatch.dynamics.plant import Parameters, Plant
from twinmatch.dynamics.simulation import begin
from twinmatch.signals import FloatArray

_SHARE = 0.25
"""Share of a drive's range that moves an output by its least step, where the equations do not say."""


class InputEffect(NamedTuple):
    """x[k+1] = A·x[k] + B·Δu[k], Δy[k] = C·x[k] + D·Δu[k]."""

    A: FloatArray
    """Shape (n, n)."""
    B: FloatArray
    """Shape (n, m)."""
    C: FloatArray
    """Shape (o, n)."""
    D: FloatArray
    """Shape (o, m)."""


def rest_of(parameters: Parameters) -> tuple[FloatArray, FloatArray]:
    """States, shape (n,), and inputs, shape (m,), in the middle of the outputs' ranges; where nothing holds
    the plant there, those that it begins with."""
    model = parameters.model
    levels = np.array(
        [np.mean(y.set_points or y.span) for y in model.plant.outputs.values()]
    )
    try:
        states, inputs = rest_at(parameters, levels)
    except PlantError:
        states = begin(parameters, levels)
        inputs = model.rest
    return states, inputs


@cache
def effect_of(plant: type[Plant], period: float) -> InputEffect:
    """The effect of the inputs of a plant in its first structure with typical parameters; `period` is the
    sample time, s.

    It is linearised in the middle of the outputs' ranges. Where that says nothing, a quarter of a drive's
    range counts as a step.
    """
    linear = _linear(plant.model().typical(), period)
    p = len(plant.outputs)
    m = len(plant.drives)
    if linear is not None:
        return InputEffect(A=linear.A, B=linear.B, C=linear.C, D=np.zeros((p, m)))
    steps = np.array([output.least_step for output in plant.outputs.values()])
    limits = np.array(
        [drive.limits for drive in plant.drives.values()], dtype=np.float64
    )
    ranges = limits[:, 1] - limits[:, 0]
    direct = np.outer(steps, 1.0 / (_SHARE * ranges))
    return InputEffect(
        A=np.zeros((0, 0)), B=np.zeros((0, m)), C=np.zeros((p, 0)), D=direct
    )


def _linear(parameters: Parameters, period: float) -> Linear | None:
    """The linearisation, if there is one in which the inputs act."""
    if parameters.model.is_external:
        return None
    try:
        with np.errstate(all="ignore"):
            linear = linearised_at(parameters, *rest_of(parameters), period)
    except PlantError:  # too fast for this period
        return None
    for matrix in (linear.A, linear.B, linear.C):
        if not np.isfinite(matrix).all() or not matrix.any():
            return None
    return linear


class ExpectedMovement:
    """Expected deviation of the outputs from where they were, as the inputs leave where they were."""

    def __init__(self, effect: InputEffect) -> None:
        """Begin at rest; where, the first inputs say."""
        self._effect = effect
        self._from: FloatArray | None = None
        self._states = np.zeros(effect.A.shape[0])

    def rest(self) -> None:
        """Take the next inputs as those at rest."""
        self._from = None
        self._states = np.zeros_like(self._states)

    def take(self, inputs: FloatArray) -> FloatArray:
        """Take the inputs of a sample, shape (m,); return the deviation of the outputs, shape (o,)."""
        if self._from is None:
            self._from = inputs
        moved = inputs - self._from
        effect = self._effect
        deviation = effect.C @ self._states + effect.D @ moved
        self._states = effect.A @ self._states + effect.B @ moved
        return np.asarray(deviation)


def movement_under(effect: InputEffect, inputs: FloatArray) -> FloatArray:
    """Deviation of the outputs, shape (N, o), under inputs, shape (N, m), of which the first are those at rest: what
    `ExpectedMovement` takes one by one."""
    moved = inputs - inputs[:1]
    changes = moved @ effect.B.T
    states = np.zeros((len(moved), effect.A.shape[0]))
    for k in range(1, len(moved)):
        states[k] = effect.A @ states[k - 1] + changes[k - 1]
    return np.asarray(states @ effect.C.T + moved @ effect.D.T)
