"""The competition: what the readings say for every change, beyond its price, against all that is healthy.

Healthy is a mixture: the equations at five sizes of their error, with inputs that act at once, later or
through a lag; and no equations at all, each reading being like the one before. Switching between them costs
nats (Herbster and Warmuth 1998). A change begins again every two seconds at each of the five; what it saves
of the code of the readings since is its evidence.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmarks.bank.hypotheses import Cause, Kind, Row, rows_of
from benchmarks.bank.kernels import JUNK, Fixed, Members, Onsets, Readings, Rows, Traces, spawn, step
from twinmatch.dynamics import Parameters
from twinmatch.dynamics.pace import plant_scale, slow_scale
from twinmatch.dynamics.simulation import begin
from twinmatch.signals import FloatArray, Sample

LEVELS: Final = np.array([0.25, 0.5, 1.0, 2.0, 4.0])
"""Sizes of the equations' error, in units of that of a real rig."""
_ERROR: Final = (0.6, 0.001, 5e-4, 0.2, 0.15)
"""That of a real rig: drift of a state that an output shows, in noises, and of another, in scales, per root
of a sample; of a parameter, in scales, per root of a second; the fading push, in noises per sample; the error
of a movement, as a share of it."""
_FADES: Final = (100.0, 14.0)
"""Time constants of the fading push and of a passing offset, s."""
_SPREADS: Final = (0.6, 0.5, 3.0, 0.5)
"""Of what is not known at the beginning: logarithm of a parameter; another, in scales; a state that an output
shows, in noises; another, in scales."""
_WAYS: Final = ((0.0, 1.0, 2.0, 3.0, 5.0, 8.0, 12.0), (2.0, 5.0, 10.0))
"""By how much later inputs may act, and lags behind which they may, s."""
_SHARES: Final = (0.7, 0.28, 0.02)
"""Prior of the levels, of other ways, and of no equations."""
_SWITCH: Final = 600.0
"""Time in which one healthy explanation gives way to another, s."""
_BETTER: Final = 3.0
"""Nats by which inputs must act better in another way for it to be the usual one."""
EVERY: Final = 2.0
"""Time between two onsets, s."""
_SLOTS: Final = 6
"""Onsets of every change that are followed in each member."""
_REACH: Final = 480.0
"""Age after which an onset is forgotten, s."""
HOUR: Final = 3600.0
_AHEAD: Final = (1.0, 5.0, 15.0, 30.0, 60.0, 120.0)
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
_MOST: Final = 25.0
"""Most that one squared error counts."""
_INTERESTING: Final = -6.0
"""Evidence below which a cause is not looked at, nats."""
_SECOND: Final = 1.954
"""Mean size of the second difference of white noise, in its standard deviation."""
_STANDS: Final = math.log(1.0 - 1e-4)
"""Log-probability with which a frozen sensor repeats its reading."""


@dataclass(frozen=True)
class Found:
    """What is said of one cause."""

    cause: Cause
    evidence: float
    """Nats beyond its price."""
    row: Row
    shift: float
    """Believed size of the change, in the number's unit."""
    born: int
    """Samples since the last gap when it began."""
    hypothesis: int
    """Its place among the traces; −1: it has none."""


class Bank:
    """All hypotheses about one plant; push every sample."""

    def __init__(self, parameters: Parameters, period: float) -> None:
        """Begin with these parameters in the tracked structure; `period` is the sample time, s."""
        self.parameters, self.period = parameters, period
        model = self._model = parameters.model
        self.scale = slow_scale(model.plant, period)
        self.second = self.scale / period
        """Samples in a second of a plant as fast as the rig."""
        swift = plant_scale(model.plant, period) / period
        m, o = len(model.rest), len(model.noise)
        names = [*model.states, *model.structure.free]
        for name, count in (("share", m), ("push", m), ("offset", o), ("passing", o), ("fading", o)):
            names += [f"{name} {i}" for i in range(count)]
        self.numbers = {name: i for i, name in enumerate(names)}
        self._n = len(model.states)
        self._fixed, self._first = self._constants()
        delays, lags = _WAYS
        self._ways = [(late, 0.0) for late in dict.fromkeys(round(delay * swift) for delay in delays)]
        self._ways += [(0, lag * swift) for lag in lags]
        self._levels = len(LEVELS)
        self._healthy = self._levels + len(self._ways)  # after them, forecasts
        self._ahead = [max(1, round(ahead * self.second)) for ahead in _AHEAD]
        self.noise = model.noise.copy()
        self._rough = model.noise * _SECOND
        self.steps = 0.1 * model.noise  # of the last digits
        self._smallest, self.moves = np.full(o, np.inf), np.zeros(o, dtype=int)
        self._pauses = np.tile(np.array([[1.0, 50.0], [2.0, 4.0]]), (o, 1, 1))
        self._usual, self._back = rows_of(model), list[Row]()
        self._start()

    def _constants(self) -> tuple[Fixed, FloatArray]:
        parameters, numbers, period = self.parameters, self.numbers, self.period
        model, free = parameters.model, parameters.model.structure.free
        declared, kernels, n, o = model.declared, model.kernels, self._n, len(model.noise)
        values = np.array([parameters[name] for name in free])
        logged = np.array(
            [declared[k].relative and parameters[k] > 0 and math.isinf(declared[k].most) for k in free], bool
        )
        scales = np.where(logged, 1.0, [declared[k].scale for k in free])
        bounds = np.array([declared[k].bounds for k in free]).reshape(-1, 2)
        width = bounds[:, 1] - bounds[:, 0]
        with np.errstate(invalid="ignore", divide="ignore"):
            floor = np.log(np.maximum(bounds[:, 0], 0.1 * values) / values)
            least = np.where(logged, floor, bounds[:, 0] - width - values)
            most = np.where(logged, np.log(bounds[:, 1] / values), bounds[:, 1] + width - values)
        slopes = kernels.slopes_at(
            parameters.vector, begin(parameters, np.zeros(o)), model.rest, model.disturbances
        )[4]
        shown = [
            [noise / abs(by) for noise, by in zip(model.noise, column, strict=True) if by]
            for column in slopes.T
        ]
        seen = np.array([min(sizes, default=0.0) for sizes in shown])
        states = np.array([state.scale for state in model.declared_states])
        self._shown = seen > 0
        first, drift, keeps = np.zeros(len(numbers)), np.zeros(len(numbers)), np.ones(len(numbers))
        first[:n] = np.where(self._shown, _SPREADS[2] * seen, _SPREADS[3] * states)
        first[n : n + len(free)] = np.where(logged, _SPREADS[0], _SPREADS[1] * scales)
        drift[:n] = np.where(self._shown, _ERROR[0] * seen, _ERROR[1] * states) / math.sqrt(period)
        drift[n : n + len(free)] = _ERROR[2] * scales / math.sqrt(self.scale)
        push_time, offset_time = (time * self.scale for time in _FADES)
        for i, noise in enumerate(model.noise.tolist()):
            fading = numbers[f"fading {i}"]
            first[fading] = _ERROR[3] * noise / period
            drift[fading] = first[fading] * math.sqrt(2.0 / push_time)
            keeps[fading] = math.exp(-period / push_time)
            keeps[numbers[f"passing {i}"]] = math.exp(-period / offset_time)
        spans = np.array([output.span[1] - output.span[0] for output in model.plant.outputs.values()])
        fixed = Fixed(
            parameters.vector.copy(), np.array([kernels.PARAMETERS.index(k) for k in free], dtype=np.int64),
            np.array([kernels.UNKNOWN.index(k) for k in free], dtype=np.int64), logged, least, most, keeps,
            drift**2 * period, _ERROR[4], model.rest.copy(), spans, float(period), parameters.steps(period),
        )  # fmt: skip
        return fixed, first

    def _start(self) -> None:
        """Begin with an unknown plant."""
        size, count, o = len(self.numbers), self._healthy + _FORECASTS, len(self._model.noise)
        self.members = Members(
            np.zeros((count, size)), np.zeros((count, size, size)), np.ones(count),
            np.zeros(count, dtype=np.int64), np.zeros(count, dtype=bool), np.arange(count) < self._healthy,
            *(np.zeros((count, o)) for _ in range(3)),
        )  # fmt: skip
        self._way, self._fresh = 0, True
        self.known = 0
        """Samples since the beginning."""
        self._dispersion = np.ones(len(_AHEAD))
        self._weights = np.full(len(_AHEAD), _PRIOR)
        self._waiting: deque[tuple[int, int, float]] = deque()
        self._walk = 2.0 * self._model.noise
        self._suspected = False
        self.best = 0
        """The most probable of the levels."""
        self._allocate()
        self.gap()

    def _allocate(self) -> None:
        """Make the table of changes, and room for their traces."""
        self._rows = rows = [*self._usual, *self._back]
        count, size = len(rows) * self._levels * _SLOTS, len(self.numbers)
        free, of = np.full(count, -1, dtype=np.int64), np.zeros(count, dtype=np.int64)
        self.traces = Traces(
            free, of, of.copy(), np.zeros((count, size)), *(np.zeros(count) for _ in range(6))
        )
        spread = np.array([row.spread for row in rows])
        lasting = np.array([round(row.lasting * self.second) for row in rows], dtype=np.int64)
        wanders = np.array([row.wanders for row in rows])
        self._table = Rows(
            np.array([self.numbers[row.number] for row in rows], dtype=np.int64),
            np.array([self.period / (row.slowly * self.scale) if row.slowly else 0.0 for row in rows]),
            wanders**2 * 2.0 * self.period / (30.0 * self.scale),
            np.where(lasting > 0, 0.5 * spread**2 / np.maximum(lasting, 1), 0.0), lasting,
        )  # fmt: skip
        self.causes = list(dict.fromkeys(row.cause for row in rows))
        per = {cause: sum(math.exp(-r.price) for r in rows if r.cause == cause) for cause in self.causes}
        once = len(self.causes) * HOUR / EVERY
        self._onsets = Onsets(
            np.array([row.shift for row in rows]), np.where(lasting > 0, math.sqrt(0.5), 1.0) * spread,
            np.array([math.exp(-row.price) / per[row.cause] / once for row in rows]),
            np.array([row.cause[0] is Kind.LOST and row.shift == -1.0 for row in rows]),
        )  # fmt: skip
        self._cause_of = np.array([self.causes.index(row.cause) for row in rows])

    def gap(self) -> None:
        """Start over after a gap, keeping what was learned about the plant."""
        o = len(self._model.noise)
        self.count = 0
        """Samples since."""
        self._last: list[FloatArray] = []
        self._inputs: deque[FloatArray] = deque(maxlen=max(late for late, _ in self._ways) + 1)
        self._behind = np.zeros((len(self._ways), self._model.rest.size))
        self._repeated = np.zeros(o, dtype=bool)
        self.repeats, self._frozen = np.zeros(o, dtype=int), np.zeros(o)
        """Of the newest readings."""
        self.clear()
        self.forget_newest()
        self._again = not self._fresh
        self._log_weights = np.log(self._prior())

    def clear(self) -> None:
        """Changes begin from now on only."""
        self.traces.of[:] = -1

    def forget_newest(self) -> None:
        """A fault was found: what was forecast lately does not count."""
        self._waiting.clear()
        self._begun = [0] * _FORECASTS
        self.members.alive[self._healthy :] = False

    def _prior(self) -> FloatArray:
        """Of the healthy ones, and of no equations."""
        prior = np.full(self._healthy + 1, _SHARES[1] / (len(self._ways) - 1))
        prior[: self._levels] = _SHARES[0] / self._levels
        prior[self._levels + self._way], prior[-1] = 1e-12, _SHARES[2]
        return prior / prior.sum()

    # --- a sample ---

    def push(self, sample: Sample, values: FloatArray, seen: FloatArray) -> None:
        """Take the readings of a sample, and which of them count."""
        row, u = self._model.disturbance_row(sample.disturbances or None), np.array(sample.inputs)
        if self._fresh or self._again:
            self._open(values, u, row)
        before = self._last[-1] if self._last else np.full(values.size, np.nan)
        repeated = (values == before) & seen
        state = self._repeated.astype(int)
        paused, of = self._pauses[np.arange(values.size), state].T
        careful = LEVELS[max(self._levels - 1 - self.known // max(1, round(50.0 * self.second)), 0)]
        self.members.error[: self._levels] = np.maximum(LEVELS, careful)
        self.members.error[self._levels : self._healthy] = LEVELS[min(self.best + 1, self._levels - 1)]
        given = Readings(values, seen, repeated, self.noise, self.steps, paused / of, self._acting(u), row)
        step(self._model.kernels.code, self._fixed, self.members, self.traces, self._table, given, self.count)
        self._weigh(values, before, given)
        self._count_repeats(given)
        self._score_forecasts(values, seen)
        self._learn_sensor(given, state)
        self._repeated, self._last = repeated, [*self._last[-1:], np.where(seen, values, np.nan)]
        self.count += 1
        self.known += 1
        if self.count % max(1, round(EVERY * self.second)) == 0:
            old = (self.traces.of >= 0) & (self.count - self.traces.born > _REACH * self.second)
            self.traces.of[old] = -1
            weights = self._log_weights[: self._levels]
            spawn(self.traces, self._table, self._onsets, self.members.at, weights, _SLOTS, self.count)
            self._choose_way()

    def _open(self, values: FloatArray, u: FloatArray, row: FloatArray) -> None:
        """Begin, or begin again after a gap, at a reading."""
        n, members = self._n, self.members
        states = begin(self.parameters, values, input=u, disturbances=row)
        passing = [i for name, i in self.numbers.items() if name.split()[0] in {"passing", "fading"}]
        for b in range(self._healthy):
            first = self._first.copy()
            members.alive[b] = b != self._levels + self._way
            members.way[b] = self._way if b < self._levels else b - self._levels
            for i in passing:
                first[i] *= LEVELS[b] if b < self._levels else 1.0
            if self._fresh:
                members.at[b, :n], members.covariance[b] = states, np.diag(first**2)
                continue
            members.at[b, :n] = np.where(self._shown, states, members.at[b, :n])
            members.at[b, passing] = 0.0
            for i in (*range(n), *passing):
                members.covariance[b, i, :] = members.covariance[b, :, i] = 0.0
                members.covariance[b, i, i] = first[i] ** 2
        self._fresh = self._again = False

    def _acting(self, u: FloatArray) -> FloatArray:
        """The inputs as they act now, in each way."""
        if not self._inputs:
            self._behind[:] = u
        self._inputs.append(u)
        for w, (late, lag) in enumerate(self._ways):
            if lag:
                self._behind[w] += (u - self._behind[w]) * (1.0 - math.exp(-1.0 / lag))
            else:
                self._behind[w] = self._inputs[max(0, len(self._inputs) - 1 - late)]
        return self._behind

    def _weigh(self, values: FloatArray, before: FloatArray, given: Readings) -> None:
        """Weigh the healthy ones by the readings, and every change against all of them."""
        members, traces = self.members, self.traces
        gained = np.where(members.alive, members.gained.sum(axis=1), -np.inf)[: self._healthy]
        joint = self._log_weights + np.append(gained, self._walked(values, before, given))
        total = float(np.logaddexp.reduce(joint))
        switch = self.period / (_SWITCH * self.scale)
        self._log_weights = np.log((1.0 - switch) * np.exp(joint - total) + switch * self._prior())
        self.best = int(np.argmax(self._log_weights[: self._levels]))
        used = traces.of >= 0
        off = np.maximum.accumulate(np.maximum(self._dispersion, 1.0))
        ages = np.log(np.maximum(self.count - traces.born[used], 1))
        traces.score[used] += (traces.now[used] - total) / np.interp(ages, np.log(self._ahead), off)

    def _walked(self, values: FloatArray, before: FloatArray, given: Readings) -> float:
        """Log-probability of the readings without equations: each is like the one before."""
        total = 0.0
        for i in range(values.size):
            if given.repeated[i]:  # that says nothing of a display with coarse steps
                total += self.members.gained[self.best, i]
            elif given.seen[i] and not math.isnan(before[i]):
                off, spread, digit = values[i] - before[i], self._walk[i], self.steps[i]
                near, far = (_between(off, digit, by * spread) for by in (1.0, 3.0))
                junk = JUNK * min(digit / self._fixed.spans[i], 1.0)
                total += math.log((1.0 - given.pauses[i]) * (0.95 * near + 0.05 * far) + junk)
                moved = min(max(abs(off), 0.3 * self.noise[i]), 4.0 * spread)
                self._walk[i] += (1.2 * moved - spread) / (30.0 * self.second)
        return total

    def _count_repeats(self, given: Readings) -> None:
        """What repeats of each reading say for a sensor that is frozen."""
        gained = self.members.gained[self.best]
        self.repeats = np.where(given.repeated, self.repeats + 1, np.where(given.seen, 0, self.repeats))
        fresh = np.where(given.seen, 0.0, self._frozen)
        self._frozen = np.where(given.repeated, self._frozen + _STANDS - gained, fresh)

    def _score_forecasts(self, values: FloatArray, seen: FloatArray) -> None:
        """Compare forecasts with the readings, and begin another."""
        members, free = self.members, -1
        for k, b in enumerate(range(self._healthy, members.alive.size)):
            age = self.count - self._begun[k]
            if members.alive[b] and age in self._ahead and seen.all():
                variance = members.variance[b] + self.noise**2 + self.steps**2 / 12.0
                error = np.minimum((values - members.expected[b]) ** 2 / variance, _MOST)
                self._waiting.append((self.known, self._ahead.index(age), float(error.mean())))
            members.alive[b] &= age < self._ahead[-1]
            free = free if members.alive[b] else k
        if self.count % self._ahead[3] == 0 and free >= 0:
            b = self._healthy + free
            for one in (members.at, members.covariance, members.error, members.way):
                one[b] = one[self.best]
            members.alive[b], self._begun[free] = True, self.count
        late = _COUNTED * self.second if self.known > _KNOWN * self.second else 0.0
        while self._waiting and self.known - self._waiting[0][0] > late:
            _, k, error_ = self._waiting.popleft()
            weight = _KEPT * self._weights[k]
            self._dispersion[k] = (weight * self._dispersion[k] + error_) / (weight + 1.0)
            self._weights[k] = weight + 1.0

    def _learn_sensor(self, given: Readings, state: FloatArray) -> None:
        """Learn noise, last digit and pauses of the sensors."""
        if len(self._last) < 2:
            return
        one, two, three = *self._last, np.where(given.seen, given.y, np.nan)
        rough, moved = np.abs(three - 2 * two + one), np.abs(three - two)
        for i in range(given.y.size):
            if not math.isnan(rough[i]):
                self._rough[i] += (min(rough[i], 3.0 * self._rough[i]) - self._rough[i]) / 100.0
            if moved[i] > 1e-9:
                self.moves[i] += 1
                self._smallest[i] = min(self._smallest[i], moved[i])
                if self.moves[i] >= 20:
                    self.steps[i] = min(self._smallest[i], 30.0 * self._model.noise[i])
            if given.seen[i] and self.repeats[i] < 10:
                pauses = self._pauses[i, state[i]]
                pauses += (0.5 * given.repeated[i], 1.0)
                if pauses[1] > 500.0:
                    pauses *= 0.5
        usual = self._model.noise
        self.noise = np.clip(self._rough / _SECOND, 0.3 * usual, 1.5 * usual)

    def _choose_way(self) -> None:
        """Have inputs act in another way from now on, if that is clearly better."""
        log, levels, members = self._log_weights, self._levels, self.members
        mine, others = float(np.logaddexp.reduce(log[:levels])), log[levels : self._healthy]
        way = int(np.argmax(others))
        if self._suspected or others[way] <= mine + _BETTER:
            return
        scout, was, better = levels + way, levels + self._way, float(others[way])
        for one in (members.at, members.covariance):
            one[was] = one[self.best]
            one[:levels] = one[scout]
        members.alive[was], members.alive[scout], members.way[:levels] = True, False, way
        self._way, log[was], log[scout], log[:levels] = way, mine, -50.0, better - math.log(levels)
        self.clear()

    # --- what is known ---

    def found(self) -> list[Found]:
        """Every cause with its evidence, the best first."""
        traces, dear = self.traces, 2.0 * math.log(1.0 + self.known / self.second / HOUR)
        used = (traces.of >= 0) & (self.count > traces.born)
        gain = np.where(used, traces.score + traces.weight + np.log(np.maximum(traces.mass, 1e-300)), -np.inf)
        known = []
        for c, cause in enumerate(self.causes):
            mine = np.flatnonzero((self._cause_of[traces.row] == c) & used)
            total = float(np.logaddexp.reduce(gain[mine], initial=-np.inf)) - dear
            if total < _INTERESTING:
                continue
            t = int(mine[np.argmax(gain[mine])])
            row, born = self._rows[traces.row[t]], int(traces.born[t])
            ramp = (self.count - born) * self.period / (row.slowly * self.scale) if row.slowly else 1.0
            known.append(Found(cause, total, row, float(traces.mean[t]) * min(ramp, 1.0), born, t))
        for i, nats in enumerate(self._frozen.tolist()):
            row, born = Row((Kind.FROZEN, i), ""), self.count - int(self.repeats[i])
            known.append(Found(row.cause, nats - math.log(HOUR * self.second) - dear, row, 0.0, born, -1))
        known = sorted((f for f in known if f.evidence >= _INTERESTING), key=lambda f: -f.evidence)
        self._suspected = bool(known) and known[0].evidence > 0.0
        return known

    def adopt(self, found: Found) -> None:
        """Take a change for how the plant is, in every healthy member by its own trace."""
        traces, members = self.traces, self.members
        row = int(traces.row[found.hypothesis])
        for b in range(self._healthy):
            begin_ = (row * self._levels + b) * _SLOTS
            mine = (
                [t for t in range(begin_, begin_ + _SLOTS) if traces.of[t] >= 0] if b < self._levels else []
            )
            t = min(mine, key=lambda t: abs(traces.born[t] - found.born), default=found.hypothesis)
            members.at[b] += traces.trace[t] * traces.mean[t]
            members.covariance[b] += np.outer(traces.trace[t], traces.trace[t]) * traces.variance[t]
        self.clear()

    def expect_back(self, back: list[Row]) -> None:
        """What may be undone."""
        self._back = back
        self._allocate()


def _between(off: float, digit: float, spread: float) -> float:
    """Probability that a normal value rounds to a reading that is `off` from its mean."""
    low, high = ((off + side * digit) / (math.sqrt(2.0) * spread) for side in (-0.5, 0.5))
    return 0.5 * (math.erf(high) - math.erf(low))
