"""Alarms by channel: which of the hypotheses is named, and when it is over."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from benchmarks.bank.evidence import Bank, Found
from benchmarks.bank.hypotheses import Kind, Row
from twinmatch.dynamics import Parameters
from twinmatch.health import Fault
from twinmatch.signals import Sample

CHANGE: Final = 3.0
"""Evidence from which a change is reported, nats …"""
LEAD: Final = 4.0
"""… and by how much it must lead every other cause to be named."""
HOLDS: Final = 3
"""Samples in a row in which it leads."""
_UNNAMED: Final = 60.0
"""Time to wait for a name before an unnamed change is reported, s."""
_YOUNG: Final = 120.0
"""Time after the first sample in which only a lost drive is named, s …"""
_START: Final = 30.0
"""… and after a gap in which nothing is."""
_PASSED: Final = 15.0
"""Time for which a push that has passed is shown, s."""
_LEFT: Final = 0.4
"""Share of a change that may remain when it counts as over."""
_ALL: Final = -0.8
"""Excess of a drive's effect from which on it is lost."""


@dataclass(frozen=True)
class Alarm:
    """Something was found; `last` is None as long as it is on."""

    fault: Fault
    signal: int
    """Of which parameter, drive or output."""
    first: int
    flagged: int
    last: int | None
    found: tuple[Found, ...]
    """What competed when it was named, the best first."""


class BankMonitor:
    """Watches one plant with any number of inputs and outputs."""

    def __init__(self, parameters: Parameters, period: float) -> None:
        """Begin with typical parameters and the sample time, s."""
        self.bank = Bank(parameters, period)
        self.alarms: list[Alarm] = []
        self._standing: list[tuple[Fault, Row, float]] = []
        self._spans = np.array([output.span for output in parameters.model.plant.outputs.values()])
        self._begin = self._index = -2
        self._leads: tuple[object, int] = (None, 0)
        self._unnamed = 0

    @property
    def on(self) -> Alarm | None:
        """The alarm that is on."""
        return self.alarms[-1] if self.alarms and self.alarms[-1].last is None else None

    def push(self, sample: Sample) -> None:
        """Take one sample; judge the plant as it is now."""
        if sample.index != self._index + 1:
            self._begin = sample.index
            self.bank.gap()
        self._index = sample.index
        read = np.array(sample.refused or sample.outputs)
        possible = np.isfinite(read) & (read >= self._spans[:, 0]) & (read <= self._spans[:, 1])
        seen = possible & sample.seen & (not sample.refused)
        self.bank.push(sample, np.where(possible, read, 0.0), seen)
        self._judge([f for f in map(self._lost_or_weak, self.bank.found()) if self._counts(f)])

    def _lost_or_weak(self, f: Found) -> Found:
        """A drive of which nearly nothing is left is lost, whatever it was taken for."""
        if f.cause[0] is not Kind.DRIVE:
            return f
        before = self.bank.members.at[self.bank.best, self.bank.numbers[f.row.number]]
        return replace(f, cause=(Kind.LOST, f.cause[1])) if f.shift + before <= _ALL else f

    def _counts(self, f: Found) -> bool:
        """A push explains anything while it lasts; so it counts once it has passed."""
        if f.cause[0] is not Kind.PASSING:
            return True
        return bool(self.bank.traces.trace[f.hypothesis, self.bank.numbers[f.row.number]] < 0.3)

    def _judge(self, found: list[Found]) -> None:
        bank, on = self.bank, self.on
        if on is not None and self._over(on, found):
            self._close()
        if not found or found[0].evidence < CHANGE or bank.count < _START * bank.second:
            self._leads, self._unnamed = (None, 0), 0
            return
        named = [f for f in found if f.cause[0] is not Kind.OTHER]
        if named and named[0].evidence > found[0].evidence - LEAD:
            found = named  # the unknown, which may act as anything does, counts only far ahead
        best = found[0]
        rivals = [f.evidence for f in found[1:] if f.row.number != best.row.number]
        leads = best.evidence - max([0.0, *rivals]) >= LEAD
        self._leads = best.cause, self._leads[1] + 1 if self._leads[0] == best.cause else 1
        if self._leads[1] < HOLDS:
            return
        if leads and (best.cause[0] is Kind.FROZEN or self._known(best)):
            self._name(best, found)
        elif not leads:
            self._unnamed += 1
            enough = best.evidence >= 2.0 * CHANGE and self._unnamed > _UNNAMED * bank.second
            if enough and self.on is None:
                self._raise(Fault.DRIFT, best, found)

    def _over(self, on: Alarm, found: list[Found]) -> bool:
        if on.fault is Fault.SENSOR_FROZEN:
            return bool(self.bank.repeats[on.signal] == 0)
        if on.fault is Fault.DISTURBANCE:
            return self._index - on.flagged > _PASSED * self.bank.second
        return on.fault is Fault.DRIFT and (not found or found[0].evidence < 0.0)

    def _known(self, best: Found) -> bool:
        """Whether a change that leads is to be named; if not, it is learned in silence."""
        bank = self.bank
        back = next((s for s in self._standing if self._undoes(best, s)), None)
        if back is not None:
            self._standing.remove(back)
            if self.on is not None and self.on.fault is back[0]:
                self._close()
        young = bank.known < _YOUNG * bank.second and best.cause[0] is not Kind.LOST
        material = abs(best.shift) >= best.row.least
        if back is None and material and not young:
            return True
        if back is not None or best.evidence > 2.0 * CHANGE:
            self._adopt(best)
        return False

    @staticmethod
    def _undoes(f: Found, standing: tuple[Fault, Row, float]) -> bool:
        _, row, shift = standing
        left = abs(shift + f.shift)
        return row.number == f.row.number and left <= max(_LEFT * abs(shift), f.row.least)

    def _name(self, best: Found, found: list[Found]) -> None:
        fault, signal = best.cause[0].value, best.cause[1]
        if fault is Fault.SENSOR_FROZEN:
            fine = self.bank.steps[signal] < self.bank.noise[signal] and self.bank.moves[signal] > 20
            if fine and self.on is None:
                self._raise(fault, best, found)
            return
        if fault is Fault.DRIFT or (fault is Fault.DRIVE_WEAK and best.shift > 0.0):
            return  # what does more than before has no name
        on = self.on
        if on is None or (on.fault, on.signal) != (fault, signal):
            self._raise(fault, best, found)
        if fault is not Fault.DISTURBANCE:
            self._standing.append((fault, best.row, best.shift))
        self._adopt(best)

    def _adopt(self, best: Found) -> None:
        """The plant is so from now on; what has changed may be undone."""
        self.bank.adopt(best)
        self.bank.forget_newest()
        self._leads, self._unnamed = (None, 0), 0
        self.bank.expect_back([
            replace(row, shift=-size, spread=0.2 * abs(size), lasting=0.0, slowly=0.0, price=-2.0)
            for _, row, size in self._standing
        ])  # fmt: skip

    def _raise(self, fault: Fault, best: Found, found: list[Found]) -> None:
        if self.on is not None:
            self._close()
        first = min(self._begin + best.born, self._index)
        self.alarms.append(Alarm(fault, best.cause[1], first, self._index, None, tuple(found)))

    def _close(self) -> None:
        self.alarms[-1] = replace(self.alarms[-1], last=self._index)
