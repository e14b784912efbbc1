"""All that a healthy plant may be: the equations at five sizes of their error, with inputs that act at once,
later or through a lag; and no equations at all, each reading being like the one before.

Switching between them costs nats (Herbster and Warmuth 1998). Forecasts made on the way tell what the
mixture's expectations are worth.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final

import numpy as np

from twinmatch.dynamics import Parameters
from twinmatch.dynamics.bank import BankConstants, BankMembers, weigh
from twinmatch.dynamics.pace import plant_scale, slow_scale
from twinmatch.dynamics.simulation import begin
from twinmatch.dynamics.tracker import Assumed
from twinmatch.signals import BoolArray, FloatArray

LEVELS: Final = np.array([0.25, 0.5, 1.0, 2.0, 4.0])
"""Sizes of the equations' error, in units of that of a real rig."""
_WAYS: Final = ((0.0, 1.0, 2.0, 3.0, 5.0, 8.0, 12.0), (2.0, 5.0, 10.0))
"""By how much later inputs may act, and lags behind which they may, s."""
_UNSAID: Final = 0.7
"""Standard deviation of the logarithm of a parameter without a typical value in the plant file: a factor of
two. Heater 2 of a kit has 0.4 to 0.8 of the power of heater 1."""
_SHARES: Final = (0.7, 0.28, 0.02)
"""Prior of the levels, of other ways, and of no equations."""
_SWITCH: Final = 600.0
"""Time in which one healthy explanation gives way to another, s."""
_BETTER: Final = 3.0
"""Nats by which inputs must act better in another way for it to be the usual one."""
AHEAD: Final = (1.0, 5.0, 15.0, 30.0, 60.0, 120.0)
"""How far ahead is forecast, s."""
_FORECASTS: Final = 5
_KEPT: Final = 1.0 - 1.0 / 120.0
"""What a forecast leaves of the record of those before."""
_PRIOR: Final = 4.0
"""Number of forecasts as good as expected that are assumed at the beginning."""
_COUNTED: Final = 150.0
"""Time after which a forecast counts: by then a change that it shows has been found, s …"""
_KNOWN: Final = 300.0
"""… once so much has been seen of the plant, s."""
_FAR: Final = 5.0
"""Standard deviations beyond which a forecast was wrong."""
_MOST: Final = 25.0
"""Most that one squared error counts."""


class HealthyMixture:
    """Filters of one plant, weighed by its readings."""

    def __init__(self, parameters: Parameters, period: float) -> None:
        """Begin with these parameters; `period` is the sample time, s."""
        self.parameters = parameters
        self.period = period
        model = self._model = parameters.model
        self.scale = slow_scale(model.plant, period)
        self.second = self.scale / period
        """Samples in a second of a plant as fast as the rig."""
        swift = plant_scale(model.plant, period) / period
        m = len(model.rest)
        o = len(model.noise)
        names = [*model.states, *model.structure.free]
        for name, count in (("share", m), ("push", m), ("offset", o), ("passing", o), ("fading", o)):
            names += [f"{name} {i}" for i in range(count)]
        self.numbers = {name: i for i, name in enumerate(names)}
        """Places in a belief."""
        self._passing = [i for name, i in self.numbers.items() if name.split()[0] in {"passing", "fading"}]
        self._n = len(model.states)
        self.fixed = self._constants(Assumed.of(parameters, period))
        delays, lags = _WAYS
        late = list(dict.fromkeys(round(delay * swift) for delay in delays))
        self._late = np.array(late)
        self._ways = len(late) + len(lags)
        self._lagging = 1.0 - np.exp(-1.0 / (np.array(lags)[:, np.newaxis] * swift))
        self.levels = len(LEVELS)
        self.healthy = self.levels + self._ways  # after them, forecasts
        self._ahead = [max(1, round(ahead * self.second)) for ahead in AHEAD]
        count = self.healthy + _FORECASTS
        size = len(names)
        self.members = BankMembers(
            np.zeros((count, size)), np.zeros((count, size, size)), np.ones(count),
            np.zeros(count, dtype=np.int64), np.zeros(count, dtype=bool), np.arange(count) < self.healthy,
            *(np.zeros((count, o)) for _ in range(3)),
        )  # fmt: skip
        self._way = 0
        self._fresh = True
        self.known = 0
        """Samples since the beginning."""
        self.best = 0
        """The most probable of the levels."""
        self._dispersion = np.ones(len(AHEAD))
        self._weights = np.full(len(AHEAD), _PRIOR)
        self._waiting: deque[tuple[int, int, float]] = deque()
        self.doubts = np.ones(1)
        """By how much evidence is divided, for each age of a change, samples."""
        self.restart()

    def _constants(self, assumed: Assumed) -> BankConstants:
        model = self._model
        period = self.period
        numbers = self.numbers
        known, first, drift, keeps = assumed.first.size, *np.zeros((2, len(numbers))), np.ones(len(numbers))
        first[:known], drift[:known], self._shown = assumed.first, assumed.drift, assumed.shown
        for name, logged in zip(model.structure.free, assumed.free.logged, strict=True):
            if logged and name not in model.plant.typical:
                first[numbers[name]] = _UNSAID
        for i, (spread, stray) in enumerate(zip(assumed.fading, assumed.stray, strict=True)):
            fading = numbers[f"fading {i}"]
            first[fading], drift[fading] = spread, stray
            keeps[fading], keeps[numbers[f"passing {i}"]] = assumed.keeps
        self._first = first
        spans = np.array([output.span[1] - output.span[0] for output in model.plant.outputs.values()])
        return BankConstants(
            assumed.free, keeps, drift**2 * period, assumed.swift, model.rest.copy(), spans, float(period),
            self.parameters.steps(period),
        )  # fmt: skip

    def restart(self) -> None:
        """Start over after a gap, keeping what was learned about the plant."""
        self._inputs: FloatArray | None = None  # the newest first
        self._behind = np.zeros((self._lagging.size, self._model.rest.size))
        self.forget_newest()
        self._again = True
        self.log_weights = np.log(self._prior())

    def forget_newest(self) -> None:
        """A fault was found: what was forecast lately does not count."""
        self._waiting.clear()
        self._begun = [0] * _FORECASTS
        self.members.alive[self.healthy :] = False

    def _prior(self) -> FloatArray:
        """Of the healthy ones, and of no equations."""
        prior = np.full(self.healthy + 1, _SHARES[1] / (self._ways - 1))
        prior[: self.levels] = _SHARES[0] / self.levels
        prior[self.levels + self._way], prior[-1] = 1e-12, _SHARES[2]
        self._usual = np.asarray(prior / prior.sum())
        return self._usual

    def open(self, values: FloatArray, u: FloatArray, row: FloatArray) -> None:
        """Begin, or begin again after a gap, at a reading; set the errors that are assumed."""
        careful = LEVELS[max(self.levels - 1 - self.known // max(1, round(50.0 * self.second)), 0)]
        self.members.error[: self.levels] = np.maximum(LEVELS, careful)
        self.members.error[self.levels : self.healthy] = LEVELS[min(self.best + 1, self.levels - 1)]
        if not self._again:
            return
        n = self._n
        members = self.members
        states = begin(self.parameters, values, input=u, disturbances=row)
        for b in range(self.healthy):
            first = self._first.copy()
            members.alive[b] = b != self.levels + self._way
            members.way[b] = self._way if b < self.levels else b - self.levels
            first[self._passing] *= LEVELS[b] if b < self.levels else 1.0
            if self._fresh:
                members.at[b, :n], members.covariance[b] = states, np.diag(first**2)
                continue
            members.at[b, :n] = np.where(self._shown, states, members.at[b, :n])
            members.at[b, self._passing] = 0.0
            for i in (*range(n), *self._passing):
                members.covariance[b, i, :] = members.covariance[b, :, i] = 0.0
                members.covariance[b, i, i] = first[i] ** 2
        self._fresh = self._again = False

    def acting(self, u: FloatArray) -> FloatArray:
        """The inputs as they act now, in each way."""
        if self._inputs is None:
            self._behind[:], self._inputs = u, np.tile(u, (self._late.max() + 1, 1))
        self._inputs[1:] = self._inputs[:-1].copy()
        self._inputs[0] = u
        self._behind += (u - self._behind) * self._lagging
        return np.vstack([self._inputs[self._late], self._behind])

    def weigh(self, walked: float) -> float:
        """Weigh all by a sample, `walked` without equations; its log-probability if the plant is healthy."""
        switch = self.period / (_SWITCH * self.scale)
        total = weigh(self.members.gained, self.members.alive, self.log_weights, self._usual, switch, walked)
        self.best = int(np.argmax(self.log_weights[: self.levels]))
        return total

    def missed(self, since: int, output: int, value: float, variance: float) -> bool:
        """Whether this reading, of this variance, is far from a forecast that was made before a sample."""
        members = self.members
        expected, spread = (one[self.healthy :, output] for one in (members.expected, members.variance))
        far = (value - expected) ** 2 > _FAR**2 * (spread + variance)
        return bool((far & self._begun_before(since)).any())

    def _begun_before(self, since: int) -> BoolArray:
        """Which forecasts were made before a sample."""
        return np.asarray((np.array(self._begun) < since) & self.members.alive[self.healthy :])

    def without(self, output: int, since: int) -> BankMembers:
        """A copy of the most probable filter that ascribes nothing to the sensor of this output; of one that
        has taken no reading since a sample, if there is one."""
        before = np.flatnonzero(self._begun_before(since))
        b = self.healthy + max(before, key=self._begun.__getitem__) if before.size else self.best
        one = BankMembers(*(array[b : b + 1].copy() for array in self.members))
        one.takes[:], one.error[:] = True, self.members.error[self.best]
        for own in (self.numbers[f"offset {output}"], self.numbers[f"passing {output}"]):
            one.at[0, own] = one.covariance[0, own, :] = one.covariance[0, :, own] = 0.0
        return one

    def score_forecasts(
        self, count: int, values: FloatArray, seen: BoolArray, variance: FloatArray, reach: int
    ) -> None:
        """Compare forecasts with the readings, whose own variance is given, and begin another; `count` are
        the samples since the last gap, and `reach` is the highest age of a change."""
        members = self.members
        free = -1
        all_seen = bool(seen.all())
        for k, alive in enumerate(members.alive[self.healthy :].tolist()):
            b = self.healthy + k
            age = count - self._begun[k]
            if alive and age in self._ahead and all_seen:
                squares = (values - members.expected[b]) ** 2 / (members.variance[b] + variance)
                squares = np.minimum(squares, _MOST)
                self._waiting.append((self.known, self._ahead.index(age), float(squares.mean())))
            if not alive or age >= self._ahead[-1]:
                members.alive[b] = False
                free = k
        if count % self._ahead[3] == 0 and free >= 0:
            b = self.healthy + free
            for one in (members.at, members.covariance, members.error, members.way):
                one[b] = one[self.best]
            members.alive[b] = True
            self._begun[free] = count
        late = _COUNTED * self.second if self.known > _KNOWN * self.second else 0.0
        counted = self.known
        while self._waiting and self.known - self._waiting[0][0] > late:
            counted, k, error = self._waiting.popleft()
            weight = _KEPT * self._weights[k]
            self._dispersion[k] = (weight * self._dispersion[k] + error) / (weight + 1.0)
            self._weights[k] = weight + 1.0
        if counted != self.known or self.doubts.size == 1:
            off = np.maximum.accumulate(np.maximum(self._dispersion, 1.0))
            ages = np.log(np.maximum(np.arange(reach + 3), 1))
            self.doubts = np.interp(ages, np.log(self._ahead), off)

    def choose_way(self) -> bool:
        """Have inputs act in another way from now on, if that is clearly better; whether it is."""
        log = self.log_weights
        levels = self.levels
        members = self.members
        mine = float(np.logaddexp.reduce(log[:levels]))
        others = log[levels : self.healthy]
        way = int(np.argmax(others))
        if others[way] <= mine + _BETTER:
            return False
        scout = levels + way
        was = levels + self._way
        better = float(others[way])
        for one in (members.at, members.covariance):
            one[was] = one[self.best]
            one[:levels] = one[scout]
        members.alive[was], members.alive[scout], members.way[:levels] = True, False, way
        self._way, log[was], log[scout], log[:levels] = way, mine, -50.0, better - math.log(levels)
        self._prior()
        return True
