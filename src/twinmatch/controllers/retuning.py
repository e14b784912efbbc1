"""Better gains for a PID that runs: best in the mean over all twins, with a ceiling on their sensitivity.

The cost is the mean squared error after a load at the input, or after a step of the set-point, in the
compiled loop with its limits; its derivatives by the gains are exact. Gains change by factors, so their signs
and zeros stay. A load of −d is a start with an integral that is d too small: while the error is zero, the
command is the integral.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np

from twinmatch.controllers.answer import ControllerError
from twinmatch.controllers.members import Holding, TriedTwin
from twinmatch.controllers.responses import LOAD
from twinmatch.controllers.whole_loop import WholeLoop
from twinmatch.dynamics import SKIPPED, Experiment, Linear, PidGains, PlantError, read
from twinmatch.dynamics.pids import as_linear
from twinmatch.errors import TwinmatchError
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray, Window

Aim = Literal["load", "tracking", "quiet"]
AIMS: Final[tuple[Aim, ...]] = ("load", "tracking", "quiet")
TUNED: Final = ("proportional", "integral", "derivative")
STEP: Final = 0.1
"""Step of the set-point, as a share of its range."""


class _RetuningLimits(Rule):
    """When a search for gains ends, and what counts as better: three times the tolerance of the limits."""

    least_gain: float = 0.03
    """Least relative improvement that is worth other gains."""
    steps: int = 40
    """Steps of the search, at most."""
    tolerance: float = 1e-2
    """By how much limits may be missed, relative to them."""
    largest_sensitivity: float = 1e3
    """Sensitivity that counts for a loop which is hardly stable, or unstable."""


_LIMITS: Final = _RetuningLimits()


@dataclass(frozen=True, slots=True)
class Retuned:
    """Gains before and after."""

    before: PidGains
    after: PidGains
    aim: Aim
    improvement: float
    """By how much the criterion is smaller, as a share; 0 if the gains are as before."""
    sensitivities: tuple[float, float]
    """Largest M_s over the twins, before and after."""
    reason: str
    """Why the gains are as they are, in one sentence."""


@dataclass(frozen=True, eq=False)
class TuningCase:
    """One twin where it is held, and its loop as an experiment on the gains."""

    plants: tuple[Linear, ...]
    """Linearised at the set-point and a step of it up and down, as far as it can be held there."""
    experiment: Experiment
    fixed: FloatArray
    """The unknowns after the gains: its initial states."""
    reference: FloatArray
    """Shape (N,)."""

    def cost(self, gains: FloatArray) -> tuple[float, FloatArray]:
        """Mean squared error, and its derivatives by the gains."""
        run = self.experiment.tangents(np.concatenate([gains, self.fixed]))
        error = run.outputs[:, 0] - self.reference
        if not np.isfinite(error).all():
            return math.inf, np.zeros(gains.size)
        slopes = run.by[0][:, : gains.size]
        return float(np.mean(error**2)), 2.0 * (error @ slopes) / error.size


def retune(
    twins: Sequence[TriedTwin],
    gains: PidGains,
    level: float,
    holding: Holding,
    *,
    aim: Aim = "load",
    max_sensitivity: float = 1.6,
    most_change: float = 2.0,
) -> Retuned:
    """Find the gains that are best in the mean over the twins at a set-point.

    Args:
        twins: those of a session, of a plant with one loop.
        gains: the PID that runs.
        level: the set-point.
        holding: how the plant is held there.
        aim: what to make small: the mean squared error after a load or a set-point step, or the travel of the
            command, with the error after a load at most as it is.
        max_sensitivity: ceiling of M_s on every twin.
        most_change: largest factor by which a gain may change.

    Raises:
        ControllerError: no twin can be held there, or a limit is not above 1.
    """
    if not (max_sensitivity > 1.0 and most_change > 1.0):
        raise ControllerError(
            f"retune: the ceiling {max_sensitivity:g} and the largest change {most_change:g} must be above 1"
        )
    tuning = _Tuning(
        gains, tuple(_cases(twins, gains, level, holding, aim)), aim, max_sensitivity
    )
    start = np.zeros(len(tuning.names))
    best = tuning.search(math.log(most_change))
    before = float(tuning.sensitivities(start).max())
    after = float(tuning.sensitivities(best).max())
    improvement = 1.0 - math.exp(tuning.criterion(best) - tuning.criterion(start))
    ceiling = max_sensitivity * (1 + _LIMITS.tolerance)
    is_worse = aim == "quiet" and tuning.cost(best)[0] > tuning.cost(start)[0] * (
        1 + _LIMITS.tolerance
    )
    gains_nothing = improvement < _LIMITS.least_gain or is_worse
    if after > max(ceiling, before) or (before <= ceiling and gains_nothing):
        why = f"there is nothing to gain within M_s ≤ {max_sensitivity:g} and a factor of {most_change:g}"
        return Retuned(gains, gains, aim, 0.0, (before, before), why)
    if before > ceiling:
        why = f"M_s comes down from {before:.2f}; {_WORDS[aim]} changes by {-100 * improvement:+.0f} %"
    else:
        number = len(tuning.cases)
        why = f"{_WORDS[aim]} is {100 * improvement:.0f} % smaller in the mean over {number} twins"
    return Retuned(gains, tuning.law(best), aim, improvement, (before, after), why)


_WORDS: Final = {
    "load": "the mean squared error after a load",
    "tracking": "the mean squared error after a step of the set-point",
    "quiet": "the travel of the command by noise",
}


def _travel(gains: PidGains) -> float:
    """Standard deviation of the command's change from sample to sample, for noise of 1 in the reading."""
    rate = gains.derivative / gains.period
    through = np.convolve([gains.proportional + rate, -rate], [1.0, -1.0])
    return float(np.linalg.norm(through))


@dataclass(frozen=True, eq=False)
class _Tuning:
    """The search for factors on the gains, given as logarithms x."""

    gains: PidGains
    cases: tuple[TuningCase, ...]
    aim: Aim
    ceiling: float

    @property
    def names(self) -> tuple[str, ...]:
        """The gains that are tuned."""
        return _tuned(self.gains)

    @property
    def _first(self) -> FloatArray:
        """The tuned gains as they are before the search."""
        return np.array([getattr(self.gains, name) for name in self.names])

    def law(self, x: FloatArray) -> PidGains:
        """The PID whose gains are changed by the factors exp(x)."""
        changes: dict[str, Any] = dict(
            zip(self.names, (self._first * np.exp(x)).tolist(), strict=True)
        )
        return replace(self.gains, **changes)

    def sensitivities(self, x: FloatArray) -> FloatArray:
        """M_s of every twin, the largest over its operating points."""
        linear = as_linear(self.law(x))
        largest = []
        for case in self.cases:
            of_plants = [
                WholeLoop(plant, linear).sensitivity() for plant in case.plants
            ]
            largest.append(min(max(of_plants), _LIMITS.largest_sensitivity))
        return np.array(largest)

    def cost(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Mean squared error in the mean over the twins, and its derivatives."""
        gains = self._first * np.exp(x)
        costs = [case.cost(gains) for case in self.cases]
        error = float(np.mean([value for value, _ in costs]))
        slopes = np.mean([slope for _, slope in costs], axis=0)
        return error, np.asarray(slopes * gains, dtype=np.float64)

    def criterion(self, x: FloatArray) -> float:
        """Logarithm of what is made small."""
        return math.log(
            _travel(self.law(x)) if self.aim == "quiet" else self.cost(x)[0]
        )

    def _slope(self, x: FloatArray) -> FloatArray:
        """Derivatives of the criterion by x."""
        from scipy.optimize import approx_fprime  # noqa: PLC0415

        if self.aim == "quiet":
            return np.asarray(approx_fprime(x, self.criterion), dtype=np.float64)
        value, slope = self.cost(x)
        return slope / value

    def search(self, reach: float) -> FloatArray:
        """The best x within ± reach, by sequential quadratic programming."""
        from scipy.optimize import Bounds, NonlinearConstraint, minimize  # noqa: PLC0415

        start = np.zeros(len(self.names))
        origin = self.cost(start)[0]
        limits = [NonlinearConstraint(self.sensitivities, -np.inf, self.ceiling)]
        if self.aim == "quiet":
            limits.append(
                NonlinearConstraint(lambda x: [self.cost(x)[0] / origin], -np.inf, 1.0)
            )
        solution = minimize(
            self.criterion,
            start,
            jac=self._slope,
            method="SLSQP",
            bounds=Bounds(start - reach, start + reach),
            constraints=limits,
            options={"maxiter": _LIMITS.steps, "ftol": 1e-5},
        )
        return np.asarray(solution.x, dtype=np.float64)


def _tuned(gains: PidGains) -> tuple[str, ...]:
    """Names of the gains that are not zero.

    Raises:
        ControllerError: all are.
    """
    names = tuple(name for name in TUNED if getattr(gains, name) != 0.0)
    if not names:
        raise ControllerError(
            "retune: all gains of the PID are zero; there is nothing to begin with"
        )
    return names


def _cases(
    twins: Sequence[TriedTwin],
    gains: PidGains,
    level: float,
    holding: Holding,
    aim: Aim,
) -> list[TuningCase]:
    cases = []
    error = "there is none"
    for twin in twins:
        try:
            cases.append(tuning_case(twin, gains, level, holding, aim))
        except TwinmatchError as reason:
            error = str(reason)
    if not cases:
        raise ControllerError(f"retune: no twin can be held at {level:g}; {error}")
    return cases


def tuning_case(
    twin: TriedTwin, gains: PidGains, level: float, holding: Holding, aim: Aim
) -> TuningCase:
    """One twin at a set-point: a step of it, or a load as an integral that begins off by it."""
    plant = holding.linear(twin.parameters, [level], twin.disturbances)
    model = twin.parameters.model
    row = model.disturbance_row(twin.disturbances)
    size = holding.samples + SKIPPED
    y = read(twin.parameters, plant.rest.states, row)
    u = plant.rest.input
    reference = np.full(size, y)
    inputs = np.full(size, u)
    if aim == "tracking":
        low, high = model.plant.output.set_points or model.plant.output.span
        direction = 1.0 if y < (low + high) / 2 else -1.0
        reference[SKIPPED:] += STEP * (high - low) * direction
    else:
        low, high = model.plant.drive.limits
        load = LOAD * (high - low)
        inputs -= load if u - load > gains.low else -load
    rows = np.tile(row, (size, 1))
    window = Window(
        reference, np.full(size, y), inputs, period=gains.period, disturbances=rows
    )
    experiment = Experiment(
        twin.parameters,
        (),
        window,
        free_starts=model.states,
        free_gains=_tuned(gains),
        law=gains,
    )
    return TuningCase(
        _around(twin, level, holding),
        experiment,
        plant.rest.states,
        reference[SKIPPED:],
    )


def _around(twin: TriedTwin, level: float, holding: Holding) -> tuple[Linear, ...]:
    """The twin linearised at the set-point and a step of it up and down, where it can be held."""
    output = twin.parameters.model.plant.output
    plants = []
    low, high = output.set_points or output.span
    for shift in (0.0, STEP, -STEP):
        try:
            plants.append(
                holding.linear(
                    twin.parameters, [level + shift * (high - low)], twin.disturbances
                )
            )
        except PlantError:
            continue  # the drive does not reach that far
    return tuple(plants)
