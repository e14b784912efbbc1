"""All that a healthy plant may be: the equations at five sizes of their error, with inputs that act at once,
later or through a lag; and no equations at all, each reading being like the one before.

Switching between them costs nats (Herbster and Warmuth 1998). Forecasts made on the way tell what the
mixture's expectations are worth.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final, NamedTuple

import numpy as np

from twinmatch.dynamics import Model, Parameters
from twinmatch.dynamics.bank import BankConstants, BankMembers, weigh
from twinmatch.dynamics.pace import plant_scale, slow_scale
from twinmatch.dynamics.simulation import advance_long, begin, readings
from twinmatch.dynamics.tracker import Assumed
from twinmatch.health.faults import HOUR
from twinmatch.health.linear_rival import LinearRival
from twinmatch.settings import Rule
from twinmatch.signals import BoolArray, FloatArray, Sample

LEVELS: Final = np.array([0.25, 0.5, 1.0, 2.0, 4.0])
"""Sizes of the equations' error, in units of that of a real rig."""
_WAYS: Final = ((0.0, 1.0, 2.0, 3.0, 5.0, 8.0, 12.0), (2.0, 5.0, 10.0))
"""Ways in which inputs may act: delays, s, and time constants of lags, s."""
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


AHEAD: Final = (1.0, 5.0, 15.0, 30.0, 60.0, 120.0)
"""How far ahead is forecast, s."""


class _Crossing(Rule):
    """How what one drive does arrives where another one acts, in another way than the equations say."""

    lag: float = 30.0
    """Time constant with which it arrives, s: it passes another body first, as the heat of a heater does."""
    usual: float = 120.0
    """Time over which an input is averaged to know what it has been lately, s: longer than a step of a loop
    lasts."""


CROSSING: Final = _Crossing()


class _ForecastRecord(Rule):
    """How the forecasts of a mixture are scored."""

    count: int = 5
    """Most that wait for their readings at the same time."""
    prior: float = 4.0
    """Number of forecasts as good as expected that are assumed at the beginning."""
    counted: float = 150.0
    """Time after which a forecast counts, s: by then a change that it shows has been found."""
    known: float = 300.0
    """Time for which the plant must have been seen before forecasts wait for so long, s."""
    far: float = 5.0
    """Standard deviations beyond which a forecast was wrong."""
    most: float = 25.0
    """Most that one squared error counts."""


_RECORD: Final = _ForecastRecord()


_KEPT: Final = 1.0 - 1.0 / 120.0
"""What a forecast leaves of the record of those before."""


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
    count = healthy + _RECORD.count
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


class ScoredForecast(NamedTuple):
    """One forecast beside its readings; errors are of each output."""

    at: int
    """Sample at which it was scored, counted from the beginning."""
    ahead: int
    """Place of how far ahead it was made."""
    error: float
    """Mean squared error of all outputs, in their variances."""
    squares: FloatArray
    """Squared errors."""
    standing: FloatArray
    """Those of a reading that had stayed what it was."""
    linear: FloatArray
    """Those of a linear model without physics."""


class ForecastSkill:
    """Whether the equations forecast each output about as well as a reading that stays what it is.

    In a loop that holds its set-points nothing is better than that; equations that err twice as far there
    are not those of this plant.
    """

    _AHEAD: Final = 2
    """Place of the shortest forecasts that count: sooner, nothing has moved."""
    _SMALL: Final = 3.0
    """Errors up to so many standard deviations of a reading are none."""
    _FARTHER: Final = 2.0
    """Times as far that the equations may err."""
    _LEAST: Final = 12.0
    """Number of forecasts from which on it is known: those of a minute and a half."""

    def __init__(self, outputs: int) -> None:
        """Begin without any forecast."""
        self._squares = np.zeros(outputs)
        self._standing = np.zeros(outputs)
        self._count = 0.0

    def take(self, scored: ScoredForecast) -> None:
        """Take a forecast."""
        if scored.ahead < self._AHEAD:
            return
        self._squares = _KEPT * self._squares + scored.squares
        self._standing = _KEPT * self._standing + scored.standing
        self._count = _KEPT * self._count + 1.0

    def knows(self, variance: FloatArray) -> BoolArray:
        """Which outputs are forecast well, where readings have this variance; all, before that is known."""
        if self._count < self._LEAST:
            return np.ones(variance.size, dtype=bool)
        small = self._SMALL**2 * variance * self._count
        return np.asarray(
            self._squares <= self._FARTHER**2 * np.maximum(self._standing, small)
        )


class NewestForecasts:
    """Whether a linear model without physics has forecast what the equations missed.

    What changes in a plant, or pushes it, is missed by both. What only the equations miss is theirs.
    """

    _FARTHER: Final = 2.0
    """Times as far that the equations may err; real faults of kits came to 1.9."""
    _SMALL: Final = 3.0
    """Errors up to so many standard deviations of a reading are none."""
    _LEAST: Final = 3
    """Forecasts that are needed to say so."""
    _AHEAD: Final = 2
    """Place of the shortest forecasts that count: sooner, nothing has moved."""

    def __init__(self) -> None:
        """Begin without any forecast."""
        self._scored: deque[ScoredForecast] = deque()

    def take(self, scored: ScoredForecast, reach: int) -> None:
        """Take a forecast, and drop those that were scored more than `reach` samples before it."""
        if scored.ahead >= self._AHEAD:
            self._scored.append(scored)
        while self._scored and scored.at - self._scored[0].at > reach:
            self._scored.popleft()

    def clear(self) -> None:
        """Forget all, after a gap."""
        self._scored.clear()

    def explained(self, since: int, variance: FloatArray) -> BoolArray:
        """Which outputs the linear model has forecast far better than the equations, in forecasts scored since
        a sample, counted from the beginning; readings have this variance."""
        scored = self._since(since)
        if len(scored) < self._LEAST:
            return np.zeros(variance.size, dtype=bool)
        of_equations = np.mean([forecast.squares for forecast in scored], axis=0)
        of_linear = np.mean([forecast.linear for forecast in scored], axis=0)
        small = self._SMALL**2 * variance
        return np.asarray(
            of_equations > self._FARTHER**2 * np.maximum(of_linear, small)
        )

    def missed(self, since: int, variance: FloatArray) -> BoolArray:
        """Which outputs the equations have missed by more than their readings scatter, in the same forecasts."""
        scored = self._since(since)
        if not scored:
            return np.ones(variance.size, dtype=bool)
        of_equations = np.mean([forecast.squares for forecast in scored], axis=0)
        return np.asarray(of_equations > self._SMALL**2 * variance)

    def _since(self, sample: int) -> list[ScoredForecast]:
        return [forecast for forecast in self._scored if forecast.at >= sample]


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
        self._passing = [
            i
            for name, i in self.numbers.items()
            if name.split()[0] in {"passing", "fading"}
        ]
        self._n = len(model.states)
        self.fixed = self._constants(Assumed.of(parameters, period))
        delays, lags = _WAYS
        self._late = np.array(
            list(dict.fromkeys(round(delay * swift) for delay in delays))
        )
        self.latest = int(self._late.max())
        """Longest delay with which inputs may act, samples."""
        self._ways = len(self._late) + len(lags)
        self._lagging = 1.0 - np.exp(-1.0 / (np.array(lags)[:, np.newaxis] * swift))
        self.levels = len(LEVELS)
        self.healthy = self.levels + self._ways  # after them, forecasts
        self._ahead = [max(1, round(ahead * self.second)) for ahead in AHEAD]
        self.members = _no_members(self.healthy, len(names), len(model.noise))
        self._way = 0  # place of the way in which inputs usually act
        self._fresh = True
        self.known = 0
        """Samples since the beginning."""
        self.best = 0
        """The most probable of the levels."""
        self._dispersion = np.ones(len(AHEAD))
        self._weights = np.full(len(AHEAD), _RECORD.prior)
        self._waiting: deque[ScoredForecast] = deque()
        self.skill = ForecastSkill(len(model.noise))
        self.newest_forecasts = NewestForecasts()
        self._linear = LinearRival(
            _RECORD.count, self._ahead[-1], math.exp(-1.0 / (HOUR * self.second))
        )
        self._values_begun = np.zeros((_RECORD.count, len(model.noise)))
        self._misses_when_fresh = np.zeros((_RECORD.count, len(model.noise)))
        """By how much each forecast missed the newest fresh reading of each output, squared and in its
        variance."""
        self.doubts = np.ones(1)
        """By how much evidence is divided, for each age of a change, samples."""
        self.restart()

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
        self._inputs: FloatArray | None = None  # the newest first
        self.usual_inputs = np.zeros(self._model.rest.size)
        """What each input has been lately, shape (m,)."""
        self.crossing_inputs = np.zeros(self._model.rest.size)
        """What of each input arrives at the places of the other drives, shape (m,)."""
        self._behind = np.zeros((self._lagging.size, self._model.rest.size))
        self.forget_newest()
        self.newest_forecasts.clear()
        self._again = True
        self.log_weights = np.log(self._prior())

    def forget_newest(self) -> None:
        """A fault was found: what was forecast lately does not count."""
        self._waiting.clear()
        self._begun = [0] * _RECORD.count
        self.members.alive[self.healthy :] = False

    def _prior(self) -> FloatArray:
        """Prior probabilities of the healthy members, and of no equations; kept as the usual ones."""
        of_levels, of_other_ways, of_no_equations = _PRIOR_SHARES
        prior = np.full(self.healthy + 1, of_other_ways / (self._ways - 1))
        prior[: self.levels] = of_levels / self.levels
        prior[self.levels + self._way] = 1e-12  # the levels stand for the usual way
        prior[-1] = of_no_equations
        self._usual = np.asarray(prior / prior.sum())
        return self._usual

    def take(self, sample: Sample, values: FloatArray, counts: BoolArray) -> None:
        """Have the linear model without physics take a sample."""
        self._linear.take(sample, values, counts)

    def open(self, values: FloatArray, u: FloatArray, row: FloatArray) -> None:
        """Begin, or begin again after a gap, at a reading; set the errors that are assumed."""
        careful = LEVELS[
            max(self.levels - 1 - self.known // max(1, round(50.0 * self.second)), 0)
        ]
        self.members.error[: self.levels] = np.maximum(LEVELS, careful)
        self.members.error[self.levels : self.healthy] = LEVELS[
            min(self.best + 1, self.levels - 1)
        ]
        if not self._again:
            return
        states = begin(self.parameters, values, input=u, disturbances=row)
        for b in range(self.healthy):
            self.members.alive[b] = b != self.levels + self._way
            self.members.way[b] = self._way if b < self.levels else b - self.levels
            self._open_member(b, states)
        self._fresh = False
        self._again = False

    def _open_member(self, b: int, states: FloatArray) -> None:
        """Have a member know nothing, or after a gap nothing of the states and of what passes."""
        n = self._n
        members = self.members
        deviations = self._first.copy()
        deviations[self._passing] *= LEVELS[b] if b < self.levels else 1.0
        if self._fresh:
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
        self.forget_newest()

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

    def acting(self, u: FloatArray) -> FloatArray:
        """The inputs as they act now, in each way."""
        if self._inputs is None:
            self._behind[:] = u
            self._inputs = np.tile(u, (self._late.max() + 1, 1))
            self.usual_inputs[:] = u
            self.crossing_inputs[:] = u
        self._inputs[1:] = self._inputs[:-1].copy()
        self._inputs[0] = u
        self._behind += (u - self._behind) * self._lagging
        self._average(u)
        return np.vstack([self._inputs[self._late], self._behind])

    def _average(self, u: FloatArray) -> None:
        """Follow what the inputs have been lately, and what arrives at the places of other drives."""
        lag = max(1.0, CROSSING.lag * self.second)
        self.crossing_inputs += (u - self.crossing_inputs) / lag
        recent = max(1.0, CROSSING.usual * self.second)
        self.usual_inputs += (u - self.usual_inputs) / recent

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

    def take_fresh(
        self, values: FloatArray, variance: FloatArray, is_fresh: BoolArray
    ) -> None:
        """Note how forecasts miss the readings, of these variances, that are not repeated ones."""
        expected = self.members.expected[self.healthy :]
        expected_variance = self.members.variance[self.healthy :] + variance
        misses = (values - expected) ** 2 / expected_variance
        self._misses_when_fresh[:, is_fresh] = misses[:, is_fresh]

    def missed(self, since: int, output: int, value: float, variance: float) -> bool:
        """Whether this reading, which is repeated since a sample and has this variance, is far from a forecast
        that was made before.

        A forecast counts for what it was worth when the reading was fresh: the more of its standard
        deviations it was off by then, the farther it has to be off now.
        """
        members = self.members
        expected = members.expected[self.healthy :, output]
        spread = members.variance[self.healthy :, output] + variance
        dispersion = np.maximum(self._misses_when_fresh[:, output], 1.0)
        far = (value - expected) ** 2 > _RECORD.far**2 * dispersion * spread
        return bool((far & self._begun_before(since)).any())

    def _begun_before(self, since: int) -> BoolArray:
        """Which forecasts were made before a sample."""
        return np.asarray(
            (np.array(self._begun) < since) & self.members.alive[self.healthy :]
        )

    def without(self, output: int, since: int) -> BankMembers:
        """A copy of the most probable filter that ascribes nothing to the sensor of this output; of one that
        has taken no reading since a sample, if there is one."""
        before = np.flatnonzero(self._begun_before(since))
        b = (
            self.healthy + max(before, key=self._begun.__getitem__)
            if before.size
            else self.best
        )
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

    def score_forecasts(
        self,
        count: int,
        values: FloatArray,
        counts: BoolArray,
        variance: FloatArray,
        reach: int,
    ) -> None:
        """Compare forecasts with the readings, whose own variance is given, and begin another; `count` are
        the samples since the last gap, and `reach` is the highest age of a change."""
        self._score_and_end(count, values, variance, reach, all_seen=bool(counts.all()))
        late = (
            _RECORD.counted * self.second
            if self.known > _RECORD.known * self.second
            else 0.0
        )
        has_news = False
        while self._waiting and self.known - self._waiting[0].at > late:
            scored = self._waiting.popleft()
            self.skill.take(scored)
            weight = _KEPT * self._weights[scored.ahead]
            dispersion = (weight * self._dispersion[scored.ahead] + scored.error) / (
                weight + 1.0
            )
            self._dispersion[scored.ahead] = dispersion
            self._weights[scored.ahead] = weight + 1.0
            has_news = True
        if has_news or self.doubts.size == 1:
            dispersion = np.maximum.accumulate(np.maximum(self._dispersion, 1.0))
            ages = np.log(np.maximum(np.arange(reach + 3), 1))
            self.doubts = np.interp(ages, np.log(self._ahead), dispersion)

    def _score_and_end(
        self,
        count: int,
        values: FloatArray,
        variance: FloatArray,
        reach: int,
        *,
        all_seen: bool,
    ) -> None:
        """Score the forecasts that are as old as one that is compared, end the oldest, and begin another."""
        members = self.members
        free = -1
        for k, alive in enumerate(members.alive[self.healthy :].tolist()):
            b = self.healthy + k
            age = count - self._begun[k]
            if alive and age in self._ahead and all_seen:
                squares = (values - members.expected[b]) ** 2
                in_variances = np.minimum(
                    squares / (members.variance[b] + variance), _RECORD.most
                )
                standing = (values - self._values_begun[k]) ** 2
                ahead = self._ahead.index(age)
                linear = (values - self._linear.forecast(k, age)) ** 2
                error = float(in_variances.mean())
                scored = ScoredForecast(
                    self.known, ahead, error, squares, standing, linear
                )
                self._waiting.append(scored)
                self.newest_forecasts.take(scored, reach)
            if not alive or age >= self._ahead[-1]:
                members.alive[b] = False
                free = k
        if count % self._ahead[3] == 0 and free >= 0:
            b = self.healthy + free
            for array in (members.at, members.covariance, members.error, members.way):
                array[b] = array[self.best]
            members.alive[b] = True
            self._begun[free] = count
            self._linear.begin(free)
            self._values_begun[free] = values

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
