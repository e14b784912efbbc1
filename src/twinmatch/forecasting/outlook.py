"""A twin at one sample: its states, estimated beside the plant, and the forecasts that follow from them."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.dynamics import (
    Drive,
    Foresight,
    Law,
    LoopForecast,
    Model,
    Observer,
    ObserverBank,
    Output,
    Parameters,
    Plant,
    PlantError,
)
from twinmatch.dynamics.laws import LOW
from twinmatch.dynamics.pace import usual_scale
from twinmatch.fitting.arx import Visited
from twinmatch.forecasting.forecast import CONFIDENCE, Band, Forecast, ForecastError
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray, Sample, Signals


class _FilterSettings(Rule):
    """How far a twin's states are believed.

    In units of the states' spans, so that it suits a plant of any kind. On the rig a state drifts by 0.03 K
    in a second from what the equations say, and its uncertainty is 4.5 K at the beginning.
    """

    drift: float = 2e-4
    """Least drift of a state from the equations per second, in spans, at a time constant of 100 s."""
    unknown: float = 0.03
    """Initial uncertainty of a state, in units of its span."""
    swift: float = 0.2
    """Error of a forecast movement from sample to sample, as a share of it."""
    limit: float = 4.0
    """Limit on innovations, in standard deviations: jumps of a self-correcting sensor are not the plant's."""


_FILTER: Final = _FilterSettings()


class StateFilter:
    """States of one twin from sample to sample, by an observer on the plant's own equations."""

    def __init__(
        self,
        parameters: Parameters,
        period: float,
        *,
        states: FloatArray | None = None,
        free: Sequence[str] = (),
        covariance: FloatArray | None = None,
    ) -> None:
        """Begin with the next sample.

        Args:
            parameters: parameters of the twin.
            period: sample time, s.
            states: states at the next sample, before its reading; default: the plant file's for its output.
            free: names of the parameters that were matched.
            covariance: covariance of these, shape (len(free), len(free)); default: they are exact.
        """
        self.parameters = parameters
        self.period = period
        self.free = tuple(free) if covariance is not None else ()
        self.covariance = np.zeros((0, 0)) if covariance is None else covariance
        self._states = states
        self._observer: Observer | None = None
        self._inputs: Signals = ()

    def push(self, sample: Sample) -> None:
        """Take one sample, the next one in sequence.

        If the twin's equations have no finite value at the states, the observer is restarted here.
        """
        row = np.array(sample.disturbances) if sample.disturbances else None
        if self._observer is not None:
            self._observer.predict(self._inputs)
            try:
                if sample.seen:
                    self._observer.correct(sample.outputs, row, sample.inputs)
            except PlantError:
                self.restart()
        if self._observer is None:
            self._observer = Observer(
                self.parameters,
                sample.outputs,
                period=self.period,
                drift=drift_of(self.parameters.model),
                start=_FILTER.unknown * _spans_of_states(self.parameters.model),
                input=sample.inputs,
                disturbances=row,
                states=self._states,
                limit=_FILTER.limit,
                adaptive=True,
            )
            self._observer.correct(sample.outputs, row, sample.inputs)
        self._inputs = sample.inputs

    def follow(self, samples: Sequence[Sample]) -> None:
        """Take several samples, the next ones in sequence, each as `push` does."""
        pending = list(samples)
        while pending:
            if self._observer is None or self.parameters.model.is_external:
                self.push(pending.pop(0))
                continue
            [count] = _move_on(ObserverBank([self._observer]), self._inputs, pending)
            self._inputs = pending[count - 1].inputs if count else self._inputs
            del pending[:count]
            if pending:
                self.restart()

    def restart(self) -> None:
        """Forget the states: the next sample does not follow the last one."""
        self._observer = self._states = None

    @property
    def states(self) -> FloatArray:
        """States at the newest sample, corrected by its reading, shape (n,)."""
        return self.observer.states

    @property
    def joint(self) -> FloatArray:
        """Covariance of states and free parameters, assumed independent, shape (n + m, n + m)."""
        state_covariance = self.observer.covariance
        m = len(self.free)
        n = len(state_covariance)
        joint = np.zeros((n + m, n + m))
        joint[:n, :n] = state_covariance
        joint[n:, n:] = self.covariance
        return joint

    @property
    def observer(self) -> Observer:
        """The observer, which has taken a sample."""
        assert self._observer is not None, "a filter needs a first sample"  # noqa: S101
        return self._observer

    @property
    def has_started(self) -> bool:
        """Whether it has taken a sample."""
        return self._observer is not None

    @property
    def inputs(self) -> Signals:
        """Those at the newest sample."""
        return self._inputs

    def take_moved(self, samples: Sequence[Sample], count: int) -> None:
        """Take samples over the first `count` of which the observer has been moved already.

        Where these are not all, its equations had no finite value at the next, and it starts over there.
        """
        self._inputs = samples[-1].inputs
        if count < len(samples):
            self.restart()
            self.follow(samples[count:])


def foresight_of(
    twins: Sequence[tuple[Parameters, Sequence[str]]], law: Law | None, period: float
) -> Foresight:
    """What makes the forecasts of twins; each is given by its parameters and the names of the unsure ones."""
    drift = [drift_of(parameters.model) for parameters, _ in twins]
    return Foresight(twins, law, drift=drift, period=period, swift=_FILTER.swift)


@functools.lru_cache(maxsize=64)  # a backtest asks each candidate again and again
def _foresight_alone(
    parameters: Parameters, unsure: tuple[str, ...], law: Law | None, period: float
) -> Foresight:
    """What makes the forecasts of a twin alone."""
    return foresight_of([(parameters, unsure)], law, period)


@functools.lru_cache(maxsize=64)
def _over_log_time(
    leads: tuple[int, ...], samples: int
) -> tuple[FloatArray, FloatArray]:
    """The logarithms of all samples ahead, shape (samples,), and of the leads; not to be changed."""
    return np.log(np.arange(1, samples + 1)), np.log(np.array(leads, dtype=np.float64))


@functools.cache
def _least_variances(plant: type[Plant]) -> FloatArray:
    """Least variance of each output and input that is forecast, shape (o + m, 1)."""
    least = [0.0] * len(plant.outputs) + [
        (_MIN_NOISE * drive.noise) ** 2 for drive in plant.drives.values()
    ]
    return np.array(least)[:, None]


def deviations(model: Model, variances: FloatArray) -> FloatArray:
    """Standard deviations of outputs and inputs as a twin expects them, shape (..., o + m, N)."""
    return np.asarray(np.sqrt(variances + _least_variances(model.plant)))


@functools.cache
def drift_of(model: Model) -> FloatArray:
    """Standard deviation of the drift of each state from the equations per second, shape (n,); not to be
    changed."""
    return _FILTER.drift * _spans_of_states(model) / math.sqrt(usual_scale(model.plant))


class Followers:
    """The filters of several twins of one plant, moved on over any number of samples by one compiled call."""

    def __init__(self) -> None:
        self._observers: list[Observer] = []
        self._bank: ObserverBank | None = None

    def push(self, filters: Iterable[StateFilter], samples: Sequence[Sample]) -> None:
        """Take samples, the next ones in sequence, in all filters; each as `StateFilter.push` does.

        Raises:
            PlantError: as `StateFilter.push`, for a filter without a sample yet.
        """
        following = []
        for state_filter in filters:
            if state_filter.has_started:
                following.append(state_filter)
            else:
                state_filter.follow(samples)
        if not (following and samples):
            return
        observers = [state_filter.observer for state_filter in following]
        if observers != self._observers or self._bank is None:
            self._observers = observers
            self._bank = ObserverBank(observers)
        counts = _move_on(self._bank, following[0].inputs, samples)
        for state_filter, count in zip(following, counts, strict=True):
            state_filter.take_moved(samples, count)


def _move_on(
    bank: ObserverBank, inputs: Signals, samples: Sequence[Sample]
) -> list[int]:
    """Move a bank on over samples, under these inputs to the first; how many each observer took."""
    inputs_now = [sample.inputs for sample in samples]
    return bank.push(
        [inputs, *inputs_now[:-1]],
        [sample.outputs for sample in samples],
        [sample.seen for sample in samples],
        [sample.disturbances for sample in samples]
        if samples[0].disturbances
        else None,
        inputs_now,
    )


def _spans_of_states(model: Model) -> FloatArray:
    """Width of the span that is declared for each state, shape (n,)."""
    low, high = np.array(
        [state.span for state in model.declared_states], dtype=np.float64
    ).T
    return np.asarray(high - low, dtype=np.float64)


_MIN_NOISE: Final = 0.3
"""Least standard deviation of a future input, in units of its noise: the controller may leave a limit."""
_MARGIN: Final = 3.0
"""Margin around the visited levels that still counts as visited, in the output's noise."""


@dataclass(frozen=True, eq=False)
class Outlook:
    """A twin at one sample, ready to forecast; immutable."""

    sample: Sample
    """The newest sample it knows."""
    candidate: str
    parameters: Parameters
    states: FloatArray
    """States at that sample, corrected by its reading, shape (n,)."""
    covariance: FloatArray
    """Covariance of the states and of the parameters `unsure`, shape (n + m, n + m)."""
    unsure: tuple[str, ...]
    """Names of the parameters that were matched, so that they are not known exactly."""
    controller: FloatArray
    """State of the controller after that sample."""
    law: Law | None
    """The controller; None if the loop is not known: forecasts then take future inputs."""
    period: float
    """Sample time, s."""
    leads: tuple[int, ...]
    """Leads at which the widths are known, samples, shape (L,)."""
    widths: FloatArray
    """Half widths of the band there, in standard deviations, for outputs and, in closed loop, inputs; shape
    (signals, L)."""
    visited: Visited
    """Lowest and highest value of each output so far."""
    notes: tuple[str, ...] = ()
    """Reservations that apply to every forecast made now."""

    @property
    def closed(self) -> bool:
        """Whether forecasts take future set-points; otherwise future inputs."""
        return self.law is not None

    @property
    def standing(self) -> Signals:
        """What stays if nothing is changed: the newest set-points, or inputs if the loop is not known."""
        return self.sample.references if self.closed else self.sample.inputs

    @property
    def signal(self) -> Output | Drive:
        """The plant's only output, or its only drive if the loop is not known, which declares their range."""
        plant = self.parameters.model.plant
        return plant.output if self.closed else plant.drive

    def predicted(
        self,
        ahead: ArrayLike,
        disturbances: ArrayLike | None = None,
        *,
        banded: bool = True,
    ) -> LoopForecast:
        """Mean and, if `banded`, variance of the next N samples under these set-points or inputs, shape (N,)
        or (N, r).

        Disturbances stay constant unless they are given, from the newest sample on, shape (N + 1, d).
        """
        if disturbances is None and self.sample.disturbances:
            disturbances = np.array(self.sample.disturbances)
        twin = (self.parameters, self.unsure)
        foresight = (
            foresight_of([twin], self.law, self.period)
            if self.parameters.model.is_external  # the program that solves its equations may change
            else _foresight_alone(*twin, self.law, self.period)
        )
        loop_state = foresight.at(
            [self.states], [self.covariance], self.sample.inputs, self.controller
        )
        return foresight.ahead(loop_state, ahead, disturbances, banded=banded)

    def forecast(
        self, ahead: ArrayLike, disturbances: ArrayLike | None = None
    ) -> Forecast:
        """Forecast under these set-points, or inputs if the loop is not known, shape (N,) or (N, r), from the
        next sample on; disturbances as in `predicted`.

        Raises:
            ForecastError: there is no value, or one that is not finite.
        """
        values = np.array(ahead, dtype=np.float64)
        if (
            values.ndim not in (1, 2)
            or not values.size
            or not np.isfinite(values).all()
        ):
            signals = "set-points" if self.closed else "inputs"
            msg = f"forecast: the {signals} ahead are not a list of finite numbers; give one for each sample"
            raise ForecastError(msg)
        predicted = self.predicted(values, disturbances)
        size = len(values)
        expected = deviations(self.parameters.model, predicted.variances)[
            : len(self.widths)
        ]
        half = expected * self._widths_ahead(size)
        n_outputs = predicted.outputs.shape[1]
        y = predicted.means[:n_outputs]
        u = predicted.means[n_outputs:]
        output_bands = []
        for mean, half_width in zip(y, half, strict=False):
            output_bands.append(Band(mean, mean - half_width, mean + half_width))
        return Forecast(
            sample=self.sample.index,
            candidate=self.candidate,
            structure=self.parameters.model.structure_name,
            confidence=CONFIDENCE,
            time=np.arange(1, size + 1, dtype=np.float64) * self.period,
            references=values if self.closed else np.full((size, n_outputs), np.nan),
            outputs=tuple(output_bands),
            inputs=self._input_bands(u, half[n_outputs:]),
            notes=self.notes
            + self._assumptions(values, disturbances)
            + self._notes_on_range(y),
        )

    def _assumptions(
        self, ahead: FloatArray, disturbances: ArrayLike | None
    ) -> tuple[str, ...]:
        """Notes on assumptions: given inputs, and constant disturbances."""
        plant = self.parameters.model.plant
        notes = []
        if not self.closed:
            inputs_ahead = "the given inputs"
            if (ahead.reshape(len(ahead), -1) == self.sample.inputs).all():
                drives = zip(self.sample.inputs, plant.drives.values(), strict=True)
                level = " and ".join(
                    f"{u:g} {drive.unit}".rstrip() for u, drive in drives
                )
                inputs_ahead = f"a constant input of {level}"
            notes.append(f"the loop is not known: the forecast is for {inputs_ahead}")
        if self.sample.disturbances and disturbances is None:
            names = " and ".join(
                column.text or column.name for column in plant.disturbances.values()
            )
            notes.append(
                f"the forecast assumes that the measured disturbances ({names}) stay constant"
            )
        return tuple(notes)

    def _input_bands(self, means: FloatArray, halves: FloatArray) -> tuple[Band, ...]:
        """Bands of the controller's commands; given inputs have no uncertainty."""
        if self.law is None:
            return tuple(Band(mean, mean, mean) for mean in means)
        bands = []
        m = len(means)
        lows, highs = self.law.code[LOW : LOW + 2 * m].reshape(2, m)
        drives = list(self.parameters.model.plant.drives.values())
        for k in range(m):
            low = max(float(lows[k]), drives[k].limits[0])
            high = min(float(highs[k]), drives[k].limits[1])
            lower = np.clip(means[k] - halves[k], low, high)
            upper = np.clip(means[k] + halves[k], low, high)
            bands.append(Band(means[k], lower, upper))
        return tuple(bands)

    def _widths_ahead(self, samples: int) -> FloatArray:
        """The widths at every sample ahead, over log time linear between leads; shape (signals, samples)."""
        ahead, knots = _over_log_time(self.leads, samples)
        return np.stack([np.interp(ahead, knots, row) for row in self.widths])

    def _notes_on_range(self, outputs: FloatArray) -> tuple[str, ...]:
        """A note for each output whose forecast leaves the visited range."""
        notes = []
        declared = self.parameters.model.plant.outputs
        for output, values, visited in zip(
            declared.values(), outputs, self.visited, strict=True
        ):
            room = _MARGIN * output.noise
            low, high = visited
            lowest = float(values.min())
            highest = float(values.max())
            if low - room <= lowest and highest <= high + room:
                continue
            of_output = f" of {output.name}" if len(declared) > 1 else ""
            notes.append(
                f"the forecast{of_output} covers {lowest:.4g} to {highest:.4g} {output.unit}, but only "
                f"{low:.4g} to {high:.4g} {output.unit} was visited: beyond that the band may not hold"
            )
        return tuple(notes)
