"""The least squares problem that a window poses: what may vary, and how far the twin is off."""

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
from twinmatch.matching.bounds import Bounds, MatchingError, Unknown, unknown_parameters, unknown_starts
from twinmatch.matching.noise import Noise
from twinmatch.signals import FloatArray, Window

__all__ = ["Evaluation", "Problem", "checked_gains"]


def checked_gains(model: Model, window: Window, gains: Closing = FILED) -> PidGains | None:
    """The controller with which the twin is closed into its loop; None for one whose loop is not known.

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
    """The twin on one window as a function of the free parameters and of its unknown starts.

    Closed into its loop, it gets the window's reference and is held against output and input; without a
    known loop it is driven by the recorded input, and the output alone is compared. It begins at the third
    sample: with the output as it was measured there, and with the controller as the first two samples leave
    it.
    """

    window: Window
    free: tuple[str, ...]
    """Names of the parameters that vary."""
    base: Parameters
    """Values of all that does not vary."""
    noise: Noise
    gains: PidGains | None
    bounds: Bounds | None = None
    """Replace some of the plant's."""

    @cached_property
    def unknowns(self) -> tuple[Unknown, ...]:
        """What varies, in the order of every array of values: the parameters, then the starts."""
        model = self.base.model
        return unknown_parameters(model, self.free, self.bounds) + unknown_starts(model, self.bounds)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of the unknowns."""
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
        """How many signals are compared: output and input in closed loop, else the output alone."""
        return 1 if self.gains is None else 2

    @property
    def weights(self) -> FloatArray:
        """Of the signals compared, shape (outputs, 1)."""
        return np.array([[1.0 / self.noise.output], [1.0 / self.noise.input]])[: self.outputs]

    @property
    def measured(self) -> FloatArray:
        """The signals compared, as they were recorded, shape (outputs, N − 2)."""
        return self.experiment.measured[: self.outputs]

    def values_of(self, parameters: Parameters) -> FloatArray:
        """The unknowns of a plant as an array, moved inside the bounds; starts as the plant file has them."""
        return np.clip(self.experiment.values_of(parameters), self.lower, self.upper)

    def parameters_at(self, values: FloatArray) -> Parameters:
        """The plant with these values of the unknowns."""
        return self.experiment.parameters_at(values)

    def starts_at(self, values: FloatArray) -> Mapping[str, float]:
        """States at the third sample among the values, by name."""
        return self.experiment.starts_at(values)

    def weigh(self, response: Response | Tangents) -> FloatArray:
        """Measured minus simulated in units of the noise, shape (outputs, N − 2)."""
        simulated = np.stack([response.output, response.input][: self.outputs])
        return np.asarray((self.measured - simulated) * self.weights, dtype=np.float64)

    def evaluate(self, values: FloatArray) -> Evaluation:
        """Residuals and Jacobian at some values."""
        return Evaluation(self, values)

    def residuals(self, values: FloatArray) -> FloatArray:
        """Weighed residuals of the signals in a row, shape (outputs·(N − 2),)."""
        return self.weigh(self.experiment.simulate(values)).ravel()

    def jacobian(self, values: FloatArray) -> FloatArray:
        """Derivatives of the residuals, shape (outputs·(N − 2), n)."""
        return self.evaluate(values).jacobian

    def descend(self, start: FloatArray, most_evaluations: int, found: Descended | None = None) -> Descended:
        """Least squares from one start inside the bounds."""
        return self.experiment.descend(start, self.lower, self.upper, self.scales, most_evaluations, found)


class Evaluation:
    """A problem at some values: its normal equations, its residuals and Jacobian when they are asked for."""

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
        """Shape (outputs·(N − 2),)."""
        return self.problem.weigh(self.tangents).ravel()

    @cached_property
    def jacobian(self) -> FloatArray:
        """Shape (outputs·(N − 2), n)."""
        derivative = self.tangents.by[: self.problem.outputs] * -self.problem.weights[:, :, None]
        return derivative.reshape(-1, derivative.shape[2])

    @cached_property
    def noise_scores(self) -> tuple[FloatArray, float]:
        """Jᵀ times the residuals that the nominal noise of each sample alone would leave, shape (N − 2, n),
        and the mean squared residual that all of it leaves."""
        noise = self.problem.noise
        weighed = self.tangents.by * -np.array([1.0 / noise.output, 1.0 / noise.input])[:, None, None]
        weights = (1.0, noise.output / noise.input)
        return noise_scores(self.problem.experiment, self.tangents, weighed, weights)
