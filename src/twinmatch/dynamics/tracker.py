"""Tracking of a running plant by its equations: states, parameters and unmeasured influences together.

An extended Kalman filter whose state is, in this order, the plant's states, the free parameters of its
structure, and six numbers that no plant file declares: the relative excess of the drive's effect; a permanent
and a passing offset of the reading (a camera that has just corrected itself); a fading and a permanent push
on the output; and the rate at which one of the others rises. Of these only the passing offset and the fading
push have process noise; the variance of the others is opened to test whether they changed.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from twinmatch.dynamics.filters import (
    EXTRA,
    FADING,
    OFFSET,
    PASSING,
    PUSH,
    RATE,
    SHARE,
    Drift,
    Opening,
    Readings,
    Traces,
    TrackedParameters,
    TrackerConstants,
)
from twinmatch.dynamics.pace import slow_scale
from twinmatch.dynamics.plant import Parameters
from twinmatch.dynamics.simulation import begin
from twinmatch.signals import BoolArray, FloatArray

_PUSH_TIME: Final = 100.0
"""Time constant of the fading push, s."""
_OFFSET_TIME: Final = 14.0
"""Time constant of the passing offset after a camera's correction, s."""
_LOG_SPREAD: Final = 0.6
"""Initial standard deviation of the logarithm of a parameter …"""
_SPREAD: Final = 0.5
"""… or of a parameter tracked without logarithm, in its scale."""
_IMPOSSIBLE: Final = 50.0
"""Code length of a reading that a belief excludes, nats: as if it were off by ten standard deviations."""
_MODEL_ERROR: Final = np.array([0.6, 0.001, 5e-4, 0.2, 0.15])
"""Model error of a real rig, as standard deviations: drift of a state that the output shows, in noises, and
of another, in scales, per root of a sample; drift of a parameter, in scales, per root of a second; the fading
push, in noises per sample; and the error of a movement, as a share of it."""


def no_traces(size: int) -> Traces:
    """Empty traces."""
    return Traces(np.zeros((size, 0, 0)), np.zeros((0, 0)), np.zeros((0, 0)))


@dataclass(frozen=True)
class Belief:
    """The belief at one sample; immutable."""

    values: FloatArray
    """Means, shape (n,)."""
    covariance: FloatArray
    """Shape (n, n)."""

    def closed(self, index: int) -> Belief:
        """A copy with one of the numbers known to be zero."""
        values = self.values.copy()
        covariance = self.covariance.copy()
        values[index] = 0.0
        covariance[index, :] = covariance[:, index] = 0.0
        return Belief(values, covariance)

    def opened(self, index: int, shift: float, spread: float) -> Belief:
        """A copy with one of the numbers shifted, with a standard deviation `spread` of the shift."""
        values = self.values.copy()
        covariance = self.covariance.copy()
        values[index] += shift
        covariance[index, index] += spread**2
        return Belief(values, covariance)


@dataclass(frozen=True)
class Assumed:
    """What is assumed of a plant's states, parameters and readings before it is seen."""

    free: TrackedParameters
    shown: BoolArray
    """Whether an output shows a state, shape (n,)."""
    first: FloatArray
    """Initial standard deviations of states and parameters, shape (n + m,)."""
    drift: FloatArray
    """Their drift at a model error of one, per root of a second, shape (n + m,)."""
    fading: FloatArray
    """Initial standard deviation of the fading push on each output, shape (o,) …"""
    stray: FloatArray
    """… and its drift."""
    swift: float
    """Error of a movement of the output, as a share of it."""
    keeps: tuple[float, float]
    """Factors per period on a fading push and on a passing offset."""

    @classmethod
    def of(cls, parameters: Parameters, period: float) -> Assumed:
        """For a plant that begins with these parameters; `period` is the sample time, s."""
        model = parameters.model
        free = model.structure.free
        declared = model.declared
        noise = model.noise
        tracked = _tracked_parameters(parameters)
        scales = np.array(
            [
                1.0 if log else declared[k].scale
                for k, log in zip(free, tracked.logged, strict=True)
            ]
        )
        state_scales = np.array([state.scale for state in model.declared_states])
        at_start = begin(parameters, np.zeros(noise.size))
        *_, by_states, _, _ = model.kernels.slopes_at(
            parameters.vector, at_start, model.rest, model.disturbances
        )
        with np.errstate(divide="ignore"):
            by_noise = np.min(noise[:, np.newaxis] / np.abs(by_states), axis=0)
        shown = np.isfinite(by_noise)
        by_noise[~shown] = 0.0
        scale = slow_scale(model.plant, period)
        push_time = _PUSH_TIME * scale
        fading = _MODEL_ERROR[3] * noise / period
        drift = np.where(
            shown, _MODEL_ERROR[0] * by_noise, _MODEL_ERROR[1] * state_scales
        )
        first_of_states = np.where(shown, 3.0 * by_noise, 0.5 * state_scales)
        first_of_parameters = np.where(tracked.logged, _LOG_SPREAD, _SPREAD * scales)
        # A plant sampled faster is assumed to be faster.
        drift_of_states = drift / math.sqrt(period)
        drift_of_parameters = _MODEL_ERROR[2] * scales / math.sqrt(scale)
        keeps_push = math.exp(-period / push_time)
        keeps_offset = math.exp(-period / (_OFFSET_TIME * scale))
        return cls(
            free=tracked,
            shown=shown,
            first=np.concatenate([first_of_states, first_of_parameters]),
            drift=np.concatenate([drift_of_states, drift_of_parameters]),
            fading=fading,
            stray=fading * math.sqrt(2.0 / push_time),
            swift=float(_MODEL_ERROR[4]),
            keeps=(keeps_push, keeps_offset),
        )


def _tracked_parameters(parameters: Parameters) -> TrackedParameters:
    """The free parameters of a structure, positive ones without an upper bound as logarithms."""
    free = parameters.model.structure.free
    declared = parameters.model.declared
    kernels = parameters.model.kernels
    values = np.array([parameters[name] for name in free])
    logged = np.array(
        [
            declared[k].relative and parameters[k] > 0 and math.isinf(declared[k].most)
            for k in free
        ],
        bool,
    )
    bounds = np.array([declared[name].bounds for name in free]).reshape(-1, 2)
    floor = np.maximum(bounds[:, 0], 0.01 * values)
    # Limits lie outside the bounds: clipping a mean breaks its correlation with the other numbers.
    width = bounds[:, 1] - bounds[:, 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        least = np.where(logged, np.log(floor / values), bounds[:, 0] - width - values)
        most = np.where(
            logged, np.log(bounds[:, 1] / values), bounds[:, 1] + width - values
        )
    return TrackedParameters(
        vector=parameters.vector.copy(),
        places=np.array([kernels.PARAMETERS.index(k) for k in free], dtype=np.int64),
        which=np.array([kernels.UNKNOWN.index(k) for k in free], dtype=np.int64),
        logged=logged,
        least=least,
        most=most,
    )


class Tracker:
    """Tracks one plant at several levels of assumed model error."""

    def __init__(
        self, parameters: Parameters, period: float, levels: tuple[float, ...]
    ) -> None:
        """Begin with these parameters; `levels` are factors on the model error of a real rig."""
        model = parameters.model
        free = model.structure.free
        self.parameters = parameters
        self.free = free
        n = len(model.states)
        m = len(free)
        self.size = n + m + EXTRA
        self.at = {name: n + j for j, name in enumerate(free)}
        """Indices of the parameters in a belief."""
        self.share, self.offset, self.passing, self.fading, self.push, self.rate = (
            self.size + place for place in (SHARE, OFFSET, PASSING, FADING, PUSH, RATE)
        )
        assumed = Assumed.of(parameters, period)
        self.logged = assumed.free.logged
        self._shown = assumed.shown
        self._first = assumed.first
        keeps = np.ones(self.size)
        drift = np.zeros(self.size)
        keeps[self.fading], keeps[self.passing] = assumed.keeps
        drift[: n + m] = assumed.drift
        drift[self.fading] = assumed.stray[0]
        self._fading = float(assumed.fading[0])
        self._fixed = TrackerConstants(
            free=assumed.free,
            keeps=keeps,
            rest=float(model.plant.drive.rest),
            period=float(period),
            # parameters move, and a fast plant may become faster
            steps=2 * parameters.steps(period),
        )
        self.track = functools.partial(model.kernels.track, self._fixed)
        self.drifts = [Drift(level * drift, level * assumed.swift) for level in levels]
        self.none = no_traces(self.size)
        self._nothing_opened = Opening(np.zeros(self.size), 0, -1)
        self._levels = levels

    def begin(
        self, output: float, input: float, disturbances: FloatArray, level: int
    ) -> Belief:
        """The belief at the first reading, after a given input."""
        values = np.zeros(self.size)
        n = len(self.parameters.model.states)
        values[:n] = begin(
            self.parameters, output, input=input, disturbances=disturbances
        )
        spread = np.zeros(self.size)
        spread[: self._first.size] = self._first
        spread[self.fading] = self._levels[level] * self._fading
        return Belief(values, np.diag(spread**2))

    def again(
        self, belief: Belief, output: float, input: float, disturbances: FloatArray
    ) -> Belief:
        """The belief after a gap: parameters are kept, states restart from a reading."""
        n = len(self.parameters.model.states)
        start = self.begin(output, input, disturbances, 0)
        values = belief.values.copy()
        covariance = belief.covariance.copy()
        values[:n] = np.where(self._shown, start.values[:n], values[:n])
        values[self.passing] = values[self.fading] = 0.0
        for i in (*range(n), self.passing):
            covariance[i, :] = covariance[:, i] = 0.0
            covariance[i, i] = start.covariance[i, i]
        return Belief(values, covariance)

    def returned(self, belief: Belief, before: Belief) -> Belief:
        """The belief about a plant whose parameters are what they were `before`; what passes is as it is now,
        and as uncertain as at the beginning, for what the equations leave out was moved, too."""
        passes = [*range(len(self.parameters.model.states)), self.passing, self.fading]
        values = before.values.copy()
        values[passes] = belief.values[passes]
        covariance = before.covariance.copy()
        covariance[passes, :] = 0.0
        covariance[:, passes] = 0.0
        both = np.ix_(passes, passes)
        first_deviations = np.append(
            self._first[: len(passes) - 2], [0.0, self._fading]
        )
        covariance[both] = belief.covariance[both] + np.diag(first_deviations**2)
        return Belief(values, covariance)

    def run(
        self,
        belief: Belief,
        readings: Readings,
        level: int,
        *,
        traces: Traces | None = None,
    ) -> tuple[Belief, float]:
        """The belief after some samples, and the code length of their readings, in nats.

        If the equations have no solution where this belief leads, it starts again from the newest reading,
        and these were all far from what it expected.

        Args:
            belief: the belief before them.
            readings: the samples.
            level: index of the level.
            traces: updated in place.
        """
        on, cost = self.moved_on(
            belief, level, readings, self._nothing_opened, traces, 0.0
        )
        if math.isfinite(cost):
            return on, cost
        return self.started_again(belief, readings)

    def moved_on(  # noqa: PLR0917
        self,
        belief: Belief,
        level: int,
        readings: Readings,
        opening: Opening,
        traces: Traces | None,
        cost: float,
    ) -> tuple[Belief, float]:
        """The belief after some samples, and the code length of their readings and of those before, which is
        `cost`; not finite if the equations had no solution on the way."""
        values = belief.values.copy()
        covariance = belief.covariance.copy()
        cost = self.track(
            values,
            covariance,
            self.drifts[level],
            readings,
            opening,
            traces or self.none,
            cost,
        )
        return Belief(values, covariance), cost

    def started_again(self, belief: Belief, readings: Readings) -> tuple[Belief, float]:
        """A belief whose equations have no solution, started again from the newest reading, and the code
        length of these readings, which it excludes."""
        output = readings.output[np.isfinite(readings.output)][-1]
        row = readings.disturbances[-1]
        restarted = self.again(belief, float(output), float(readings.input[-1]), row)
        return restarted, _IMPOSSIBLE * readings.input.size

    def named(self, belief: Belief, name: str) -> float:
        """The believed value of a parameter."""
        q = float(belief.values[self.at[name]])
        start = self.parameters[name]
        return start * math.exp(q) if self.logged[self.free.index(name)] else start + q

    def expected(
        self, belief: Belief, disturbances: FloatArray, given: FloatArray
    ) -> tuple[float, float]:
        """The reading that is expected next, under inputs given, and its variance without noise, in the
        output's unit."""
        model = self.parameters.model
        n = len(model.states)
        m = len(self.free)
        tracked = self._fixed.free
        vector = tracked.vector.copy()
        vector[tracked.places] = [self.named(belief, name) for name in self.free]
        x = belief.values[:n]
        driven = given - model.rest
        u = model.rest + driven * (1.0 + belief.values[self.share])
        output = model.kernels.outputs_at(vector, x, u, disturbances)[0][0]
        _, _, _, _, by_states, by_unknown, by_inputs = model.kernels.slopes_at(
            vector, x, u, disturbances
        )
        slope = np.zeros(self.size)
        slope[:n] = by_states[0]
        slope[[self.offset, self.passing]] = 1.0
        slope[self.share] = float(by_inputs[0] @ driven)
        by_logarithm = np.where(self.logged, vector[tracked.places], 1.0)
        slope[n : n + m] = by_unknown[0, tracked.which] * by_logarithm
        offset = belief.values[self.offset] + belief.values[self.passing]
        return float(output + offset), float(slope @ belief.covariance @ slope)


class TrackedCourse:
    """A belief that is tracked on as readings come, each of them once."""

    def __init__(
        self,
        tracker: Tracker,
        belief: Belief,
        level: int,
        *,
        opened: FloatArray | None = None,
        lasting: int = 0,
        rising: int = -1,
    ) -> None:
        """Begin before the first reading.

        Args:
            tracker: the plant's.
            belief: the belief before them.
            level: index of the level.
            opened: additional drift, per √s, in the first `lasting` samples, shape (n,).
            lasting: number of those samples.
            rising: index of the number that rises at the believed rate; negative: none.
        """
        self._tracker = tracker
        self._begin = belief
        self._level = level
        self._opening = Opening(
            np.zeros(tracker.size) if opened is None else opened, lasting, rising
        )
        self._belief = belief
        self._cost = 0.0
        self._done = 0

    def to(
        self, readings: Readings, traces: Traces | None = None
    ) -> tuple[Belief, float]:
        """The belief after all readings since the beginning, and their code length; see `Tracker.run`."""
        size = readings.input.size
        opening = self._opening._replace(lasting=self._opening.lasting - self._done)
        self._belief, self._cost = self._tracker.moved_on(
            self._belief,
            self._level,
            readings.part(self._done, size),
            opening,
            traces,
            self._cost,
        )
        self._done = size
        if math.isfinite(self._cost):
            return self._belief, self._cost
        return self._tracker.started_again(self._begin, readings)
