"""The twins that a recording allows, each with what it leaves open, and draws of their parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from twinmatch.dynamics import (
    Law,
    Linear,
    Parameters,
    PlantError,
    Rest,
    TwoLevel,
    begin,
    linearised_at,
    rest_at,
    simulate_closed_loop,
)
from twinmatch.dynamics.laws import LOW
from twinmatch.signals import FloatArray

_HELD: Final = 3.0
"""Distance from a level up to which a plant is held there, in the noise of its outputs."""
_ATTEMPTS: Final = 20
"""Most attempts for each draw that is wanted: with a wide covariance most may be impossible."""


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
    unexplained: FloatArray | None = None
    """How far recorded readings were from this twin's under the same commands, shape (N, o): its own errors,
    an unknown load, a drifting room; None: nothing is known of these."""

    def drawn(self, number: int, seed: int) -> list[Parameters]:
        """Parameters that the recording does not tell from these: draws from their normal distribution,
        without impossible ones. Fewer than `number` if hardly any is possible; these alone if exact."""
        if self.covariance is None or not self.free:
            return [self.parameters]
        rng = np.random.default_rng(seed)
        centre = np.array([self.parameters[name] for name in self.free])
        values, modes = np.linalg.eigh(self.covariance)
        root = modes * np.sqrt(np.maximum(values, 0.0))
        draws: list[Parameters] = []
        for _ in range(_ATTEMPTS * number):
            row = centre + root @ rng.standard_normal(centre.size)
            draw = dict(zip(self.free, row.tolist(), strict=True))
            if self._are_possible(draw):
                draws.append(self.parameters.replace(**draw))
            if len(draws) == number:
                break
        return draws

    def _are_possible(self, values: Mapping[str, float]) -> bool:
        declared = self.parameters.model.declared
        return all(declared[name].possible(value) for name, value in values.items())

    def wandering(self, size: int, rng: np.random.Generator) -> FloatArray | None:
        """What stays unexplained over another time, shape (size, o): a part of the recorded course from a
        random sample on, to and fro, of either sign; zero at first, since the law has settled until then."""
        if self.unexplained is None:
            return None
        there_and_back = np.concatenate([self.unexplained, self.unexplained[::-1]])
        places = (rng.integers(len(there_and_back)) + np.arange(size)) % len(
            there_and_back
        )
        path: FloatArray = rng.choice([-1.0, 1.0]) * (
            there_and_back[places] - there_and_back[places[0]]
        )
        return path


@dataclass(frozen=True, eq=False)
class Holding:
    """How a plant comes to an operating point: held by the law that ran, for some samples, or at rest where
    that law does not bring it there."""

    law: Law | None
    """The law that ran; None: it is not known. Only a linear law holds a plant at rest; two levels do not."""
    period: float
    """Sample time, s."""
    samples: int
    """Samples for which the law holds the plant, so that it comes to rest."""

    @property
    def _holds_nothing(self) -> bool:
        """Whether there is no law that could bring a plant to rest."""
        return self.law is None or isinstance(self.law, TwoLevel)

    def _limits(self, parameters: Parameters) -> FloatArray:
        """Least and greatest commands, shape (2, m)."""
        if self.law is None or self._holds_nothing:
            return np.array(
                [drive.limits for drive in parameters.model.plant.drives.values()]
            ).T
        return self.law.code[LOW : LOW + 2 * self.law.n_inputs].reshape(2, -1)

    def linear(
        self,
        parameters: Parameters,
        levels: Sequence[float],
        disturbances: FloatArray | None = None,
    ) -> Linear:
        """The plant linearised where it is held at these outputs.

        Raises:
            PlantError: it is not held there within the limits of the drives.
        """
        model = parameters.model
        rest_point = None
        if self.law is not None and not self._holds_nothing:
            rest_point = self._held_by_law(
                parameters, np.array(levels, dtype=np.float64), disturbances
            )
        if rest_point is None:
            rest_point = rest_at(parameters, levels, disturbances)
        states, inputs = rest_point
        low, high = self._limits(parameters)
        is_finite = np.isfinite(states).all() and np.isfinite(inputs).all()
        if not is_finite or not ((low < inputs) & (inputs < high)).all():
            outputs = zip(levels, model.plant.outputs.values(), strict=True)
            where = ", ".join(
                f"{level:g} {output.unit}".rstrip() for level, output in outputs
            )
            raise PlantError(
                f"{model.title}: it is not held at {where} within the limits of its drives"
            )
        return linearised_at(parameters, states, inputs, self.period, disturbances)

    def _held_by_law(
        self, parameters: Parameters, row: FloatArray, disturbances: FloatArray | None
    ) -> Rest | None:
        """Where the law that ran holds it; None if that is within limits, but not near these outputs."""
        model = parameters.model
        steady = model.disturbance_row(disturbances)
        run = simulate_closed_loop(
            parameters,
            np.tile(row, (self.samples, 1)),
            states=begin(parameters, row, disturbances=steady),
            law=self.law,
            disturbances=np.tile(steady, (self.samples, 1)),
        )
        rest_point = Rest(run.states[-2], run.inputs[-1])
        low, high = self._limits(parameters)
        is_near = np.abs(run.outputs[-1] - row) <= _HELD * model.noise
        is_limited = (rest_point.inputs <= low) | (rest_point.inputs >= high)
        return rest_point if is_near.all() or is_limited.any() else None
