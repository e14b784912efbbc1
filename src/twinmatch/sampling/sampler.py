"""Samples of a loop that foreign programs run: values and times in, one sample per tick out.

At tick k, references, outputs and disturbances are the newest values; the inputs are what acts on the plant
from tick k to tick k+1. If an input paces the loop (a controller that has read the outputs and then
commands), these are their values at the tick. Otherwise they are known one period later, as means over that
period.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import islice, zip_longest
from statistics import median
from types import MappingProxyType
from typing import Final

import numpy as np

from twinmatch.sampling.channels import SamplingError
from twinmatch.sampling.names import LoopNames
from twinmatch.sampling.sources import INPUT
from twinmatch.sampling.turns import TurnCounter, beside
from twinmatch.signals import NANOSECONDS, Sample, Signals

TIMER: Final = "timer"
"""Paces the samples with the sampler's own clock instead of a signal."""

_NONE: Final[Mapping[str, float]] = MappingProxyType({})
LATEST_SETTLE: Final = 0.45
"""Largest settling time, in periods; later values would rather belong to the next tick."""

_AT_ONCE: Final = 0.1
"""Interval in which the same value counts once, in periods: some programs send a message repeatedly."""


class Grid:
    """A grid of ticks one period apart, whose origin follows the ticks.

    A tick that is late by a period or more means that others were missed. One that is early by half a period
    or more does not count: two messages arrived at once. One that is slightly early moves the grid, because
    the ticks before it were late. Since the foreign clock runs at a slightly different rate than ours, each
    late tick moves the grid a little too: a loop that is 1 % slower than stated stays late by a tenth of a
    period, and no tick is counted as missed.
    """

    _LEAK: Final = 0.1
    """Fraction of a tick's lateness by which the grid is moved after it."""

    def __init__(self, period: int) -> None:
        """Start without a tick; the period is in ns."""
        self.missed = 0
        """Ticks missed since the first."""
        self.jitter = 0
        """Lateness of the newest tick, ns."""
        self._period = period
        self._number: int | None = None
        self._newest = 0
        self._due = 0
        """When the newest tick was due, ns."""

    def place(self, now: int) -> int | None:
        """The number of the tick at `now` (ns), from 0; None if it does not count."""
        if self._number is None:
            self._number = 0
            self._newest = now
            self._due = now
            return 0
        if now < self._newest - self._period:
            # the clock was set back: nothing reaches across that
            self.missed = self.missed + 1
            self.jitter = 0
            self._number = self._number + 2
            self._newest = now
            self._due = now
            return self._number
        late = now - self._due - self._period
        if late <= -self._period // 2 or now <= self._newest:
            return None
        skipped, late = divmod(late, self._period) if late > 0 else (0, late)
        self.missed += skipped
        self.jitter = max(late, 0)
        self._number += 1 + skipped
        self._newest = now
        # During a gap the loop may have been restarted, at any time.
        self._due = (
            now if late < 0 or skipped else now - late + round(self._LEAK * late)
        )
        return self._number


class Rate:
    """The newest intervals between ticks."""

    _FEWEST: Final = 5
    """Fewest intervals for an estimate."""
    _INTERVALS: Final = 100
    _REGULAR: Final = 0.5
    """Relative deviation from the median up to which an interval is regular: neither gap nor burst."""
    _DEVIATIONS: Final = 4.0
    """Standard deviations of the mean that are not significant: few intervals may hide how uneven all are."""
    _TOLERATED: Final = 0.01
    """Tolerated relative error of the period: a twin's time constants are off by as much."""

    def __init__(self) -> None:
        self._intervals: deque[float] = deque(maxlen=self._INTERVALS)
        self._last: int | None = None

    def push(self, now: int) -> None:
        """Take the time of a tick, ns."""
        if self._last is not None:
            self._intervals.append((now - self._last) / 1e9)
        self._last = now

    @property
    def period(self) -> float | None:
        """Mean of the intervals without gaps and bursts, s; None while there are too few."""
        regular = self._regular()
        return float(regular.mean()) if regular.size >= self._FEWEST else None

    def differs_from(self, period: float) -> bool:
        """Whether the intervals significantly differ from a period (s)."""
        regular = self._regular()
        if regular.size < self._FEWEST:
            return False
        # The lateness of single ticks cancels in the mean, except for the first and the last.
        unsure = self._DEVIATIONS * float(regular.std()) / regular.size
        return bool(abs(regular.mean() - period) > self._TOLERATED * period + unsure)

    def _regular(self) -> np.ndarray:
        if not self._intervals:
            return np.empty(0)
        usual = median(self._intervals)
        intervals = np.array(self._intervals)
        return intervals[np.abs(intervals - usual) <= self._REGULAR * usual]


@dataclass(frozen=True)
class Limits:
    """Limits of a signal's values."""

    max_age: float = 0.0
    """Age from which a value is stale, s; 0: never."""
    low: float = -math.inf
    high: float = math.inf
    """In the plant's unit; a tick with a value outside has no sample."""
    lenient: bool = False
    """Whether values outside are accepted once one was inside: then a sensor failed, the unit is right."""


@dataclass
class Counts:
    """Ticks without a usable value of one signal."""

    missing: int = 0
    """Ticks at which it had no value yet."""
    late: int = 0
    """Ticks at which its newest value was stale."""
    beyond: int = 0
    """Ticks at which its value was outside the limits."""


@dataclass
class _Tick:
    number: int
    time: int
    ready: int
    """Time at which the values sent with it have arrived, ns."""
    paced: float | None = None
    """The value that triggered the tick."""
    values: dict[str, float] = field(default_factory=dict)
    """Empty until read."""
    troubles: dict[str, str] = field(default_factory=dict)


class Sampler:
    """Ticks and values in, samples out.

    A tick without all of its values makes no sample; the index of the next sample shows how many are missing.
    All times are ns of one clock: `stamp` is when a value was measured or commanded, `now` when it arrived.
    """

    def __init__(
        self,
        signals: Mapping[str, Limits],
        period: float,
        paced_by: str = INPUT,
        *,
        settle: float = 0.1,
        disturbances: Mapping[str, float] = _NONE,
        loop: LoopNames = LoopNames(),  # noqa: B008
        turns: Mapping[str, float] = _NONE,
    ) -> None:
        """Start without values.

        Args:
            signals: limits of the mapped signals by name: all outputs and inputs of the loop, its references
                or none, and disturbances.
            period: sampling period, s.
            paced_by: the signal whose values trigger the ticks, or `timer`.
            settle: time to wait after the value that triggers a tick for the values sent with it, in periods.
            disturbances: default value of each of the plant's disturbances, in its order; used where a
                disturbance is not mapped.
            loop: names of the references, outputs and inputs.
            turns: what each signal loses that begins again, such as a heading; the turns of references are
                those of their outputs.

        Raises:
            SamplingError: the settings allow no sampling.
        """
        _check(signals, loop, period, paced_by, settle)
        self.counts = {name: Counts() for name in signals}
        self.troubles: dict[str, str] = {}
        """Reasons why the newest tick had no sample, by signal or `pace`; empty if it had one."""
        self.idle = 0
        """Ticks since sample 0 without a sample."""
        self.repeated = 0
        """Values of the pacing signal that were sent again at once; they are not ticks."""
        self.grid = Grid(round(period * NANOSECONDS))
        self.rate = Rate()
        self.limits = signals
        """Limits of the mapped signals."""
        self.period = period
        """Sampling period, s."""
        self._buffers = {name: SignalBuffer() for name in signals}
        self._step = round(period * NANOSECONDS)
        self._pacer = paced_by
        self._settle = round(settle * self._step)
        self._disturbances = disturbances
        self._loop = loop
        self._commanded = paced_by in loop.inputs
        self._turns = turns
        self._turn_counters = {
            name: TurnCounter(turn)
            for name, turn in turns.items()
            if name not in loop.references
        }
        self._ticks: deque[_Tick] = deque()
        self._at_once = round(_AT_ONCE * self._step)
        self._paced: tuple[float, int] | None = None
        """The newest value of the pacing signal that was not sent again, and its time, ns."""
        self._within: set[str] = set()
        self._first: int | None = None
        self._references: Signals = ()

    def refused(self, name: str) -> int:
        """Values of a signal that were not finite."""
        return self._buffers[name].refused

    def newest(self, name: str) -> float | None:
        """A signal's newest value; None before there is one."""
        return self._buffers[name].newest

    def take(
        self, name: str, value: float, stamp: int, now: int, *, retained: bool = False
    ) -> None:
        """Take a value; one of the pacing signal triggers a tick, unless it was `retained` since earlier."""
        if name in self._turn_counters:
            value = self._turn_counters[name].counted(value)
        self._buffers[name].push(value, stamp)
        if (
            name == self._pacer
            and math.isfinite(value)
            and not retained
            and not self._repeats(value, stamp)
        ):
            self._push(_Tick(0, stamp, now + self._settle, value))

    def end(self, name: str) -> None:
        """End a signal's value: a newer one is known not to be a number."""
        self._buffers[name].clear()

    def forget(self) -> None:
        """Forget values that become stale: what has come in the meantime is not known."""
        for name, limits in self.limits.items():
            if limits.max_age:
                self._buffers[name].clear()

    def tick(self, now: int) -> None:
        """Take a tick of the timer."""
        self._push(_Tick(0, now, now))

    def collect(self, now: int) -> list[Sample]:
        """The samples that are complete now; to be called several times per period."""
        for tick, after in zip_longest(self._ticks, islice(self._ticks, 1, None)):
            if not tick.values and now >= tick.ready:
                self._read(tick, after)
        samples = []
        while self._ticks and self._complete(self._ticks[0], now):
            tick = self._ticks.popleft()
            for name in () if self._commanded else self._loop.inputs:
                mean = self._buffers[name].mean(tick.time, tick.time + self._step)
                tick.values[name] = self._check_value(
                    name, mean, tick.ready + self._step, tick.troubles
                )
            self.troubles = tick.troubles
            if not tick.troubles:
                samples.append(self._sample(tick.number, tick.time, tick.values))
            elif self._first is not None:
                self.idle += 1
        return samples

    def _repeats(self, value: float, stamp: int) -> bool:
        """Whether a value of the pacing signal is one that has come already, and is sent again at once."""
        before = self._paced
        is_repeated = (
            before is not None
            and value == before[0]
            and 0 <= stamp - before[1] < self._at_once
        )
        if is_repeated:
            self.repeated += 1
        else:
            self._paced = (value, stamp)
        return is_repeated

    def _complete(self, tick: _Tick, now: int) -> bool:
        return bool(tick.values) and (self._commanded or now >= tick.ready + self._step)

    def _push(self, tick: _Tick) -> None:
        self.rate.push(tick.time)
        number = self.grid.place(tick.time)
        if number is not None:
            tick.number = number
            self._ticks.append(tick)

    def _read(self, tick: _Tick, after: _Tick | None) -> None:
        """Read the values at the tick, and note those that cannot be used."""
        if self.rate.differs_from(self.period):
            tick.troubles["pace"] = (
                f"{self._pacer} arrives every {self.rate.period:.4g} s, but the period is "
                f"{self.period:g} s; correct the period, or set paced_by to {TIMER}"
            )
        elif (
            after is not None
            and self._pacer != TIMER
            and after.ready - tick.ready < self._settle
        ):
            tick.troubles["pace"] = (
                "several ticks arrived at once; their other values cannot be told apart"
            )
        for name in self.limits:
            if self._commanded or name not in self._loop.inputs:
                value = (
                    tick.paced if name == self._pacer else self._buffers[name].newest
                )
                tick.values[name] = self._check_value(
                    name, value, tick.ready, tick.troubles
                )

    def _sample(self, number: int, time: int, values: Mapping[str, float]) -> Sample:
        references, outputs, inputs = self._loop
        if self._first is None:
            self._first = number
            # Without mapped references the fields must still be finite.
            self._references = tuple(values[name] for name in outputs)
        set_points = []
        for name, output, stand_in in zip(
            references, outputs, self._references, strict=False
        ):
            set_point = values.get(name, stand_in)
            if name in values and name in self._turns:
                set_point = beside(set_point, values[output], self._turns[name])
            set_points.append(set_point)
        return Sample(
            number - self._first,
            time,
            tuple(set_points),
            tuple(values[name] for name in outputs),
            tuple(values[name] for name in inputs),
            tuple(
                values.get(name, usual) for name, usual in self._disturbances.items()
            ),
        )

    def _check_value(
        self, name: str, value: float | None, tick_time: int, troubles: dict[str, str]
    ) -> float:
        """The value, perhaps NaN; if it cannot be used, the reason is added to `troubles`."""
        limits = self.limits[name]
        counts = self.counts[name]
        measured = self._buffers[name].time
        if value is None or measured is None:
            counts.missing += 1
            troubles[name] = f"no {name} yet"
            return math.nan
        age = (tick_time - measured) / NANOSECONDS
        if limits.max_age and age > limits.max_age:
            counts.late += 1
            troubles[name] = f"the newest {name} is {age:.1f} s old"
        elif age < -self.period:
            counts.late += 1
            troubles[name] = (
                f"{name} is stamped {-age:.1f} s after the tick: a clock was set or this machine suspended"
            )
        elif limits.low <= value <= limits.high:
            self._within.add(name)
        elif not (limits.lenient and name in self._within):
            counts.beyond += 1
            troubles[name] = (
                f"{name} is {value:g}, outside {limits.low:g} to {limits.high:g}"
            )
        return value


def _check(
    signals: Mapping[str, Limits],
    loop: LoopNames,
    period: float,
    paced_by: str,
    settle: float,
) -> None:
    for name in (*loop.outputs, *loop.inputs):
        if name not in signals:
            raise SamplingError(f"{name} is not mapped; every sample needs it")
    if paced_by not in (*signals, TIMER):
        raise SamplingError(
            f"paced_by is {paced_by!r}; choose one of {', '.join([*signals, TIMER])}"
        )
    if not 0 <= settle <= LATEST_SETTLE:
        raise SamplingError(
            f"settle is {settle:g}; give a fraction of the period from 0 to {LATEST_SETTLE}"
        )
    if not (math.isfinite(period) and period > 0):
        raise SamplingError(f"period is {period:g} s; it must be positive")


class SignalBuffer:
    """The newest value, and as many before it as a mean may need."""

    _MAX_KEPT: Final = 100_000
    """Most values kept for a mean; of more values in a period, only the newest are averaged."""

    def __init__(self) -> None:
        """Start without values."""
        self.refused = 0
        """Values that were not finite."""
        self._values: deque[tuple[int, float]] = deque(maxlen=self._MAX_KEPT)

    def push(self, value: float, stamp: int) -> None:
        """Take a value with its time `stamp` (ns); a value that is not finite is only counted."""
        if not math.isfinite(value):
            self.refused += 1
            return
        if (
            self._values and stamp < self._values[-1][0]
        ):  # a clock was set back: the earlier times are not comparable
            self._values.clear()
        self._values.append((stamp, value))

    def clear(self) -> None:
        """Forget all values."""
        self._values.clear()

    @property
    def newest(self) -> float | None:
        """The newest value."""
        return self._values[-1][1] if self._values else None

    @property
    def time(self) -> int | None:
        """Time of the newest value, ns."""
        return self._values[-1][0] if self._values else None

    def mean(self, start: int, end: int) -> float | None:
        """Mean from `start` to `end` (ns) under zero-order hold; None if there was no value at the start.

        Forgets earlier values.
        """
        while len(self._values) > 1 and self._values[1][0] <= start:
            self._values.popleft()
        if not self._values or self._values[0][0] > start:
            return None
        before_end = [(stamp, value) for stamp, value in self._values if stamp < end]
        values = [value for _, value in before_end]
        if len(set(values)) == 1:  # exactly, without the rounding of a sum
            return values[0]
        begins = [max(stamp, start) for stamp, _ in before_end]
        ends = [*begins[1:], end]
        spans = zip(values, begins, ends, strict=True)
        total = math.fsum(
            value * (span_end - begin) for value, begin, span_end in spans
        )
        return min(max(total / (end - start), min(values)), max(values))
