"""The least-squares problem of a window: its unknowns and its residuals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twinmatch.dynamics import (
    FILED,
    Closing,
    Descended,
    Experiment,
    Model,
    Parameters,
    PidGains,
    Response,
    Tangents,
    gains_for,
    noise_scores,
)
from twinmatch.fitting.bounds import Bounds, MatchingError, Unknown, unknown_parameters, unknown_starts
from twinmatch.fitting.noise import Noise
from twinmatch.signals import FloatArray, Window

__all__ = ["Evaluation", "Problem", "checked_gains"]


def checked_gains(model: Model, window: Window, gains: Closing = FILED) -> PidGains | None:
    """The controller of the closed-loop twin; None if the loop is not known.

    Raises:
        MatchingError: the controller has another period than the window.
    """
    held = gains_for(model.plant, window.period, gains)
    if held is not None and held.period != window.period:
        msg = (
            f"matching: the controller runs every {held.period} s but the window's samples come every "
            f"{window.period} s; give both the same period"
        )
        raise MatchingError(msg)
    return held


@dataclass(frozen=True, eq=False)
class Problem:
    """The twin on one window as a function of the free parameters and the unknown initial states.

    In closed loop it gets the window's reference, and output and input are compared; without a known loop
    it is driven by the recorded input, and only the output is compared. It starts at the third sample, from
    the output measured there and the controller's state after the first two samples.
    """

    window: Window
    free: tuple[str, ...]
    """Names of the free parameters."""
    base: Parameters
    """Values of all other parameters."""
    noise: Noise
    gains: PidGains | None
    bounds: Bounds | None = None
    """Replacements for some of the plant's bounds."""

    @cached_property
    def unknowns(self) -> tuple[Unknown, ...]:
        """The unknowns, in the order of every array of values: parameters, then initial states."""
        model = self.base.model
        return unknown_parameters(model, self.free, self.bounds) + unknown_starts(model, self.bounds)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        return tuple(unknown.name for unknown in self.unknowns)

    @cached_property
    def lower(self) -> FloatArray:
        """Lower bounds of the unknowns."""
        return np.array([unknown.bounds[0] for unknown in self.unknowns])

    @cached_property
    def upper(self) -> FloatArray:
        """Upper bounds of the unknowns."""
        return np.array([unknown.bounds[1] for unknown in self.unknowns])

    @cached_property
    def scales(self) -> FloatArray:
        """Typical sizes of the unknowns."""
        return np.array([unknown.scale for unknown in self.unknowns])

    @cached_property
    def experiment(self) -> Experiment:
        """The run and its derivatives."""
        return Experiment(
            self.base,
            self.free,
            self.window,
            free_starts=self.base.model.structure.free_starts,
            gains=self.gains,
            weights=(1.0 / self.noise.output, 1.0 / self.noise.input),
        )

    @property
    def outputs(self) -> int:
        """Number of compared signals: output and input in closed loop, otherwise only the output."""
        return 1 if self.gains is None else 2

    @property
    def weights(self) -> FloatArray:
        """Weights of the compared signals, shape (outputs, 1)."""
        return np.array([[1.0 / self.noise.output], [1.0 / self.noise.input]])[: self.outputs]

    @property
    def measured(self) -> FloatArray:
        """The compared signals as recorded, shape (outputs, N − 2)."""
        return self.experiment.measured[: self.outputs]

    def values_of(self, parameters: Parameters) -> FloatArray:
        """The unknowns of a plant as an array, clipped to the bounds; initial states are the plant file's."""
        return np.clip(self.experiment.values_of(parameters), self.lower, self.upper)

    def parameters_at(self, values: FloatArray) -> Parameters:
        """The plant with these values of the unknowns."""
        return self.experiment.parameters_at(values)

    def starts_at(self, values: FloatArray) -> Mapping[str, float]:
        """The unknown states at the third sample, by name."""
        return self.experiment.starts_at(values)

    def weigh(self, response: Response | Tangents) -> FloatArray:
        """Measured minus simulated in units of the noise, shape (outputs, N − 2)."""
        simulated = np.stack([response.output, response.input][: self.outputs])
        return np.asarray((self.measured - simulated) * self.weights, dtype=np.float64)

    def evaluate(self, values: FloatArray) -> Evaluation:
        """Residuals and Jacobian at some values."""
        return Evaluation(self, values)

    def residuals(self, values: FloatArray) -> FloatArray:
        """Weighted residuals of all signals in one row, shape (outputs·(N − 2),)."""
        return self.weigh(self.experiment.simulate(values)).ravel()

    def jacobian(self, values: FloatArray) -> FloatArray:
        """Derivatives of the residuals, shape (outputs·(N − 2), n)."""
        return self.evaluate(values).jacobian

    def descend(self, start: FloatArray, most_evaluations: int, found: Descended | None = None) -> Descended:
        """Least squares from one start inside the bounds."""
        return self.experiment.descend(start, self.lower, self.upper, self.scales, most_evaluations, found)


class Evaluation:
    """A problem at some values: normal equations, residuals and Jacobian, each computed when first used."""

    def __init__(self, problem: Problem, values: FloatArray) -> None:
        self.problem, self.values = problem, values

    @cached_property
    def normal(self) -> tuple[float, FloatArray, FloatArray]:
        """Sum of squares S, gradient Jᵀr, shape (n,), and JᵀJ, shape (n, n)."""
        return self.problem.experiment.normal(self.values)

    @property
    def cost(self) -> float:
        """Sum of the squared residuals."""
        return self.normal[0]

    @cached_property
    def tangents(self) -> Tangents:
        """The run with its derivatives."""
        return self.problem.experiment.tangents(self.values)

    @cached_property
    def residuals(self) -> FloatArray:
        """Weighted residuals, shape (outputs·(N − 2),)."""
        return self.problem.weigh(self.tangents).ravel()

    @cached_property
    def jacobian(self) -> FloatArray:
        """Derivatives of the residuals, shape (outputs·(N − 2), n)."""
        derivative = self.tangents.by[: self.problem.outputs] * -self.problem.weights[:, :, None]
        return derivative.reshape(-1, derivative.shape[2])

    @cached_property
    def noise_scores(self) -> tuple[FloatArray, float]:
        """Jᵀ times the residuals caused by the nominal noise of each sample alone, shape (N − 2, n), and the
        mean squared residual caused by all of it."""
        noise = self.problem.noise
        weighed = self.tangents.by * -np.array([1.0 / noise.output, 1.0 / noise.input])[:, None, None]
        weights = (1.0, noise.output / noise.input)
        return noise_scores(self.problem.experiment, self.tangents, weighed, weights)
