"""A stretch of samples that a twin is simulated over, from the states estimated before it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from twinmatch.dynamics import Parameters, read, simulate_driven
from twinmatch.health.usual import Usual
from twinmatch.signals import FloatArray

__all__ = ["Moment", "Stretch", "advanced"]


class Moment(NamedTuple):
    """What is known of one sample."""

    parameters: Parameters
    states: FloatArray
    """Estimated states, before the input acts."""
    input: float
    disturbances: FloatArray
    usual: tuple[Usual, ...]
    """The usual errors known then, so that a fault does not hide itself."""
    settled: bool
    """Whether the states had been followed for long enough to be known."""


def advanced(
    twin: Parameters, states: FloatArray, inputs: FloatArray, rows: FloatArray, period: float
) -> FloatArray:
    """States after these inputs and disturbances (n × number of them), held for `period` s each."""
    given = rows if rows.size else None
    run = simulate_driven(twin, inputs, states=states, period=period, disturbances=given)
    return np.asarray(run.states[-1], dtype=np.float64)


class Stretch:
    """Simulations from the first of some moments to the end of the last; all results in the output's unit."""

    def __init__(self, moments: Sequence[Moment], period: float) -> None:
        """`moments`, oldest first; `period` in s."""
        self.first = moments[0]
        self._period, self._length = period, len(moments)
        self._inputs = np.array([moment.input for moment in moments])
        self._rows = np.array([moment.disturbances for moment in moments])

    def __len__(self) -> int:
        return self._length

    @cached_property
    def works(self) -> float:
        """The output under the recorded inputs."""
        return self._read(self._inputs)

    @property
    def moved(self) -> float:
        """How far it moves from the beginning to there."""
        return self.works - read(self.first.parameters, self.first.states)

    @cached_property
    def effect(self) -> float:
        """What the drive contributes to it."""
        rest = self.first.parameters.model.plant.drive.rest
        return self.works - self._read(np.full(self._length, rest))

    def changed(self, before: float, later: int) -> float:
        """What the drive's changes since it stood at `before` will have contributed, some samples later."""
        inputs = np.append(self._inputs, np.full(later, self._inputs[-1]))
        rows = np.concatenate([self._rows, np.repeat(self._rows[-1:], later, axis=0)])
        return self._read(inputs, rows) - self._read(np.full(inputs.size, before), rows)

    def colder(self, change: float) -> float:
        """How far the output would have moved in a colder room; `change` in the scale of that parameter."""
        twin, moved = self.first.parameters, 0.0
        for name, parameter in twin.model.declared.items():
            if parameter.role == "room":
                lowest = 0.5 * twin[name] if parameter.positive else parameter.least
                room = max(twin[name] - change * parameter.scale, lowest)
                states = advanced(
                    twin.replace(**{name: room}), self.first.states, self._inputs, self._rows, self._period
                )
                moved = max(moved, abs(read(twin, states) - self.works))
        return moved

    def _read(self, inputs: FloatArray, rows: FloatArray | None = None) -> float:
        twin, given = self.first.parameters, self._rows if rows is None else rows
        return read(twin, advanced(twin, self.first.states, inputs, given, self._period))
