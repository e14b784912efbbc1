"""The least squares problem that a window poses: what may vary, and how far the twin is off."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from twinmatch.matching.bounds import BOUNDS, SCALES, SINK_START, Bounds, MatchingError
from twinmatch.plant import (
    Driver,
    PidGains,
    PidState,
    Response,
    RigParameters,
    controller_state,
    noise_sensitivity,
    simulate_closed_loop,
)
from twinmatch.plant.sensitivity import DIFFERENTIABLE, LoopSensitivity, Tangents, noise_scores
from twinmatch.signals import KELVIN, FloatArray, Window

__all__ = ["Evaluation", "Noise", "Problem"]


_STEP = 1e-5
"""Finite difference in units of the scale: truncation near 1e-10, rounding near 1e-8 of a residual."""
_NOISE_STEP = 1e-3
"""Finite difference of the start, °C."""
_SKIPPED = 2
"""A twin starts at the third sample, where the controller's memory is known."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations by which residuals are weighed; the defaults are the healthy rig's.

    Raises:
        MatchingError: one is not finite and positive.
    """

    output: float = 0.1
    """Of the output, on the rig the temperature, °C."""
    input: float = 7.0
    """Of the input, on the rig the PWM command."""

    def __post_init__(self) -> None:
        for name, value in (("output", self.output), ("input", self.input)):
            if not (math.isfinite(value) and value > 0):
                msg = f"noise: {name} is {value}; it must be finite and positive"
                raise MatchingError(msg)


@dataclass(frozen=True, eq=False)
class Problem:
    """The closed-loop twin on one window as a function of the free parameters.

    The twin gets the window's reference from the third sample on. It starts with the plate as it was
    measured there and with the controller as the first two samples leave it.
    """

    window: Window
    free: tuple[str, ...]
    """Names that vary, in the order of every array of values; `SINK_START` among them or not."""
    base: RigParameters
    """Values of all that does not vary."""
    noise: Noise
    gains: PidGains
    driver: Driver
    bounds: Bounds = field(default_factory=lambda: BOUNDS)
    controller: PidState = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "controller", controller_state(self.window, self.gains))

    @cached_property
    def _loop(self) -> LoopSensitivity | None:
        """The loop with its derivatives; None when rig or free parameters ask for finite differences."""
        if not (LoopSensitivity.handles(self.base) and set(self.free) <= set(DIFFERENTIABLE)):
            return None
        return LoopSensitivity(
            self.free,
            self.window.reference[_SKIPPED:],
            plate=float(self.window.output[_SKIPPED]) + KELVIN,
            controller=self.controller,
            gains=self.gains,
            driver=self.driver,
        )

    @cached_property
    def weights(self) -> FloatArray:
        """Of output and input, shape (2, 1)."""
        return np.array([[1.0 / self.noise.output], [1.0 / self.noise.input]])

    @cached_property
    def _measured(self) -> FloatArray:
        """Output and input, shape (2, N − 2)."""
        return np.stack([self.output, self.input])

    @cached_property
    def _rig(self) -> tuple[FloatArray, list[int]]:
        """Values of all `DIFFERENTIABLE` parameters, and which of them are free."""
        fixed = np.array([getattr(self.base, name) for name in DIFFERENTIABLE], dtype=np.float64)
        return fixed, [DIFFERENTIABLE.index(name) for name in self.free]

    @property
    def output(self) -> FloatArray:
        """Measured output against which the twin is held, shape (N − 2,)."""
        return self.window.output[_SKIPPED:]

    @property
    def input(self) -> FloatArray:
        """Measured input against which the twin is held, shape (N − 2,)."""
        return self.window.input[_SKIPPED:]

    @cached_property
    def lower(self) -> FloatArray:
        """Lower bounds of the free parameters."""
        return np.array([self.bounds[name][0] for name in self.free])

    @cached_property
    def upper(self) -> FloatArray:
        """Upper bounds of the free parameters."""
        return np.array([self.bounds[name][1] for name in self.free])

    @cached_property
    def scales(self) -> FloatArray:
        """Typical sizes of the free parameters."""
        return np.array([SCALES[name] for name in self.free])

    def values_of(self, parameters: RigParameters, sink_start: float | None = None) -> FloatArray:
        """The free parameters of a rig as an array, moved inside the bounds."""
        start = parameters.ambient if sink_start is None else sink_start
        values = [start if name == SINK_START else getattr(parameters, name) for name in self.free]
        return np.clip(np.array(values, dtype=np.float64), self.lower, self.upper)

    def parameters_at(self, values: FloatArray) -> RigParameters:
        """The rig with these values of the free parameters."""
        named = dict(zip(self.free, values.tolist(), strict=True))
        named.pop(SINK_START, None)
        return self.base.replace(**named)

    def sink_start_at(self, values: FloatArray) -> float | None:
        """The sink's first temperature among the values, K; None when it starts at ambient."""
        return float(values[self.free.index(SINK_START)]) if SINK_START in self.free else None

    def simulate(
        self, parameters: RigParameters, sink_start: float | None = None, plate: float | None = None
    ) -> Response:
        """The twin's answer to the window's reference, from the third sample on.

        Its sink starts at `sink_start` (K) or else at ambient, its plate at `plate` (K) or else where
        the third sample measured it.
        """
        return simulate_closed_loop(
            parameters,
            self.window.reference[_SKIPPED:],
            plate=float(self.window.output[_SKIPPED]) + KELVIN if plate is None else plate,
            sink=sink_start,
            controller=self.controller,
            gains=self.gains,
            driver=self.driver,
        )

    def weigh(self, response: Response) -> FloatArray:
        """Measured minus simulated in units of the noise, shape (2, N − 2): output, input."""
        left = np.empty((2, self.output.size))
        left[0] = self.output - response.output
        left[1] = self.input - response.input
        left *= self.weights
        return left

    def evaluate(self, values: FloatArray) -> Evaluation:
        """Residuals and Jacobian at some values."""
        return Evaluation(self, values)

    def residuals(self, values: FloatArray) -> FloatArray:
        """Weighed residuals of both outputs in a row, shape (2(N − 2),)."""
        return self.weigh(self.simulate(self.parameters_at(values), self.sink_start_at(values))).ravel()

    @property
    def differentiable(self) -> bool:
        """Whether the loop comes with its derivatives; otherwise they are finite differences."""
        return self._loop is not None

    def tangents(self, values: FloatArray) -> Tangents | None:
        """The loop and its derivatives in one pass, where this rig is of the kind that has them."""
        return None if self._loop is None else self._loop(self._rig_at(values))

    def normal_equations(self, values: FloatArray) -> tuple[float, FloatArray, FloatArray] | None:
        """Sum of squares, gradient and JᵀJ in one pass, where this rig is of the kind that has them."""
        if self._loop is None:
            return None
        weights = 1.0 / self.noise.output, 1.0 / self.noise.input
        return self._loop.normal_equations(self._rig_at(values), self._measured, weights)

    def _rig_at(self, values: FloatArray) -> FloatArray:
        rig, places = self._rig[0].copy(), self._rig[1]
        rig[places] = values
        return rig

    def jacobian(self, values: FloatArray) -> FloatArray:
        """Derivatives of the residuals, shape (2(N − 2), n)."""
        return self.evaluate(values).jacobian

    def differences(self, values: FloatArray) -> FloatArray:
        """The Jacobian by finite differences: central, one-sided at a bound."""
        columns = []
        for i, scale in enumerate(self.scales):
            above, below = values.copy(), values.copy()
            above[i] = min(values[i] + _STEP * scale, self.upper[i])
            below[i] = max(values[i] - _STEP * scale, self.lower[i])
            change = self.residuals(above) - self.residuals(below)
            columns.append(change / (above[i] - below[i]))
        return np.stack(columns, axis=1)

    def noise_scores(self, evaluation: Evaluation) -> tuple[FloatArray, float]:
        """Jᵀ times the residuals that the nominal noise of each sample alone would leave, shape (N − 2, n),
        and the mean squared residual that all of it leaves."""
        if evaluation.tangents is None:
            left = self.noise_left(evaluation.values)
            return left @ evaluation.jacobian, float(np.sum(np.square(left))) / left.shape[1]
        weighed = evaluation.jacobian.reshape(2, -1, len(self.free))
        return noise_scores(
            evaluation.tangents, weighed, (1.0, self.noise.output / self.noise.input), self.gains
        )

    def noise_left(self, values: FloatArray) -> FloatArray:
        """Residuals that the nominal noise of each sample alone would leave, shape (N − 2, 2(N − 2)).

        Noise of the first reading also misplaces the start of the twin, which knows no better.
        """
        parameters, sink = self.parameters_at(values), self.sink_start_at(values)
        start = float(self.window.output[_SKIPPED]) + KELVIN
        loop = noise_sensitivity(
            parameters,
            self.window.reference[_SKIPPED:],
            plate=start,
            sink=sink,
            controller=self.controller,
            gains=self.gains,
            driver=self.driver,
        )
        misplaced = self.simulate(parameters, sink, start + _NOISE_STEP)
        quiet = self.simulate(parameters, sink)
        loop[0, 0] -= (misplaced.output - quiet.output) / _NOISE_STEP
        loop[0, 1] -= (misplaced.input - quiet.input) / _NOISE_STEP
        weights = np.array([1.0, self.noise.output / self.noise.input])
        return np.reshape(loop * weights[:, None], (loop.shape[0], -1))


class Evaluation:
    """A problem at some values: its normal equations, its residuals and Jacobian when they are asked for."""

    def __init__(self, problem: Problem, values: FloatArray) -> None:
        self.problem, self.values = problem, values

    @cached_property
    def normal(self) -> tuple[float, FloatArray, FloatArray]:
        """Sum of squares S, gradient Jᵀr, shape (n,), and JᵀJ, shape (n, n)."""
        found = self.problem.normal_equations(self.values)
        if found is None:
            return self.cost, self.jacobian.T @ self.residuals, self.jacobian.T @ self.jacobian
        return found

    @cached_property
    def cost(self) -> float:
        """Sum of the squared residuals."""
        if self.problem.differentiable:
            return self.normal[0]
        return float(self.residuals @ self.residuals)

    @cached_property
    def tangents(self) -> Tangents | None:
        """The loop with its derivatives, where this rig is of the kind that has them."""
        return self.problem.tangents(self.values)

    @cached_property
    def residuals(self) -> FloatArray:
        """Shape (2(N − 2),)."""
        if self.tangents is None:
            return self.problem.residuals(self.values)
        response = Response(self.tangents.temperature, self.tangents.pwm)
        return self.problem.weigh(response).ravel()

    @cached_property
    def jacobian(self) -> FloatArray:
        """Shape (2(N − 2), n)."""
        if self.tangents is None:
            return self.problem.differences(self.values)
        derivative = self.tangents.derivative * -self.problem.weights[:, :, None]
        return derivative.reshape(-1, derivative.shape[2])
