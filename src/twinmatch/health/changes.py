"""Change detection: whether something about the plant has changed, what, and since when.

The plant is tracked by its equations (`Tracker`) at several levels of assumed model error; the samples decide
which level is used. The trace that a jump of the losses, of the room, of the drive's share, of the reading or
of an unnamed push would have left in the innovations since is computed recursively (Willsky and Jones 1976),
which is cheap. Where such a jump explains more than it costs, the tracker is run for every hypothesis from
the belief before the change; the code length of the readings that it saves is the evidence for it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from twinmatch.dynamics import Parameters
from twinmatch.dynamics.filters import Readings, Traces
from twinmatch.dynamics.pace import plant_scale, slow_scale, time_scale
from twinmatch.dynamics.tracker import Belief, TrackedCourse, Tracker
from twinmatch.health.faults import TRAITS, Fault
from twinmatch.health.late_input import later_inputs
from twinmatch.health.track_record import HORIZONS, TrackRecord
from twinmatch.health.tracking import REACH, TrackedBlocks, joined
from twinmatch.signals import FloatArray, Sample

_LOSSES: Final = ((math.log(1 / 6), 0.8), (math.log(3.0), 0.6))
"""A fan that fails, a lid that opens: logarithm of the factor, and its spread."""
_ROOM: Final = 0.8
"""Spread of a change of the room, in the scale of the parameter."""
_HEAT: Final = 2.5
"""The same for heat from elsewhere, which acts as another room would."""
_SHARE: Final = 0.3
_LOST: Final = 0.1
"""Spreads of a change of the drive's share, and of what a lost one lacks of it."""
_ONSETS: Final = 4
"""Number of moments tried for a lost drive between two at which other changes may have begun."""
_OFFSET: Final = 30.0
"""Spread of an offset of the reading, in standard deviations of its noise."""
_PUSH: Final = 1.0
"""Spread of a push, in standard deviations of the noise per sample."""
_PASSING: Final = ((3.0, 30.0), (12.0, 30.0), (3.0, 90.0))
"""The same for a push that passes, which may be stronger for being short, and the time after its onset, s,
within which it changes."""
_SLOW_TIME: Final = 300.0
"""Time in which a slow change covers its spread, s."""
_ROOM_TIME: Final = 1800.0
"""The same for the room, s: a failed fan warms the sink in minutes; the room never changes so fast."""
_RARE: Final = 2.5
"""Prior cost of a change that grows evenly over minutes, nats: fans fail at once and fail far more often, and
the sink's response to that looks much the same."""
_MIN_SIZE: Final = {
    Fault.LOSSES_CHANGED: 0.4,
    Fault.ROOM_CHANGED: 0.3,
    Fault.DRIVE_WEAK: 0.08,
    Fault.DRIVE_LOST: 0.6,
    Fault.SENSOR_DRIFT: 10.0,
    Fault.DRIFT: 0.3,
    Fault.DISTURBANCE: 0.5,
}
"""Changes smaller than this, in the same units, are not reported."""


@dataclass(frozen=True)
class Hypothesis:
    """One number of a belief has changed."""

    fault: Fault
    """What it would be."""
    index: int
    """Index of that number in the belief."""
    shift: float
    """Expected size of the change …"""
    spread: float
    """… and its standard deviation."""
    least: float
    """Smallest shift worth reporting."""
    parameter: str = ""
    """Its name, if it is a parameter."""
    price: float = 0.0
    """Prior cost, nats: higher for changes that are rarer than others."""
    lasting: float = 20.0
    """Time after its onset within which it may still change, s."""
    slowly: float = 0.0
    """Time in which an even change covers its spread, s; 0: a sudden change."""
    at_once: bool = False
    """Whether all of it comes with one reading."""
    vague: bool = False
    """Whether it stands for anything that acts like it."""
    ceases: bool = False
    """Whether it is over again, since some moment."""


@dataclass(frozen=True)
class DetectedChange:
    """The change that explains the samples best."""

    hypothesis: Hypothesis
    gain: float
    """How much better it explains the readings since than no change does, in nats."""
    lead: float
    """The same compared with the best of all other kinds."""
    first: int
    """Sample at which it began."""
    before: float
    """Value of the number before, in the belief's units."""
    value: float
    """Its value now."""
    begun: bool
    """Whether it began at `first`; False if it may have been there from the start."""
    rivals: tuple[Fault, ...] = ()
    """The other kinds, best first …"""
    gains: tuple[float, ...] = ()
    """… and what each gains."""
    off: float = 0.0
    """How far the readings would have shifted, if it were that, in the output's unit."""

    @property
    def shift(self) -> float:
        """By how much the number has changed."""
        return self.value - self.before

    def behind(self, fault: Fault) -> float:
        """How many nats less a change of this kind gains than the best one."""
        if fault is self.hypothesis.fault:
            return 0.0
        gains = dict(zip(self.rivals, self.gains, strict=True))
        return self.gain - gains.get(fault, -math.inf)


def hypotheses(tracker: Tracker, noise: float, period: float, *, steps: bool) -> Sequence[Hypothesis]:
    """The hypotheses for one plant: for parameters with a role in its file, and those of every plant.

    `steps`: whether only a sensor that has shifted makes a step of the reading. A camera that corrects itself
    makes some when it is healthy.
    """
    found: list[Hypothesis] = []
    for name in tracker.free:
        declared = tracker.parameters.model.declared[name]
        logged = bool(tracker.logged[tracker.free.index(name)])
        if declared.role == TRAITS[Fault.LOSSES_CHANGED].role and logged:
            least = _MIN_SIZE[Fault.LOSSES_CHANGED]
            found += [
                Hypothesis(Fault.LOSSES_CHANGED, tracker.at[name], s, w, least, name) for s, w in _LOSSES
            ]
        if declared.role == TRAITS[Fault.ROOM_CHANGED].role:
            scale = 0.05 if logged else declared.scale
            least = _MIN_SIZE[Fault.ROOM_CHANGED] * scale
            found.append(Hypothesis(Fault.ROOM_CHANGED, tracker.at[name], 0.0, _ROOM * scale, least, name))
    found += [replace(h, slowly=_ROOM_TIME, price=_RARE) for h in found if h.fault is Fault.ROOM_CHANGED]
    if steps:
        price = math.log(_ONSETS)
        found.append(
            Hypothesis(Fault.DRIVE_LOST, tracker.share, -1.0, _LOST, _MIN_SIZE[Fault.DRIVE_LOST], price=price)
        )
    for fault, index, unit, spread in (
        (Fault.DRIVE_WEAK, tracker.share, 1.0, _SHARE),
        (Fault.SENSOR_DRIFT, tracker.offset, noise, _OFFSET),
        (Fault.DRIFT, tracker.push, noise / period, _PUSH),
    ):
        sudden = Hypothesis(fault, index, 0.0, spread * unit, _MIN_SIZE[fault] * unit)
        found += (
            [sudden] if fault is Fault.DRIFT else [sudden, replace(sudden, slowly=_SLOW_TIME, price=_RARE)]
        )
    scale = slow_scale(tracker.parameters.model.plant, period)
    unit = noise / (scale if scale > 1.0 else time_scale(period))
    if steps:
        found += [replace(h, at_once=True) for h in found if h.fault is Fault.SENSOR_DRIFT and not h.slowly]
    passing = Hypothesis(Fault.DISTURBANCE, tracker.fading, 0.0, 0.0, _MIN_SIZE[Fault.DISTURBANCE] * unit)
    found += [replace(passing, spread=spread * unit, lasting=time) for spread, time in _PASSING]
    for room in [h for h in found if h.fault is Fault.ROOM_CHANGED and not h.slowly and steps]:
        heat = replace(room, spread=_HEAT / _ROOM * room.spread, vague=True)
        found += [heat, replace(heat, fault=Fault.DISTURBANCE, least=passing.least, ceases=True)]
    return [replace(h, lasting=h.lasting * scale, slowly=h.slowly * scale) for h in found]


_EVERY: Final = 2
"""Spacing of the moments at which a change may have begun or ceased, blocks."""
_HOUR: Final = 360
"""Blocks of an hour of a plant as fast as the rig."""
_MIN_AGE: Final = 3
"""Least age of a change that is reported, blocks."""
_STEP_AGE: Final = 10
"""Greatest age up to which a step of the reading alone is a reason to look for a change, blocks."""
_CAME_BACK: Final = 0.5
"""Share of the smallest change worth reporting below which a number has come back."""
_LEARN: Final = 30
"""Blocks that must be seen before a change is reported."""
_WORTH: Final = 4.0
"""Nats that a jump must save before the tracker is run for each hypothesis, and by which one onset must beat
another to count as the beginning of the change."""
_LESS_ACCURATE: Final = frozenset({Fault.LOSSES_CHANGED, Fault.ROOM_CHANGED, Fault.DRIFT, Fault.DISTURBANCE})
"""Changes after which the equations may be less accurate than before, as they may without a change: the air
in an open box is no longer one lump. A sensor offset or a weak drive leaves their accuracy as it was."""
_COARSE: Final = 2.0
"""Factor on what a late input saves: those that are tried are pure delays or lags, some seconds apart, and a
plant that has both, or one in between, is explained better by its own."""
_ABSORBED_AFTER: Final = 24
"""Age from which on what a late input explains is taken for how the plant is, blocks: before long, its onset
is out of reach, and its trace would look like a change that came later."""
_PATIENCE: Final = 12
"""Comparisons without result after which they are made less often …"""
_RAREST: Final = 6
"""… down to once in so many blocks."""


_UNIVERSAL: Final = 2.865064
"""Sum over all whole numbers n of 1 / (n log₂ n log₂ log₂ n …), as far as the factors are positive."""


class _Found(NamedTuple):
    """The best hypothesis of one kind."""

    gain: float
    hypothesis: Hypothesis
    age: int
    level: int
    belief: Belief


_Course = Callable[[Readings], tuple[Belief, float]]
"""The belief after all readings since an onset under a hypothesis, and their code length; called with more
and more readings, of which each is tracked once."""


class ChangeDetector:
    """Tracks one plant and detects what has changed."""

    def __init__(self, parameters: Parameters, period: float, *, steps: bool = False) -> None:
        """Begin with these parameters in the tracked structure; `period` is the sample time, s; `steps` as in
        `hypotheses`.
        """
        self._period = period
        self._second = plant_scale(parameters.model.plant, period) / period  # samples
        self.tracked = TrackedBlocks(parameters, period)
        """The last samples."""
        self.tracker = self.tracked.tracker
        self.track_record = TrackRecord(self.tracker)
        noise = parameters.model.plant.output.noise
        self.hypotheses = hypotheses(self.tracker, noise, period, steps=steps)
        self._steps = steps
        self._back: Hypothesis | None = None
        lasting = [h for h in self.hypotheses if h.fault is not Fault.DISTURBANCE and not h.vague]
        self._jumps = list({h.index: h for h in lasting}.values())
        self._offset = next(h for h in self.hypotheses if h.fault is Fault.SENSOR_DRIFT)
        self._best: tuple[DetectedChange, _Found] | None = None
        self.changed = False
        """Whether the plant is known to be changed, and to come back some time."""
        self._changed_at = -HORIZONS[-1]  # block at which it was so last
        self._reset()

    @property
    def level(self) -> float:
        """Assumed model error, in units of that of a real rig."""
        return self.tracked.trust

    @property
    def suspected(self) -> bool:
        """Whether a change is suspected now."""
        return self._best is not None

    @property
    def compares(self) -> bool:
        """Whether the plant has been seen for long enough, and follows its equations well enough."""
        return self.tracked.known >= _LEARN and not self.tracked.blind

    @property
    def block(self) -> float:
        """Length of a block, s."""
        return self.tracked.size * self._period

    @property
    def push_rate(self) -> float:
        """Rate at which something unnamed moves the output, in its unit per second."""
        belief = self.tracked.belief
        if belief is None:
            return 0.0
        return float(belief.values[self.tracker.fading] + belief.values[self.tracker.push])

    @property
    def offset(self) -> float:
        """By how much the readings are believed to be shifted for good, in the output's unit."""
        belief = self.tracked.belief
        return 0.0 if belief is None else float(belief.values[self.tracker.offset])

    def restart(self, *, offset: bool = False) -> None:
        """Start over after a gap or a fault, keeping what was learned about the plant.

        With `offset`, the offset of the reading is unknown again.
        """
        self.track_record.forget_newest()
        opening = (self._offset.index, self._offset.spread) if offset else None
        self.tracked.restart(opening)
        self._reset()

    def expect_back(self, shift: float) -> None:
        """The readings have shifted, and may step back by a `shift`; 0: they have not.

        A camera's own steps seldom have this size, so such a step of any plant is looked at.
        """
        step = replace(self._offset, shift=shift, spread=0.2 * abs(shift), at_once=True)
        self._back = step if shift else None

    def push(self, sample: Sample) -> DetectedChange | None:
        """Take a sample; when a block is full, return the change, if any."""
        stretch = self.tracked.full(sample)
        if stretch is None:
            return None
        if self.tracked.count % _EVERY == 0:
            self._start()
        self.tracked.take(stretch, self._traces, settled=self.suspected)
        if self.tracked.moved_level:
            self._clear()
        self._record()
        if not self.compares:
            self._best = None
            return None
        return self._search()

    def _record(self) -> None:
        """Compare what was forecast of the newest blocks with them, unless the plant was changed then."""
        tracked = self.tracked
        if self.changed:
            self._changed_at = tracked.count
        if tracked.count - self._changed_at >= HORIZONS[-1]:
            newcomer = tracked.known < _LEARN
            self.track_record.push(tracked.blocks, tracked.count, tracked.level, newcomer=newcomer)

    def pushes(self) -> FloatArray:
        """What has passed: how far it pushed the output in every block since its onset, in its unit."""
        assert self._best is not None  # noqa: S101 — only a returned change is asked about
        _, h, age, level, _ = self._best[1]
        if h.ceases:
            return self._beyond(age, level)
        blocks = list(self.tracked.blocks)[-age:]
        size = self.tracked.size
        stretch = joined(blocks)
        course = self._course(h, blocks[0].before[level], level, stretch)
        beliefs = (course(stretch.part(0, size * count))[0] for count in range(1, age + 1))
        return np.array([belief.values[h.index] for belief in beliefs]) * self.block

    def _beyond(self, age: int, level: int) -> FloatArray:
        """How far the output went in every block beyond what the equations alone expect, until most of it."""
        blocks = list(self.tracked.blocks)[-age:]
        belief = blocks[0].before[level]
        gone = [0.0]
        for block, after in itertools.pairwise(blocks):
            belief, _ = self.tracker.run(belief, block.stretch.unseen, level)
            expected, _ = self.tracker.expected(
                belief, after.stretch.disturbances[0], after.stretch.input[:1]
            )
            gone.append(float(after.stretch.output[2]) - expected)
        return np.diff(gone[: int(np.nanargmax(np.abs(gone))) + 1])

    @property
    def before(self) -> Sequence[Belief]:
        """What was believed before the change returned last, at every level."""
        assert self._best is not None  # noqa: S101 — only a returned change is asked about
        return self.tracked.blocks[-self._best[1].age].before

    def adopt(self, before: Sequence[Belief] = ()) -> None:
        """Accept the change returned last as the new state of the plant; `before`: it is what it was then."""
        assert self._best is not None  # noqa: S101 — only a returned change is adopted
        self.tracked.adopt(self._best[1].belief, before)
        self._reset()

    def _reset(self) -> None:
        self._best = None
        self._courses: dict[tuple[Hypothesis, int, int], _Course] = {}
        self._idle = self._asking = 0
        self._clear()

    def _clear(self) -> None:
        """Look for jumps from now on only."""
        n = self.tracker.size
        kinds = len(self._jumps)
        starts = REACH // _EVERY
        self._traces = Traces(
            np.zeros((n, kinds, starts)), np.zeros((kinds, starts)), np.zeros((kinds, starts))
        )
        self._started = np.full(starts, -1)  # block count of each start

    def _start(self) -> None:
        """Start the traces of a jump that happens now."""
        start = self.tracked.count // _EVERY % self._started.size
        self._started[start] = self.tracked.count
        for array in self._traces:
            array[..., start] = 0.0
        for k, jump in enumerate(self._jumps):
            self._traces.effects[jump.index, k, start] = 1.0

    def _search(self) -> DetectedChange | None:
        """The change, if a jump of any number saves more than it costs."""
        count = self.tracked.count
        longest = len(self.tracked.blocks)
        spreads = np.array([[max(h.spread, abs(h.shift))] for h in self._jumps]) ** 2
        hits = self._traces.hits
        weights = self._traces.weights
        worth = 0.5 * hits**2 / (weights + 1.0 / spreads) - 0.5 * np.log1p(weights * spreads)
        age = count - self._started
        fits = (self._started >= 0) & (age >= _MIN_AGE) & (age <= longest)
        worth = np.where(fits, worth, 0.0)
        stepped = self._stepped
        if worth.max() < _WORTH * self.track_record.dispersion and self._best is None and not stepped:
            self._asking = 0
            return None
        self._idle += 1
        if self._idle < min(1 + self._asking // _PATIENCE, _RAREST):
            return None
        self._idle = 0
        self._asking = self._asking + 1
        best = stepped or int(age[np.argmax(worth.max(axis=0))])
        ages = {best - _EVERY, best, best + _EVERY}
        if self._best is not None:
            ages.add(round((self.tracked.blocks[-1].first - self._best[0].first) / self.tracked.size) + 1)
        kept = sorted(a for a in ages if _MIN_AGE <= a <= longest)
        return self._compare(kept) if kept else None

    @property
    def _stepped(self) -> int:
        """Age of the newest block with a step of the reading that may be a shift, blocks; 0 without one.

        Such a step may be taken for an outlier, and leave no trace.
        """
        blocks = list(self.tracked.blocks) if self._steps or self._back else []
        for age in range(_MIN_AGE, min(_STEP_AGE, len(blocks)) + 1):
            if np.abs(np.diff(blocks[-age].stretch.output[1:])).max() >= self._offset.least:
                return age
        return 0

    def _compare(self, ages: Sequence[int]) -> DetectedChange | None:
        """Compare every hypothesis of a change, `ages` blocks ago, with no change."""
        nothing, before = self.tracked.unchanged()
        dispersion = self.track_record.dispersion
        found: dict[Fault, _Found] = {}

        def saved(cost: float, age: int) -> float:
            """What a code for the blocks since then saves, in nats that count."""
            return (nothing - float(before[-age - 1]) - cost) / dispersion

        likely = [*self.hypotheses, *([self._back] if self._back else [])]
        blocks = list(self.tracked.blocks)
        oldest = len(self.tracked.blocks)
        self._courses = {key: one for key, one in self._courses.items() if key[1] >= blocks[0].first}
        stretches = {age: joined(blocks[-age:]) for age in ages}
        for age, h, level in itertools.product(ages, likely, self.tracked.levels):
            if level > self.tracked.level and (h.ceases or h.fault not in _LESS_ACCURATE):
                continue
            belief, cost = self._run(h, age, level, stretches[age])
            gain = saved(cost, age)
            if h.fault not in found or gain > found[h.fault].gain:
                found[h.fault] = _Found(gain, h, age, level, belief)
        order = sorted(found.values(), key=lambda f: -f.gain)
        if self._passed(found[Fault.DISTURBANCE]):  # then a number that has come back has not changed
            order = [f for f in order if f.hypothesis.fault is Fault.DISTURBANCE or not self._came_back(f)]
        else:
            order = [f for f in order if f.hypothesis.fault is not Fault.DISTURBANCE]
        gain, h, age, level, belief = order[0]
        if gain < _WORTH:
            self._best = None
            return None
        # The hour in which it began, when in it, and what has changed have to be said, too.
        gain -= code_length_of(1 + self.tracked.known // _HOUR) + math.log(_HOUR / _EVERY * len(found))
        if gain > 0.0 and not self._steps:  # behind a lag, the inputs come with the delay that suits them
            cost, late = self._lateness(age, stretches[age])
            gain -= _COARSE * max(0.0, saved(cost, age))
            if gain < 0.0 and age >= _ABSORBED_AFTER:
                self.tracked.adopt(late)
                self._reset()
                return None
        # A change has an onset; one that explains as much from long before was there from the start.
        dated = oldest
        if oldest - age >= 2 * _EVERY:
            early, cost = self._run(h, oldest, level, joined(blocks))
            if saved(cost, oldest) > order[0].gain - _WORTH:
                belief = early
                dated = 0
        onset = blocks[-age]
        change = DetectedChange(
            hypothesis=h,
            gain=gain,
            lead=order[0].gain - max([0.0, *(f.gain for f in order[1:])]),
            first=onset.first,
            before=float(onset.before[self.tracked.level].values[h.index]),
            value=float(belief.values[h.index]),
            begun=dated > 0,
            rivals=tuple(f.hypothesis.fault for f in order[1:]),
            gains=tuple(f.gain - (order[0].gain - gain) for f in order[1:]),
            off=self._shift(found[Fault.SENSOR_DRIFT]),
        )
        self._best = (change, order[0]._replace(belief=belief))
        return change

    def _lateness(self, age: int, stretch: Readings) -> tuple[float, Belief]:
        """Code length of the last blocks' readings if nothing has changed, but inputs act later than the
        equations say, and the belief after it."""
        blocks = list(self.tracked.blocks)
        inputs = np.concatenate([b.stretch.input for b in blocks])
        rivals = list(later_inputs(inputs, stretch.input.size, self._second))
        runs = (
            self.tracker.run(blocks[-age].before[level], stretch._replace(input=late), level)
            for late, level in itertools.product(rivals, self.tracked.levels)
        )
        belief, cost = min(runs, key=lambda run: run[1])
        return cost + math.log(len(rivals)), belief

    def _passed(self, found: _Found) -> bool:
        """Whether something has pushed the output and ceased."""
        return found.gain >= _WORTH and self._came_back(found)

    def _came_back(self, found: _Found) -> bool:
        """Whether a number is nearly where it was before."""
        h = found.hypothesis
        return h.ceases or abs(self._shift(found)) < _CAME_BACK * h.least

    def _shift(self, found: _Found) -> float:
        """By how much a number has changed."""
        before = self.tracked.blocks[-found.age].before[self.tracked.level]
        return float((found.belief.values - before.values)[found.hypothesis.index])

    def _run(self, h: Hypothesis, age: int, level: int, stretch: Readings) -> tuple[Belief, float]:
        """The belief after the last blocks under a hypothesis at a level, and their readings' code length."""
        onset = self.tracked.blocks[-age]
        key = h, onset.first, level
        if key not in self._courses:
            self._courses[key] = self._course(h, onset.before[level], level, stretch)
        return self._courses[key](stretch)

    def _course(self, h: Hypothesis, before: Belief, level: int, stretch: Readings) -> _Course:
        """The same for the readings since an onset: at first these, later more of them."""
        tracker = self.tracker
        size = self.tracked.size
        if h.at_once:
            came = stretch.output[: 2 + _EVERY * size]
            return self._jumped(h, before, stretch, int(np.nanargmax(np.abs(np.diff(came[1:])))), level)
        if h.fault is Fault.DRIVE_LOST:
            places = np.linspace(0, _EVERY * size, _ONSETS, endpoint=False).astype(int)
            jumps = [self._jumped(h, before, stretch, int(place), level) for place in places]
            return lambda readings: min((to(readings) for to in jumps), key=lambda one: one[1])
        if h.ceases:
            return self._ceased(h, before, level)
        if h.slowly:
            opened = before.opened(tracker.rate, 0.0, h.spread / h.slowly)
            return self._rising(h, TrackedCourse(tracker, opened, level, rising=h.index))
        drift = np.zeros(tracker.size)
        half = math.sqrt(0.5) * h.spread
        drift[h.index] = half / math.sqrt(h.lasting)
        opened = before.opened(h.index, h.shift, half)
        lasting = round(h.lasting / self._period)
        return TrackedCourse(tracker, opened, level, opened=drift, lasting=lasting).to

    def _rising(self, h: Hypothesis, course: TrackedCourse) -> _Course:
        """The same if a number changes evenly."""

        def to(readings: Readings) -> tuple[Belief, float]:
            belief, cost = course.to(readings)
            return belief.closed(self.tracker.rate), cost + h.price

        return to

    def _ceased(self, h: Hypothesis, before: Belief, level: int) -> _Course:
        """The same if a number changes, and is as before since the moment that explains most."""
        at = h.index
        step = _EVERY * self.tracked.size
        spread = math.sqrt(before.covariance[at, at])
        belief = before.opened(at, h.shift, h.spread)
        begun = 0.0
        since: list[tuple[float, TrackedCourse]] = []  # and the code length of the readings until then

        def to(readings: Readings) -> tuple[Belief, float]:
            nonlocal belief, begun
            for end in range(step * (1 + len(since)), len(readings.input), step):
                belief, cost = self.tracker.run(belief, readings.part(end - step, end), level)
                begun += cost
                after = belief.closed(at).opened(at, before.values[at], spread)
                since.append((begun, TrackedCourse(self.tracker, after, level)))
            found = []
            for end, (until, course) in zip(itertools.count(step, step), since, strict=False):
                after, rest = course.to(readings.part(end, len(readings.input)))
                found.append((after, until + rest + h.price))
            return min(found, key=lambda one: one[1], default=(before, math.inf))

        return to

    def _jumped(self, h: Hypothesis, before: Belief, stretch: Readings, place: int, level: int) -> _Course:
        """The same if a number jumps before the reading at this place."""
        belief = before
        begun = 0.0
        if place > 0:
            belief, begun = self.tracker.run(belief, stretch.part(0, place), level)
        course = TrackedCourse(self.tracker, belief.opened(h.index, h.shift, h.spread), level)

        def to(readings: Readings) -> tuple[Belief, float]:
            after, rest = course.to(readings.part(place, len(readings.input)))
            return after, begun + rest + h.price

        return to


def code_length_of(number: int) -> float:
    """Length of a code for a whole number from 1 on, in nats.

    Rissanen's universal prior (Annals of Statistics 11, 1983), whose probabilities add up to 1.
    """
    bits = math.log2(_UNIVERSAL)
    rest = math.log2(max(number, 1))
    while rest > 0.0:
        bits = bits + rest
        rest = math.log2(rest)
    return bits * math.log(2.0)
