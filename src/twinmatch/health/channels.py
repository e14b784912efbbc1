"""Alarms by channel of a plant with several signals: which hypothesis is named, and when it is over."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from twinmatch.dynamics import Parameters
from twinmatch.health.channel_sentences import ChannelSentences
from twinmatch.health.evidence import Competition, Suspect
from twinmatch.health.faults import (
    HOUR,
    SLOW,
    TRAITS,
    Alarm,
    EstimatedReading,
    Fault,
    Health,
    HealthState,
    touching,
)
from twinmatch.health.hypotheses import ChangeRow
from twinmatch.health.reading_through import ReadThrough
from twinmatch.signals import Sample

CHANGE: Final = 3.0
"""Evidence from which a change is reported, nats."""
LEAD: Final = 4.0
"""By how much the evidence of a cause must lead every other cause to be named."""


@dataclass(frozen=True)
class _Naming:
    """When a change is named, and when an unnamed one is reported."""

    holds: int = 3
    """Samples in a row in which it leads."""
    unnamed: float = 60.0
    """Time to wait for a name before an unnamed change is reported, s."""
    start: float = 30.0
    """Time after a gap in which nothing is reported, s."""
    young: float = 120.0
    """Time after the first sample in which only a lost drive is named, s."""
    learned: float = 1200.0
    """Time after the first sample from which on the plant's parameters are known well enough to say that
    they have changed, s."""
    sized: float = 30.0
    """Age at which the size of a drive's effect is known: before, a weak one may be a lost one, s."""
    confirm: int = 3
    """Samples in a row with a reading that the sensor cannot give."""


_NAMING: Final = _Naming()


_LEARNED_FIRST: Final = frozenset(f for f, traits in TRAITS.items() if traits.another_plant) | {Fault.DRIFT}
"""Faults that may be parameters that are not known yet."""


@dataclass(frozen=True)
class _Ending:
    """When a change counts as over."""

    passed: float = 15.0
    """Time for which a push that has passed is shown, s."""
    remainder: float = 0.4
    """Share of a change that may remain when it counts as over."""
    faded: float = 0.3
    """Share of a push from which on it has passed."""


_ENDING: Final = _Ending()


_BY_ITSELF: Final = (Fault.SENSOR_FROZEN, Fault.SENSOR_IMPLAUSIBLE)
"""Faults that a sensor's own readings show."""
_WIDE: Final = 10.0
"""Width of a band up to which an estimate is good, ± so many standard deviations of the sensor's noise."""
_KEPT: Final = 1000
"""Number of alarms kept."""
_ALL: Final = -0.8
"""Excess of a drive's effect from which on it is lost."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelAlarm(Alarm):
    """One fault of one signal, from its beginning to its end; the signal of a `DRIFT` is the likeliest."""

    size: float
    """Of a drive's effect what is left, as a share; losses as a factor; of readings and room the change, in
    their unit; NaN for the others."""
    rivals: tuple[str, ...]
    """What the samples did not tell apart from it, in words; empty for a named fault."""
    found: tuple[Suspect, ...]
    """What competed when it was reported, the best first."""


class ChannelMonitor:
    """Watches one plant with any number of inputs and outputs."""

    def __init__(self, parameters: Parameters, period: float) -> None:
        """Begin with typical parameters and the sample time, s."""
        self.competition = Competition(parameters, period)
        self._alarms: deque[ChannelAlarm] = deque(maxlen=_KEPT)
        self.reservation = self.doubt = ""  # as of a `Monitor`: here names say what is known
        self.estimates: tuple[EstimatedReading, ...] = ()
        """What sensors should read now that are not believed."""
        self.found: list[Suspect] = []
        """What competes now, the best first."""
        self.sentences = ChannelSentences(parameters.model)
        self._impossible = np.zeros(len(parameters.model.plant.outputs), dtype=np.int64)
        """Readings in a row of each output that its sensor cannot give."""
        self._standing: list[tuple[Fault, ChangeRow, float]] = []
        self._outputs = list(parameters.model.plant.outputs.items())
        self._spans = np.array([output.span for _, output in self._outputs])
        self._values = self._spans.mean(axis=1)
        self._begin = self._index = -2
        self._leads: tuple[object, int] = (None, 0)
        self._unnamed = 0

    @property
    def alarms(self) -> tuple[ChannelAlarm, ...]:
        """The newest alarms, oldest first, as many as are kept; only the last can still be on."""
        return tuple(self._alarms)

    @property
    def on(self) -> ChannelAlarm | None:
        """The alarm that is on."""
        return self._alarms[-1] if self._alarms and self._alarms[-1].last is None else None

    def fault_between(self, first: int, last: int, *, slow: bool = False) -> Alarm | None:
        """The first alarm that touches these samples; see `touching`."""
        return touching(self._alarms, first, last, slow=slow)

    def push(self, sample: Sample, _: Parameters | None = None) -> Health:
        """Take one sample; judge the plant as it is now, without asking any twin."""
        before = self._alarms[-1] if self._alarms else None
        self._push(sample)
        through = {} if self._blind else self.competition.through
        self.estimates = tuple(
            self._estimate(i, estimator, sample)
            for i, estimator in through.items()
            if estimator.samples > estimator.rehearsed
        )
        newest = self._alarms[-1] if self._alarms else None
        on = self.on
        news = newest if newest is not before else None
        nan = math.nan
        if on is None:
            return Health(sample.index, HealthState.HEALTHY, None, None, "", nan, nan, news)
        return Health(
            sample.index, HealthState.FAULT, on.fault, on.first, on.reason, nan, nan, news, on.signal
        )

    @property
    def _blind(self) -> bool:
        """Whether no sensor is left by which another could be read through."""
        return len(self.competition.through) == len(self._outputs)

    def _read_through(self, output: int, since: int) -> None:
        self.competition.read_through(output, since)
        if self._blind:
            reason = f"{self._alarms[-1].reason}; no sensor is right, so none can be read through"
            self._alarms[-1] = replace(self._alarms[-1], reason=reason)

    def _estimate(self, output: int, estimator: ReadThrough, sample: Sample) -> EstimatedReading:
        name, declared = self._outputs[output]
        wide = _WIDE * declared.noise
        if estimator.good is None:
            period = self.competition.healthy.period
            estimator.good = period * estimator.lasts(wide, round(HOUR / period))
        value, band = estimator.estimate
        reading = (sample.refused or sample.outputs)[output]
        since = sample.index - (estimator.samples - estimator.rehearsed) + 1
        return EstimatedReading(sample.index, name, value, band, reading, since, wide, estimator.good)

    def _push(self, sample: Sample) -> None:
        if sample.index != self._index + 1:
            self._begin = sample.index
            self.competition.restart()
            self.competition.through.clear()  # nobody knows where the plant went
        self._index = sample.index
        read = np.array(sample.refused or sample.outputs)
        possible = np.isfinite(read) & (read >= self._spans[:, 0]) & (read <= self._spans[:, 1])
        counts = possible & sample.seen & (not sample.refused)
        self._values = np.where(possible, read, self._values)
        self.competition.push(sample, self._values, counts)
        self._impossible = np.where(possible, 0, self._impossible + 1)
        for output in np.flatnonzero(self._impossible == _NAMING.confirm).tolist():
            row = ChangeRow((Fault.SENSOR_IMPLAUSIBLE, output), "")
            best = Suspect(row.cause, math.inf, row, 0.0, 0.0, self.competition.count - _NAMING.confirm, -1)
            self._raise(Fault.SENSOR_IMPLAUSIBLE, best, [best])
            self._read_through(output, 0)  # no filter has taken such readings: the newest is best
        self.found = [f for f in map(self._lost_or_weak, self.competition.found()) if self._counts(f)]
        self._judge(self.found)
        for output in [*self.competition.through]:
            if not self._lies(output):
                del self.competition.through[output]

    def _lies(self, output: int) -> bool:
        """Whether the sensor of an output is known to be off, or frozen or without sense now."""
        on = self.on
        by_alarm = on is not None and on.fault in _BY_ITSELF and on.found[0].cause[1] == output
        return by_alarm or any(row.cause == (Fault.SENSOR_DRIFT, output) for _, row, _ in self._standing)

    def _lost_or_weak(self, f: Suspect) -> Suspect:
        """A drive of which nearly nothing is left is lost, whatever it was taken for."""
        if f.cause[0] is not Fault.DRIVE_WEAK:
            return f
        lost = f.shift + self.competition.believed(f.row.number) <= _ALL
        return replace(f, cause=(Fault.DRIVE_LOST, f.cause[1])) if lost else f

    def shows(self, f: Suspect) -> bool:
        """Whether it shows: a sensor that repeats its reading is frozen once the plant should have moved."""
        fault, output = f.cause
        return fault is not Fault.SENSOR_FROZEN or self.competition.frozen(output, self._values[output])

    def _counts(self, f: Suspect) -> bool:
        """A push explains anything while it lasts; so it counts once it has passed."""
        return f.cause[0] is not Fault.DISTURBANCE or self.competition.remains(f) < _ENDING.faded

    def _judge(self, suspects: list[Suspect]) -> None:
        competition = self.competition
        on = self.on
        if on is not None and self._over(on, suspects):
            self._close()
        if (
            not suspects
            or suspects[0].evidence < CHANGE
            or competition.count < _NAMING.start * competition.second
        ):
            self._leads = (None, 0)
            self._unnamed = 0
            return
        named = [f for f in suspects if f.cause[0] is not Fault.DRIFT]
        if named and named[0].evidence > suspects[0].evidence - LEAD:
            suspects = named  # the unknown, which may act as anything does, counts only far ahead
        best = suspects[0]
        rivals = [f.evidence for f in suspects[1:] if self._rivals(f, best)]
        leads = best.evidence - max([0.0, *rivals]) >= LEAD
        self._leads = best.cause, self._leads[1] + 1 if self._leads[0] == best.cause else 1
        if self._leads[1] < _NAMING.holds:
            return
        if leads and (best.cause[0] is Fault.SENSOR_FROZEN or self._known(best)):
            self._name(best, suspects)
        elif not leads:
            self._unnamed += 1
            enough = best.evidence >= 2.0 * CHANGE and self._unnamed > _NAMING.unnamed * competition.second
            if enough and self.on is None and competition.known >= _NAMING.learned:
                self._raise(Fault.DRIFT, best, suspects)

    def _over(self, on: ChannelAlarm, suspects: list[Suspect]) -> bool:
        if on.fault is Fault.SENSOR_FROZEN:
            return self.competition.sensors[on.found[0].cause[1]].repeats == 0
        if on.fault is Fault.SENSOR_IMPLAUSIBLE:
            return not self._impossible[on.found[0].cause[1]]
        if on.fault is Fault.DISTURBANCE:
            return self._index - on.flagged > _ENDING.passed * self.competition.second
        return on.fault is Fault.DRIFT and (not suspects or suspects[0].evidence < 0.0)

    def _known(self, best: Suspect) -> bool:
        """Whether a change that leads is to be named; if not, it is learned in silence."""
        age = (self.competition.count - best.born) / self.competition.second
        if best.cause[0] is Fault.DRIVE_WEAK and age < _NAMING.sized:
            return False
        back = next((s for s in self._standing if self._undoes(best, s)), None)
        if back is not None:
            self._standing.remove(back)
            if self.on is not None and self.on.fault is back[0]:
                self._close()
        wait = _NAMING.learned if best.cause[0] in _LEARNED_FIRST else _NAMING.young
        young = self.competition.known < wait and best.cause[0] is not Fault.DRIVE_LOST
        if best.cause[0] in _LEARNED_FIRST and self.competition.rough:
            return False
        material = abs(best.shift) >= best.row.least
        if back is None and material and not young:
            return True
        if back is not None or best.evidence > 2.0 * CHANGE:
            self._adopt(best)
        return False

    @staticmethod
    def _rivals(f: Suspect, best: Suspect) -> bool:
        """Whether both cannot be said at once: a drive that is lost is weak, too, but not the reverse."""
        weak = best.cause[0] is Fault.DRIVE_WEAK and f.cause[0] is Fault.DRIVE_LOST
        return weak or f.row.number != best.row.number

    @staticmethod
    def _undoes(f: Suspect, standing: tuple[Fault, ChangeRow, float]) -> bool:
        _, row, shift = standing
        remaining = abs(shift + f.shift)
        return row.number == f.row.number and remaining <= max(_ENDING.remainder * abs(shift), f.row.least)

    def _name(self, best: Suspect, suspects: list[Suspect]) -> None:
        fault, signal = best.cause
        if fault is Fault.SENSOR_FROZEN:
            if self.shows(best) and (self.on is None or self.on.fault is Fault.DRIFT):
                self._raise(fault, best, suspects)
                self._read_through(signal, best.born)
            return
        if fault is Fault.DRIFT or (fault is Fault.DRIVE_WEAK and best.shift > 0.0):
            return  # what does more than before has no name
        on = self.on
        if on is None or (on.fault, on.found[0].cause[1]) != (fault, signal):
            self._raise(fault, best, suspects)
        if fault is not Fault.DISTURBANCE:
            self._standing.append((fault, best.row, best.shift))
        self._adopt(best)
        if fault is Fault.SENSOR_DRIFT:
            self._read_through(signal, best.born)

    def _adopt(self, best: Suspect) -> None:
        """The plant is so from now on; what has changed may be undone."""
        self.competition.adopt(best)
        self._leads = (None, 0)
        self._unnamed = 0
        self.competition.expect_back(
            [
                replace(row, shift=-size, spread=0.2 * abs(size), lasting=0.0, slowly=0.0, price=-2.0)
                for _, row, size in self._standing
            ]
        )

    def _raise(self, fault: Fault, best: Suspect, suspects: list[Suspect]) -> None:
        if self.on is not None:
            self._close()
        first = min(self._begin + best.born, self._index)
        near = [f for f in suspects if f.evidence > max(0.0, best.evidence - LEAD)]
        rivals = tuple(dict.fromkeys(self.sentences.called(f.cause) for f in near))
        signal, size, reason = self.sentences.said(fault, best, self._left(best), rivals)
        self._alarms.append(
            ChannelAlarm(
                fault,
                first,
                self._index,
                None,
                reason,
                fault not in SLOW,
                signal,
                size=size,
                rivals=rivals if fault is Fault.DRIFT else (),
                found=tuple(suspects),
            )
        )

    def _left(self, f: Suspect) -> float:
        """What is left of a drive's effect, as a share; 1 for anything else."""
        share = f.row.number.startswith("share ")
        return max(1.0 + f.shift + self.competition.believed(f.row.number), 0.0) if share else 1.0

    def _close(self) -> None:
        self._alarms[-1] = replace(self._alarms[-1], last=self._index)
