"""The least-squares problem of a window: its unknowns with their bounds, the noise, and its residuals."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from twinmatch.dynamics import (
    FROM_PLANT_FILE,
    SKIPPED,
    Descended,
    Experiment,
    Known,
    Law,
    LoopLaw,
    Model,
    Parameters,
    Plant,
    PlantError,
    law_for,
    noise_scores,
)
from twinmatch.fitting.data import FittingError
from twinmatch.signals import FloatArray, Window, only

Bounds = Mapping[str, tuple[float, float]]
LASTING: Final = 30.0
"""Correlation length of the residuals, samples: so many count as one independent residual."""


_ON_BOUND: Final = 1e-4
"""Distance from a bound below which a parameter counts as on it, in units of the interval or, within wide
bounds, of its typical size."""


class Expectation(NamedTuple):
    """What is known of a parameter before a window, in its unit."""

    mean: float
    deviation: float


Prior = Mapping[str, Expectation]
"""By name of the parameter."""


def known_of(prior: Prior, windows: int = 1) -> dict[str, Known]:
    """The prior of a search, with its weight divided among the windows."""
    known = {}
    for name, expectation in prior.items():
        known[name] = Known(
            expectation.mean, LASTING / (windows * expectation.deviation**2)
        )
    return known


@dataclass(frozen=True, slots=True)
class Unknown:
    """A parameter or initial state that a match estimates, as the plant file declares it."""

    name: str
    unit: str
    bounds: tuple[float, float]
    scale: float
    """Typical size (of a difference where zero is arbitrary)."""
    relative: bool
    """Whether its error is relative to its value; otherwise to its scale."""
    initial: bool = False
    """Whether it is a state at the window's start; these may be known badly."""


def checked_free(model: Model, free: Iterable[str] | None) -> tuple[str, ...]:
    """The free parameters, in the model's order; default: the structure's.

    Raises:
        FittingError: no name, an unknown or repeated one, or one that this structure does not have.
    """
    names = tuple(model.structure.free if free is None else free)
    unknown = [name for name in names if name not in model.names]
    if unknown:
        raise FittingError(
            f"matching: {unknown[0]!r} cannot be free in {model.title}; choose from {', '.join(model.names)}"
        )
    if not names or len(set(names)) != len(names):
        raise FittingError(
            f"matching: free is {names}; give at least one parameter and none twice"
        )
    return tuple(name for name in model.names if name in names)


def unknown_parameters(
    model: Model, names: Iterable[str], bounds: Bounds | None = None
) -> tuple[Unknown, ...]:
    """The named parameters as the plant declares them, with some bounds replaced.

    Raises:
        FittingError: bounds of an unknown name, or a pair that is not finite and in order.
        PlantError: a bound is not a possible value of the parameter.
    """
    given_bounds = dict(bounds or {})
    bounded = (*model.names, *model.states)
    for name, (low, high) in given_bounds.items():
        if name not in bounded:
            msg = f"matching: bounds for {name!r}, which is unknown; choose from {', '.join(bounded)}"
            raise FittingError(msg)
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            msg = f"matching: the bounds of {name} are {low} and {high}; give two finite numbers, lower first"
            raise FittingError(msg)
        declared = model.declared.get(name)
        for end in (low, high):
            if declared is not None and not declared.possible(end):
                msg = f"{model.title}: {name} is {end:g} {declared.unit}; it must be {declared.requirement}"
                raise PlantError(msg)
    unknowns = []
    for name in names:
        parameter = model.declared[name]
        limits = given_bounds.get(name, parameter.bounds)
        unknowns.append(
            Unknown(name, parameter.unit, limits, parameter.scale, parameter.relative)
        )
    return tuple(unknowns)


def unknown_starts(model: Model, bounds: Bounds | None = None) -> tuple[Unknown, ...]:
    """The states whose initial value is unknown in this structure."""
    unknowns = []
    for name in model.structure.free_starts:
        state = model.declared_states[model.states.index(name)]
        limits = (bounds or {}).get(name) or state.start_bounds or state.span
        unknowns.append(
            Unknown(name, state.unit, limits, state.scale, relative=False, initial=True)
        )
    return tuple(unknowns)


def ended_on_bounds(unknowns: Sequence[Unknown], values: FloatArray) -> tuple[str, ...]:
    """Names of the unknowns whose values, shape (n,), lie on a bound."""
    lower, upper = np.array([unknown.bounds for unknown in unknowns]).T
    unit = np.minimum(upper - lower, [unknown.scale for unknown in unknowns])
    near = np.minimum(values - lower, upper - values) <= _ON_BOUND * unit
    return tuple(
        unknown.name for unknown, hit in zip(unknowns, near, strict=True) if hit
    )


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations that weight the residuals; of a single signal given as a number.

    Raises:
        FittingError: one is not finite and positive.
    """

    outputs: tuple[float, ...] | float
    """Standard deviation of each output, in its unit."""
    inputs: tuple[float, ...] | float
    """Standard deviation of each input in steady closed loop, in its unit."""

    def __post_init__(self) -> None:
        for name in ("outputs", "inputs"):
            values = tuple(np.atleast_1d(getattr(self, name)).tolist())
            for value in values:
                if not (math.isfinite(value) and value > 0):
                    raise FittingError(
                        f"noise: {name[:-1]} is {value}; it must be finite and positive"
                    )
            object.__setattr__(self, name, values)

    @classmethod
    def of(cls, plant: type[Plant]) -> Noise:
        """The noise that the plant file declares."""
        return cls(
            tuple(output.noise for output in plant.outputs.values()),
            tuple(drive.noise for drive in plant.drives.values()),
        )

    @property
    def all(self) -> FloatArray:
        """Those of the outputs and then of the inputs, shape (o + m,)."""
        return np.concatenate([np.atleast_1d(self.outputs), np.atleast_1d(self.inputs)])

    @property
    def output(self) -> float:
        """That of a single output."""
        return float(only("output", np.atleast_1d(self.outputs)))

    @property
    def input(self) -> float:
        """That of a single input."""
        return float(only("input", np.atleast_1d(self.inputs)))


def checked_law(
    model: Model, window: Window, law: LoopLaw = FROM_PLANT_FILE
) -> Law | None:
    """The controller of the closed-loop twin; None if the loop is not known.

    Raises:
        FittingError: the controller has another period than the window.
    """
    checked = law_for(model.plant, window.period, law)
    if checked is not None and checked.period != window.period:
        raise FittingError(
            f"matching: the controller runs every {checked.period} s but the window's samples come every "
            f"{window.period} s; give both the same period"
        )
    return checked


class Evaluation(NamedTuple):
    """A problem at some values."""

    values: FloatArray
    cost: float
    """Sum of the squared residuals."""
    gradient: FloatArray
    """Jᵀr, shape (n,)."""
    hessian: FloatArray
    """JᵀJ, shape (n, n)."""


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
    law: Law | None
    bounds: Bounds | None = None
    """Replacements for some of the plant's bounds."""
    prior: Prior = field(default_factory=dict)
    """What is known beforehand; each counts as one independent residual."""

    @cached_property
    def unknowns(self) -> tuple[Unknown, ...]:
        """The unknowns, in the order of every array of values: parameters, then initial states."""
        model = self.base.model
        return unknown_parameters(model, self.free, self.bounds) + unknown_starts(
            model, self.bounds
        )

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
            law=self.law,
            weights=tuple(1.0 / self.noise.all),
            beforehand=known_of(
                {name: self.prior[name] for name in self.free if name in self.prior}
            ),
        )

    @property
    def compared(self) -> int:
        """Number of compared signals: outputs and, in closed loop, inputs."""
        plant = self.base.model.plant
        return len(plant.outputs) + (0 if self.law is None else len(plant.drives))

    @property
    def weights(self) -> FloatArray:
        """Weights of the compared signals, shape (compared, 1)."""
        return (1.0 / self.noise.all)[: self.compared, None]

    @property
    def seen(self) -> FloatArray:
        """1 for samples that were received, 0 for stand-ins, shape (N − 2,)."""
        marks = self.window.seen
        return (
            np.ones(len(self.window) - SKIPPED)
            if marks is None
            else marks[SKIPPED:].astype(np.float64)
        )

    @property
    def measured(self) -> FloatArray:
        """The compared signals as recorded, shape (compared, N − 2)."""
        return self.experiment.measured[: self.compared]

    def values_of(self, parameters: Parameters) -> FloatArray:
        """The unknowns of a plant as an array, clipped to the bounds; initial states are the plant file's."""
        return np.clip(self.experiment.values_of(parameters), self.lower, self.upper)

    def residuals(self, values: FloatArray) -> FloatArray:
        """Measured minus simulated in units of the noise, shape (compared, N − 2)."""
        response = self.experiment.simulate(values)
        simulated = np.concatenate([response.outputs, response.inputs], axis=1).T[
            : self.compared
        ]
        return np.asarray(
            (self.measured - simulated) * (self.weights * self.seen), dtype=np.float64
        )

    def evaluate(self, values: FloatArray, most: float = math.inf) -> Evaluation:
        """The sum of squares at some values, with its derivatives; where it is above `most`, those of as many samples
        as it takes to know that."""
        return Evaluation(values, *self.experiment.normal(values, most))

    def noise_scores(self, values: FloatArray) -> tuple[FloatArray, float]:
        """Jᵀ times the residuals caused by the nominal noise of each reading alone, shape ((N − 2)·o, n), and
        the mean squared residual caused by all of it."""
        tangents = self.experiment.tangents(values)
        noise = self.noise.all
        derivatives = tangents.by * self.seen[:, None] * -(1.0 / noise)[:, None, None]
        return noise_scores(
            self.experiment,
            tangents,
            derivatives,
            noise[: tangents.outputs.shape[1], None] / noise,
        )

    def mean_square(self, residuals: FloatArray) -> float:
        """Mean square of the weighted residuals of the window's last samples, stand-ins left out."""
        counted = float(np.mean(self.seen[-residuals.shape[1] :]))
        return float(np.mean(np.square(residuals))) / counted if counted else math.nan

    @property
    def residual_count(self) -> float:
        """Number of weighted residuals, stand-ins left out."""
        return float(np.sum(self.seen)) * len(self.measured)

    def descend(
        self,
        start: FloatArray,
        most_evaluations: int,
        found: Descended | None = None,
        settled: float = 0.0,
    ) -> Descended:
        """Least squares from one start inside the bounds, as `twinmatch.dynamics.descend`."""
        return self.experiment.descend(
            start, self.lower, self.upper, self.scales, most_evaluations, found, settled
        )
