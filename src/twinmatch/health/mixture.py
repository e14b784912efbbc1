"""All that a healthy plant may be: the equations at five sizes of their error, with inputs that act at once,
later or through a lag; and no equations at all, each reading being like the one before.

Switching between them costs nats (Herbster and Warmuth 1998). Forecasts made on the way tell what the
mixture's expectations are worth.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from twinmatch.dynamics import Model, Parameters
from twinmatch.dynamics.bank import BankConstants, BankMembers, weigh
from twinmatch.dynamics.pace import plant_scale, slow_scale
from twinmatch.dynamics.simulation import advance_long, begin, readings
from twinmatch.dynamics.tracker import Assumed
from twinmatch.health.acting_inputs import ActingInputs
from twinmatch.health.mixture_forecasts import RECORD, MixtureForecasts
from twinmatch.settings import Rule
from twinmatch.signals import BoolArray, FloatArray

LEVELS: Final = np.array([0.25, 0.5, 1.0, 2.0, 4.0])
"""Sizes of the equations' error, in units of that of a real rig."""
_CAREFUL: Final = 50.0
"""Time for which the plant must have been seen for the next smaller of the levels to be assumed, s."""
_UNDECLARED: Final = 0.7
"""Standard deviation of the logarithm of a parameter without a typical value in the plant file: a factor of
two. Heater 2 of a kit has 0.4 to 0.8 of the power of heater 1."""
_PRIOR_SHARES: Final = (0.7, 0.28, 0.02)
"""Prior probabilities of the levels together, of the other ways together, and of no equations."""


_EFFECT_SHOWS: Final = 120.0
"""Time within which the effect of a drive shows, s of a plant as fast as the rig."""


class _Switching(Rule):
    """How healthy explanations replace one another."""

    switch: float = 600.0
    """Time in which one healthy explanation gives way to another, s."""
    better: float = 3.0
    """Nats by which inputs must act better in another way for it to be the usual one."""


_SWITCHING: Final = _Switching()


def _numbers_of(model: Model) -> list[str]:
    """Names of the numbers in a belief: states, free parameters, and what may change."""
    drives = range(len(model.rest))
    outputs = range(len(model.noise))
    return [
        *model.states,
        *model.structure.free,
        *(f"share {j}" for j in drives),
        *(f"push {j}" for j in drives),
        *(f"offset {i}" for i in outputs),
        *(f"passing {i}" for i in outputs),
        *(f"fading {i}" for i in outputs),
    ]


def _no_members(healthy: int, numbers: int, outputs: int) -> BankMembers:
    """So many healthy members, with beliefs of so many numbers, and room for forecasts."""
    count = healthy + RECORD.count
    return BankMembers(
        np.zeros((count, numbers)),
        np.zeros((count, numbers, numbers)),
        np.ones(count),
        np.zeros(count, dtype=np.int64),
        np.zeros(count, dtype=bool),
        np.arange(count) < healthy,
        np.zeros((count, outputs)),
        np.zeros((count, outputs)),
        np.zeros((count, outputs)),
    )


class HealthyMixture:
    """Filters of one plant, weighed by its readings."""

    def __init__(self, parameters: Parameters, period: float) -> None:
        """Begin with these parameters; `period` is the sample time, s."""
        self.parameters = parameters
        self.period = period
        model = parameters.model
        self._model = model
        self.scale = slow_scale(model.plant, period)
        self.second = self.scale / period
        """Samples in a second of a plant as fast as the rig."""
        swift = plant_scale(model.plant, period) / period
        names = _numbers_of(model)
        self.numbers = {name: i for i, name in enumerate(names)}
        """Places in a belief."""
        self._shares = [self.numbers[f"share {j}"] for j in range(model.rest.size)]
        """Places of what arrives of each drive."""
        self._passing = [
            place
            for name, place in self.numbers.items()
            if name.startswith(("passing ", "fading "))
        ]
        """Places of what passes by itself."""
        self._n = len(model.states)
        self.fixed = self._constants(Assumed.of(parameters, period))
        self.inputs = ActingInputs(model.rest.size, swift, self.second)
        self.levels = len(LEVELS)
        self.healthy = self.levels + self.inputs.ways
        """Number of members that take readings: the levels, and behind them those whose inputs act in another way.
        Forecasts follow."""
        self.members = _no_members(self.healthy, len(names), len(model.noise))
        self._way = 0
        """The way in which inputs usually act, by place."""
        self._is_new = True
        """Whether no reading has been taken since the beginning."""
        self.known = 0
        """Samples since the beginning."""
        self.best = 0
        """The most probable of the levels."""
        self.forecasts = MixtureForecasts(self.members, self.healthy, self.second)
        self.restart()

    @property
    def drives(self) -> int:
        """Number of drives of the plant."""
        return int(self._model.rest.size)

    def _constants(self, assumed: Assumed) -> BankConstants:
        model = self._model
        numbers = self.numbers
        size = assumed.first.size
        first = np.zeros(len(numbers))
        first[:size] = assumed.first
        drift = np.zeros(len(numbers))
        drift[:size] = assumed.drift
        keeps = np.ones(len(numbers))
        for name, logged in zip(model.structure.free, assumed.free.logged, strict=True):
            if logged and name not in model.plant.typical:
                first[numbers[name]] = _UNDECLARED
        for i in range(len(model.noise)):
            fading = numbers[f"fading {i}"]
            first[fading] = assumed.fading[i]
            drift[fading] = assumed.stray[i]
            keeps[fading] = assumed.keeps[0]
            keeps[numbers[f"passing {i}"]] = assumed.keeps[1]
        self._shown = assumed.shown
        self._first = first
        spans = np.array(
            [output.span[1] - output.span[0] for output in model.plant.outputs.values()]
        )
        return BankConstants(
            assumed.free,
            keeps,
            drift**2 * self.period,
            assumed.swift,
            model.rest.copy(),
            spans,
            float(self.period),
            self.parameters.steps(self.period),
        )

    def restart(self) -> None:
        """Start over after a gap, keeping what was learned about the plant."""
        self.inputs.restart()
        self.forecasts.restart()
        self._begins_again = True
        self.log_weights = np.log(self._prior())

    def _prior(self) -> FloatArray:
        """Prior probabilities of the healthy members, and of no equations; kept as the usual ones."""
        of_levels, of_other_ways, of_no_equations = _PRIOR_SHARES
        prior = np.full(self.healthy + 1, of_other_ways / (self.inputs.ways - 1))
        prior[: self.levels] = of_levels / self.levels
        prior[self.levels + self._way] = 1e-12  # the levels stand for the usual way
        prior[-1] = of_no_equations
        self._usual = np.asarray(prior / prior.sum())
        return self._usual

    def open(self, values: FloatArray, u: FloatArray, row: FloatArray) -> None:
        """Begin, or begin again after a gap, at a reading; set the errors that are assumed."""
        steps_known = self.known // max(1, round(_CAREFUL * self.second))
        least_level = max(self.levels - 1 - steps_known, 0)
        level_of_ways = min(self.best + 1, self.levels - 1)
        errors = self.members.error
        errors[: self.levels] = np.maximum(LEVELS, LEVELS[least_level])
        errors[self.levels : self.healthy] = LEVELS[level_of_ways]
        if not self._begins_again:
            return
        states = begin(self.parameters, values, input=u, disturbances=row)
        for b in range(self.healthy):
            self.members.alive[b] = b != self.levels + self._way
            self.members.way[b] = self._way if b < self.levels else b - self.levels
            self._open_member(b, states)
        self._is_new = False
        self._begins_again = False

    def _open_member(self, b: int, states: FloatArray) -> None:
        """Have a member know nothing, or after a gap nothing of the states and of what passes."""
        n = self._n
        members = self.members
        deviations = self._first.copy()
        deviations[self._passing] *= LEVELS[b] if b < self.levels else 1.0
        if self._is_new:
            members.at[b, :n] = states
            members.covariance[b] = np.diag(deviations**2)
            return
        members.at[b, :n] = np.where(self._shown, states, members.at[b, :n])
        members.at[b, self._passing] = 0.0
        for i in (*range(n), *self._passing):
            members.covariance[b, i, :] = 0.0
            members.covariance[b, :, i] = 0.0
            members.covariance[b, i, i] = deviations[i] ** 2

    @property
    def of_plant(self) -> BoolArray:
        """Which numbers of a belief say how the plant is: its parameters, and what its drives do; shape (N,)."""
        of_sensors = 3 * len(self._model.noise)
        places = np.arange(len(self.numbers))
        return np.asarray(
            (places >= self._n) & (places < len(self.numbers) - of_sensors)
        )

    @property
    def logged(self) -> BoolArray:
        """Which numbers of a belief are logarithms of parameters, shape (N,)."""
        logged = np.zeros(len(self.numbers), dtype=bool)
        free = self.fixed.free.logged
        logged[self._n : self._n + len(free)] = free
        return logged

    def way_back(self, level: int, before: FloatArray) -> FloatArray:
        """What leads from what a level believes now to what was believed before, shape (N,); of logarithms as
        shares."""
        way = before - self.members.at[level]
        return np.asarray(np.where(self.logged, np.expm1(way), way))

    def arriving(self, u: FloatArray) -> FloatArray:
        """What is believed to arrive of inputs, both of shape (m,): of a drive that is lost, nothing."""
        arrives = np.maximum(1.0 + self.members.at[self.best, self._shares], 0.0)
        rest = self._model.rest
        return np.asarray(rest + arrives * (u - rest))

    def effect_of(self, drive: int, belief: FloatArray) -> FloatArray:
        """What a drive does to the outputs within two minutes at its highest command, beside being at rest, by a
        belief, shape (N,); shape (o,). The other drives rest."""
        parameters = self._parameters_of(belief)
        states = self.members.at[self.best, : self._n]
        rest = self._model.rest
        driven = rest.copy()
        limits = list(self._model.plant.drives.values())[drive].limits
        share = 1.0 + belief[self.numbers[f"share {drive}"]]
        driven[drive] += (limits[1] - rest[drive]) * share
        period = _EFFECT_SHOWS * self.scale
        ends = [
            readings(parameters, advance_long(parameters, states, inputs, period))
            for inputs in (driven, rest)
        ]
        return np.asarray(ends[0] - ends[1])

    def farthest_movements(
        self, belief: FloatArray, since: float, lasts: float
    ) -> tuple[FloatArray, FloatArray]:
        """By how much the outputs fall and rise at most while a time `lasts` that ends within a time `since` after
        a belief, shape (N,), whatever the drives do; times in s of a plant as fast as the rig, each of shape (o,).

        What each drive does at its limits is added up.
        """
        usual = self._movements_from(belief, since, lasts, self._model.rest)
        fall = usual.copy()
        rise = usual.copy()
        for j, drive in enumerate(self._model.plant.drives.values()):
            alone = []
            for limit in drive.limits:
                inputs = self._model.rest.copy()
                inputs[j] = limit
                moved = self._movements_from(belief, since, lasts, inputs)
                alone.append(moved - usual)
            fall += np.minimum(0.0, np.minimum(*alone))
            rise += np.maximum(0.0, np.maximum(*alone))
        return fall.min(axis=0), rise.max(axis=0)

    def _movements_from(
        self, belief: FloatArray, since: float, lasts: float, inputs: FloatArray
    ) -> FloatArray:
        """Movements of the outputs under inputs, shape (m,), in each of the times `lasts` after a belief; shape
        (k, o)."""
        parameters = self._parameters_of(belief)
        states = belief[: self._n]
        shown = [readings(parameters, states)]
        for _ in range(math.ceil(since / lasts)):
            states = advance_long(parameters, states, inputs, lasts * self.scale)
            shown.append(readings(parameters, states))
        return np.diff(np.array(shown), axis=0)

    def continue_from(self, member: BankMembers) -> None:
        """Have every healthy member believe what a member believes, and weigh them as at the beginning."""
        for array, believed in (
            (self.members.at, member.at),
            (self.members.covariance, member.covariance),
        ):
            array[: self.healthy] = believed[0]
        self.log_weights = np.log(self._prior())
        self.forecasts.forget()

    def _parameters_of(self, belief: FloatArray) -> Parameters:
        """The parameters of a belief, shape (N,)."""
        values = {}
        for name in self._model.structure.free:
            number = self.numbers[name]
            start = self.parameters[name]
            is_logged = self.logged[number]
            believed = belief[number]
            values[name] = start * math.exp(believed) if is_logged else start + believed
        return self.parameters.replace(**values)

    def weigh(self, walked: float) -> float:
        """Weigh all by a sample, `walked` without equations; its log-probability if the plant is healthy."""
        switch = self.period / (_SWITCHING.switch * self.scale)
        total = weigh(
            self.members.gained,
            self.members.alive,
            self.log_weights,
            self._usual,
            switch,
            walked,
        )
        self.best = int(np.argmax(self.log_weights[: self.levels]))
        return total

    def without(self, output: int, since: int) -> BankMembers:
        """A copy of the most probable filter that ascribes nothing to the sensor of this output; of one that
        has taken no reading since a sample, if there is one."""
        forecast = self.forecasts.newest_before(since)
        b = self.best if forecast is None else forecast
        member = BankMembers(*(array[b : b + 1].copy() for array in self.members))
        member.takes[:] = True
        member.error[:] = self.members.error[self.best]
        for number in (
            self.numbers[f"offset {output}"],
            self.numbers[f"passing {output}"],
        ):
            member.at[0, number] = 0.0
            member.covariance[0, number, :] = 0.0
            member.covariance[0, :, number] = 0.0
        return member

    def choose_way(self) -> bool:
        """Have inputs act in another way from now on if that is clearly better; returns whether they do."""
        log = self.log_weights
        levels = self.levels
        members = self.members
        log_weight_of_usual = float(np.logaddexp.reduce(log[:levels]))
        of_ways = log[levels : self.healthy]
        way = int(np.argmax(of_ways))
        if of_ways[way] <= log_weight_of_usual + _SWITCHING.better:
            return False
        scout = levels + way
        was = levels + self._way
        log_weight_of_better = float(of_ways[way])
        for array in (members.at, members.covariance):
            array[was] = array[self.best]
            array[:levels] = array[scout]
        members.alive[was] = True
        members.alive[scout] = False
        members.way[:levels] = way
        log[was] = log_weight_of_usual
        log[scout] = -50.0
        log[:levels] = log_weight_of_better - math.log(levels)
        self._way = way
        self._prior()
        return True
