"""The twins that a recording allows, each with what it leaves open, and draws of their parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from twinmatch.dynamics import (
    Law,
    Linear,
    Parameters,
    PlantError,
    TwoLevel,
    begin,
    linearised_at,
    rest_at,
    simulate_closed_loop,
)
from twinmatch.dynamics.laws import LOW
from twinmatch.signals import FloatArray

_ATTEMPTS: Final = 20
"""Draws for each that is wanted, at most: with a wide covariance most may be impossible."""


@dataclass(frozen=True, eq=False)
class TriedTwin:
    """One twin that may be the plant."""

    name: str
    parameters: Parameters
    free: tuple[str, ...] = ()
    """Names of the parameters that were fitted."""
    covariance: FloatArray | None = None
    """Their covariance, shape (n, n); None: they are exact."""
    states: FloatArray | None = None
    """States at the first sample after the session; None: courses begin at rest."""
    inputs: FloatArray | None = None
    """Commands at the session's end, shape (m,)."""
    noise: FloatArray | None = None
    """Standard deviations of the readings, shape (o,); None: those of the plant file."""
    disturbances: FloatArray | None = None
    """The measured disturbances, shape (d,), which stay as they are; None: the defaults of the plant file."""

    def drawn(self, number: int, seed: int) -> list[Parameters]:
        """Parameters that the recording does not tell from these: draws from their normal distribution,
        without impossible ones. Fewer than `number` if hardly any is possible; these alone if exact."""
        if self.covariance is None or not self.free:
            return [self.parameters]
        rng = np.random.default_rng(seed)
        centre = np.array([self.parameters[name] for name in self.free])
        values, modes = np.linalg.eigh(self.covariance)
        root = modes * np.sqrt(np.maximum(values, 0.0))
        drawn: list[Parameters] = []
        for _ in range(_ATTEMPTS * number):
            row = centre + root @ rng.standard_normal(centre.size)
            declared = self.parameters.model.declared
            if all(declared[name].possible(v) for name, v in zip(self.free, row, strict=True)):
                drawn.append(self.parameters.replace(**dict(zip(self.free, row.tolist(), strict=True))))
            if len(drawn) == number:
                break
        return drawn


@dataclass(frozen=True, eq=False)
class Holding:
    """How a plant comes to an operating point: held by the law that ran, for some samples, or at rest."""

    law: Law | None
    """The law that ran; None: it is not known. Two levels hold nothing at rest."""
    period: float
    """Sample time, s."""
    samples: int

    @property
    def _switches(self) -> bool:
        return self.law is None or isinstance(self.law, TwoLevel)

    def _limits(self, parameters: Parameters) -> FloatArray:
        """Least and greatest commands, shape (2, m)."""
        if self.law is None or self._switches:
            return np.array([drive.limits for drive in parameters.model.plant.drives.values()]).T
        return self.law.code[LOW : LOW + 2 * self.law.n_inputs].reshape(2, -1)

    def linear(
        self, parameters: Parameters, levels: Sequence[float], disturbances: FloatArray | None = None
    ) -> Linear:
        """The plant linearised where it is held at these outputs.

        Raises:
            PlantError: it is not held there within the limits of the drives.
        """
        if self.law is None or self._switches:
            states, inputs = rest_at(parameters, levels, disturbances)
        else:
            row = np.array(levels, dtype=np.float64)
            steady = parameters.model.disturbance_row(disturbances)
            run = simulate_closed_loop(
                parameters,
                np.tile(row, (self.samples, 1)),
                states=begin(parameters, row, disturbances=steady),
                law=self.law,
                disturbances=np.tile(steady, (self.samples, 1)),
            )
            states, inputs = run.states[-2], run.inputs[-1]
        model = parameters.model
        low, high = self._limits(parameters)
        finite = bool(np.isfinite(states).all() and np.isfinite(inputs).all())
        if not finite or not ((low < inputs) & (inputs < high)).all():
            outputs = zip(levels, model.plant.outputs.values(), strict=True)
            where = ", ".join(f"{level:g} {output.unit}" for level, output in outputs)
            raise PlantError(f"{model.title}: it is not held at {where} within the limits of its drives")
        return linearised_at(parameters, states, inputs, self.period, disturbances)
