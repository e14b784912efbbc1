"""Forecasts that the filters of a mixture make on the way, and what they say of its equations.

A forecast is a filter that takes no readings. It is compared with them, with a reading that stays what it is,
and with a linear model without physics.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final, NamedTuple

import numpy as np

from twinmatch.dynamics.bank import BankMembers
from twinmatch.health.faults import HOUR
from twinmatch.health.linear_rival import LinearRival
from twinmatch.settings import Rule
from twinmatch.signals import BoolArray, FloatArray, Sample

AHEAD: Final = (1.0, 5.0, 15.0, 30.0, 60.0, 120.0)
"""How far ahead is forecast, s."""


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


RECORD: Final = _ForecastRecord()


_KEPT: Final = 1.0 - 1.0 / 120.0
"""What a forecast leaves of the record of those before."""


_SHORTEST: Final = 2
"""Place of the shortest forecasts that count: sooner, nothing has moved."""
_SMALL: Final = 3.0
"""Errors up to so many standard deviations of a reading are none."""
_BETWEEN: Final = 3
"""Place of the time ahead after which another forecast begins."""


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
        if scored.ahead < _SHORTEST:
            return
        self._squares = _KEPT * self._squares + scored.squares
        self._standing = _KEPT * self._standing + scored.standing
        self._count = _KEPT * self._count + 1.0

    def knows(self, variance: FloatArray) -> BoolArray:
        """Which outputs are forecast well, where readings have this variance; all, before that is known."""
        if self._count < self._LEAST:
            return np.ones(variance.size, dtype=bool)
        small = _SMALL**2 * variance * self._count
        return np.asarray(
            self._squares <= self._FARTHER**2 * np.maximum(self._standing, small)
        )


class NewestForecasts:
    """Whether a linear model without physics has forecast what the equations missed.

    What changes in a plant, or pushes it, is missed by both. What only the equations miss is theirs.
    """

    _FARTHER: Final = 2.0
    """Times as far that the equations may err; real faults of kits came to 1.9."""
    _LEAST: Final = 3
    """Forecasts that are needed to say so."""

    def __init__(self) -> None:
        """Begin without any forecast."""
        self._scored: deque[ScoredForecast] = deque()

    def take(self, scored: ScoredForecast, reach: int) -> None:
        """Take a forecast, and drop those that were scored more than `reach` samples before it."""
        if scored.ahead >= _SHORTEST:
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
        small = _SMALL**2 * variance
        return np.asarray(
            of_equations > self._FARTHER**2 * np.maximum(of_linear, small)
        )

    def missed(self, since: int, variance: FloatArray) -> BoolArray:
        """Which outputs the equations have missed by more than their readings scatter, in the same forecasts."""
        scored = self._since(since)
        if not scored:
            return np.ones(variance.size, dtype=bool)
        of_equations = np.mean([forecast.squares for forecast in scored], axis=0)
        return np.asarray(of_equations > _SMALL**2 * variance)

    def _since(self, sample: int) -> list[ScoredForecast]:
        return [forecast for forecast in self._scored if forecast.at >= sample]


class MixtureForecasts:
    """The forecasts of one mixture: members of its bank behind those that take readings."""

    def __init__(self, members: BankMembers, healthy: int, second: float) -> None:
        """Begin without any.

        Args:
            members: the bank.
            healthy: number of its members that take readings; behind them is room for `RECORD.count` forecasts.
            second: samples in a second of a plant as fast as the rig.
        """
        outputs = members.expected.shape[1]
        self._members = members
        self._healthy = healthy
        self._second = second
        self._ahead = [max(1, round(ahead * second)) for ahead in AHEAD]
        self._dispersion = np.ones(len(AHEAD))
        self._weights = np.full(len(AHEAD), RECORD.prior)
        self._waiting: deque[ScoredForecast] = deque()
        """Scored ones that do not count yet, oldest first."""
        self._linear = LinearRival(
            RECORD.count, self._ahead[-1], math.exp(-1.0 / (HOUR * second))
        )
        self._begun = [0] * RECORD.count
        """Sample at which each was begun, counted from the last gap."""
        self._values_begun = np.zeros((RECORD.count, outputs))
        """Readings at that sample."""
        self._misses_when_fresh = np.zeros((RECORD.count, outputs))
        """By how much each forecast missed the newest fresh reading of each output, squared and in its
        variance."""
        self.skill = ForecastSkill(outputs)
        self.newest = NewestForecasts()
        self.doubts = np.ones(1)
        """By how much evidence is divided, for each age of a change, samples."""

    def restart(self) -> None:
        """Start over after a gap, keeping what was learned about the equations."""
        self.forget()
        self.newest.clear()

    def forget(self) -> None:
        """End all forecasts; those whose errors do not count yet never will."""
        self._waiting.clear()
        self._begun = [0] * RECORD.count
        self._members.alive[self._healthy :] = False

    def take(self, sample: Sample, values: FloatArray, counts: BoolArray) -> None:
        """Have the linear model without physics take a sample."""
        self._linear.take(sample, values, counts)

    def take_fresh(
        self, values: FloatArray, variance: FloatArray, is_fresh: BoolArray
    ) -> None:
        """Note how forecasts miss the readings, of these variances, that are not repeated ones."""
        expected = self._members.expected[self._healthy :]
        expected_variance = self._members.variance[self._healthy :] + variance
        misses = (values - expected) ** 2 / expected_variance
        self._misses_when_fresh[:, is_fresh] = misses[:, is_fresh]

    def missed(self, since: int, output: int, value: float, variance: float) -> bool:
        """Whether this reading, which is repeated since a sample and has this variance, is far from a forecast
        that was made before.

        A forecast counts for what it was worth when the reading was fresh: the more of its standard
        deviations it was off by then, the farther it has to be off now.
        """
        members = self._members
        expected = members.expected[self._healthy :, output]
        spread = members.variance[self._healthy :, output] + variance
        dispersion = np.maximum(self._misses_when_fresh[:, output], 1.0)
        far = (value - expected) ** 2 > RECORD.far**2 * dispersion * spread
        return bool((far & self._begun_before(since)).any())

    def _begun_before(self, since: int) -> BoolArray:
        """Which forecasts were made before a sample."""
        return np.asarray(
            (np.array(self._begun) < since) & self._members.alive[self._healthy :]
        )

    def newest_before(self, since: int) -> int | None:
        """Place among the members of the newest forecast that was made before a sample; None if there is none."""
        before = np.flatnonzero(self._begun_before(since))
        if not before.size:
            return None
        return int(self._healthy + max(before, key=self._begun.__getitem__))

    def compare(
        self,
        values: FloatArray,
        variance: FloatArray,
        *,
        all_count: bool,
        count: int,
        known: int,
        best: int,
        reach: int,
    ) -> None:
        """Compare forecasts with the readings of a sample, and begin another one.

        Args:
            values: the readings, shape (o,).
            variance: their own variance, shape (o,).
            all_count: whether all readings count; otherwise nothing is compared.
            count: samples since the last gap.
            known: samples since the beginning.
            best: the member from which the next forecast begins.
            reach: highest age of a change, samples.
        """
        free = None
        for k, alive in enumerate(self._members.alive[self._healthy :].tolist()):
            age = count - self._begun[k]
            if alive and age in self._ahead and all_count:
                scored = self._scored(k, age, known, values, variance)
                self._waiting.append(scored)
                self.newest.take(scored, reach)
            if not alive or age >= self._ahead[-1]:
                self._members.alive[self._healthy + k] = False
                free = k
        if count % self._ahead[_BETWEEN] == 0 and free is not None:
            self._begin(free, count, best, values)
        has_news = self._count_those_before(known)
        if has_news or self.doubts.size == 1:
            dispersion = np.maximum.accumulate(np.maximum(self._dispersion, 1.0))
            ages = np.log(np.maximum(np.arange(reach + 3), 1))
            self.doubts = np.interp(ages, np.log(self._ahead), dispersion)

    def _scored(
        self, k: int, age: int, known: int, values: FloatArray, variance: FloatArray
    ) -> ScoredForecast:
        """The errors of the k-th forecast beside those of its rivals."""
        members = self._members
        b = self._healthy + k
        squares = (values - members.expected[b]) ** 2
        in_variances = squares / (members.variance[b] + variance)
        return ScoredForecast(
            at=known,
            ahead=self._ahead.index(age),
            error=float(np.minimum(in_variances, RECORD.most).mean()),
            squares=squares,
            standing=(values - self._values_begun[k]) ** 2,
            linear=(values - self._linear.forecast(k, age)) ** 2,
        )

    def _begin(self, k: int, count: int, best: int, values: FloatArray) -> None:
        """Begin the k-th forecast, from what a member believes at a sample with these readings."""
        members = self._members
        b = self._healthy + k
        for array in (members.at, members.covariance, members.error, members.way):
            array[b] = array[best]
        members.alive[b] = True
        self._begun[k] = count
        self._linear.begin(k)
        self._values_begun[k] = values

    def _count_those_before(self, known: int) -> bool:
        """Count the forecasts that were scored long enough ago; returns whether there were any."""
        seconds_known = RECORD.known * self._second
        late = RECORD.counted * self._second if known > seconds_known else 0.0
        has_news = False
        while self._waiting and known - self._waiting[0].at > late:
            scored = self._waiting.popleft()
            self.skill.take(scored)
            weight = _KEPT * self._weights[scored.ahead]
            sum_of_errors = weight * self._dispersion[scored.ahead] + scored.error
            self._dispersion[scored.ahead] = sum_of_errors / (weight + 1.0)
            self._weights[scored.ahead] = weight + 1.0
            has_news = True
        return has_news
