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
from collections.abc import Callable, Iterator, Mapping, Sequence
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
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray, Sample

_LOSSES: Final = ((math.log(1 / 6), 0.8), (math.log(3.0), 0.6))
"""A fan that fails, a lid that opens: logarithm of the factor, and its spread."""


class _Spreads(Rule):
    """Spreads of the changes that are expected."""

    room: float = 0.8
    """Of a change of the room, in the scale of the parameter."""
    heat: float = 2.5
    """Of heat from elsewhere, which acts as another room would, in the same scale."""
    share: float = 0.3
    """Of a change of the drive's share."""
    lost: float = 0.1
    """Of what a lost drive lacks of its share."""
    offset: float = 30.0
    """Of an offset of the reading, in standard deviations of its noise."""
    push: float = 1.0
    """Of a push, in standard deviations of the noise per sample."""


_SPREADS: Final = _Spreads()


class _ChangeSearch(Rule):
    """When changes are looked for, and which of them count."""

    onsets: int = 4
    """Number of moments tried for a lost drive between two at which other changes may have begun."""
    every: int = 2
    """Spacing of the moments at which a change may have begun or ceased, blocks."""
    hour: int = 360
    """Blocks of an hour of a plant as fast as the rig."""
    youngest: int = 3
    """Least age of a change that is reported, blocks."""
    step_age: int = 10
    """Greatest age up to which a step of the reading alone is a reason to look for a change, blocks."""
    came_back: float = 0.5
    """Share of the smallest change worth reporting below which a number has come back."""
    learn: int = 30
    """Blocks that must be seen before a change is reported."""
    worth: float = 4.0
    """Nats that a jump must save before the tracker is run for each hypothesis, and by which one onset
    must beat another to count as the beginning of the change."""
    patience: int = 12
    """Comparisons without result after which they are made less often."""
    rarest: int = 6
    """Most blocks between two comparisons."""


_SEARCH: Final = _ChangeSearch()


_PASSING: Final = ((3.0, 30.0), (12.0, 30.0), (3.0, 90.0))
"""Spread of a push that passes, in standard deviations of the noise per sample, and the time after its onset,
s, within which it changes. A short push may be stronger."""


class _SlowCourse(Rule):
    """Changes that grow evenly."""

    time: float = 300.0
    """Time in which one covers its spread, s."""
    room_time: float = 1800.0
    """Time in which one of the room covers its spread, s: a failed fan warms the sink in minutes; the
    room never changes so fast."""
    price: float = 2.5
    """Prior cost of a change that grows evenly over minutes, nats: fans fail at once and fail far more
    often, and the sink's response to that looks much the same."""


_SLOW_COURSE: Final = _SlowCourse()


_MIN_SIZE: Final = {
    Fault.LOSSES_CHANGED: 0.4,
    Fault.ROOM_CHANGED: 0.3,
    Fault.DRIVE_WEAK: 0.08,
    Fault.DRIVE_LOST: 0.6,
    Fault.SENSOR_DRIFT: 10.0,
    Fault.DRIFT: 0.3,
    Fault.DISTURBANCE: 0.5,
}
"""Changes smaller than this, in the units of their `_Spreads`, are not reported."""


@dataclass(frozen=True)
class Hypothesis:
    """One number of a belief has changed."""

    fault: Fault
    """What it would be."""
    index: int
    """Index of that number in the belief."""
    shift: float
    """Expected size of the change."""
    spread: float
    """Standard deviation of that size."""
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
    """Whether it has ceased since: the number is what it was before."""


@dataclass(frozen=True)
class DetectedChange:
    """The change that explains the samples best."""

    hypothesis: Hypothesis
    gain: float
    """How much better it explains the readings since than no change does, in nats."""
    lead: float
    """How much better it explains them than the best change of any other kind does, in nats."""
    first: int
    """Sample at which it began."""
    before: float
    """Value of the number before the change, in the belief's units."""
    value: float
    """Its value now."""
    begun: bool
    """Whether it began at `first`; False if it may have been there from the start."""
    rivals: tuple[Fault, ...] = ()
    """The other kinds, best first."""
    gains: tuple[float, ...] = ()
    """What each of the other kinds gains."""
    off: float = 0.0
    """By how much the readings would have shifted if a shift were the change, in the output's unit."""

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


def hypotheses(
    tracker: Tracker, noise: float, period: float, *, steps: bool
) -> Sequence[Hypothesis]:
    """The hypotheses for one plant: for parameters with a role in its file, and those of every plant.

    `steps`: whether only a sensor that has shifted makes a step of the reading. A camera that corrects itself
    makes some when it is healthy.
    """
    scale = slow_scale(tracker.parameters.model.plant, period)
    roles = _changes_of_roles(tracker)
    rooms = [h for h in roles if h.fault is Fault.ROOM_CHANGED]
    slow_rooms = [
        replace(h, slowly=_SLOW_COURSE.room_time, price=_SLOW_COURSE.price)
        for h in rooms
    ]
    passing = _passing(tracker, noise / (scale if scale > 1.0 else time_scale(period)))
    changes = [*roles, *slow_rooms]
    if steps:
        changes.append(_lost_drive(tracker))
    changes += _changes_of_every_plant(tracker, noise, period)
    if steps:
        changes += [
            replace(h, at_once=True)
            for h in changes
            if h.fault is Fault.SENSOR_DRIFT and not h.slowly
        ]
    changes += passing
    if steps:
        for room in rooms:
            changes += _heat_like(room, passing[0].least)
    return [
        replace(h, lasting=h.lasting * scale, slowly=h.slowly * scale) for h in changes
    ]


def _changes_of_roles(tracker: Tracker) -> list[Hypothesis]:
    """Sudden changes of parameters with a role in the plant's file."""
    changes: list[Hypothesis] = []
    for name in tracker.free:
        declared = tracker.parameters.model.declared[name]
        logged = bool(tracker.logged[tracker.free.index(name)])
        if declared.role == TRAITS[Fault.LOSSES_CHANGED].role and logged:
            least = _MIN_SIZE[Fault.LOSSES_CHANGED]
            for shift, spread in _LOSSES:
                changes.append(
                    Hypothesis(
                        Fault.LOSSES_CHANGED,
                        tracker.at[name],
                        shift,
                        spread,
                        least,
                        name,
                    )
                )
        if declared.role == TRAITS[Fault.ROOM_CHANGED].role:
            scale = 0.05 if logged else declared.scale
            least = _MIN_SIZE[Fault.ROOM_CHANGED] * scale
            changes.append(
                Hypothesis(
                    Fault.ROOM_CHANGED,
                    tracker.at[name],
                    0.0,
                    _SPREADS.room * scale,
                    least,
                    name,
                )
            )
    return changes


def _lost_drive(tracker: Tracker) -> Hypothesis:
    """The drive has no effect any longer, from one of some moments on."""
    price = math.log(_SEARCH.onsets)
    return Hypothesis(
        Fault.DRIVE_LOST,
        tracker.share,
        -1.0,
        _SPREADS.lost,
        _MIN_SIZE[Fault.DRIVE_LOST],
        price=price,
    )


def _changes_of_every_plant(
    tracker: Tracker, noise: float, period: float
) -> Iterator[Hypothesis]:
    """Changes of the drive's share and of the reading, at once or slowly, and an unnamed push."""
    for fault, index, unit, spread in (
        (Fault.DRIVE_WEAK, tracker.share, 1.0, _SPREADS.share),
        (Fault.SENSOR_DRIFT, tracker.offset, noise, _SPREADS.offset),
        (Fault.DRIFT, tracker.push, noise / period, _SPREADS.push),
    ):
        sudden = Hypothesis(fault, index, 0.0, spread * unit, _MIN_SIZE[fault] * unit)
        yield sudden
        if fault is not Fault.DRIFT:
            yield replace(sudden, slowly=_SLOW_COURSE.time, price=_SLOW_COURSE.price)


def _passing(tracker: Tracker, unit: float) -> list[Hypothesis]:
    """Pushes that pass, in units of the noise per sample."""
    least = _MIN_SIZE[Fault.DISTURBANCE] * unit
    return [
        Hypothesis(
            Fault.DISTURBANCE, tracker.fading, 0.0, spread * unit, least, lasting=time
        )
        for spread, time in _PASSING
    ]


def _heat_like(room: Hypothesis, least: float) -> Iterator[Hypothesis]:
    """Heat from elsewhere, which acts as another room would, for good or until it ceases.

    `least` is the smallest passing push worth reporting.
    """
    heat = replace(room, spread=_SPREADS.heat / _SPREADS.room * room.spread, vague=True)
    yield heat
    yield replace(heat, fault=Fault.DISTURBANCE, least=least, ceases=True)


_LESS_ACCURATE: Final = frozenset(
    {Fault.LOSSES_CHANGED, Fault.ROOM_CHANGED, Fault.DRIFT, Fault.DISTURBANCE}
)
"""Changes after which the equations may be less accurate than before, as they may without a change: the air
in an open box is no longer one lump. A sensor offset or a weak drive leaves their accuracy as it was."""


class _LateInputs(Rule):
    """How inputs that act later than the equations say compete with changes."""

    coarse: float = 2.0
    """Factor on what a late input saves: those that are tried are pure delays or lags, some seconds
    apart, and a plant that has both, or one in between, is explained better by its own."""
    absorbed_after: int = 24
    """Age from which on what a late input explains is taken for how the plant is, blocks: before long,
    its onset is out of reach, and its trace would look like a change that came later."""


_LATE_INPUTS: Final = _LateInputs()


_UNIVERSAL: Final = 2.865064
"""Sum over all whole numbers n of 1 / (n log₂ n log₂ log₂ n …), as far as the factors are positive."""


class _BestOfKind(NamedTuple):
    """The best hypothesis of one kind."""

    gain: float
    """What it saves, in nats that count."""
    hypothesis: Hypothesis
    age: int
    """Blocks since its onset."""
    level: int
    """Index of the level of model error at which it saves most."""
    belief: Belief
    """After all readings."""


class _Unchanged(NamedTuple):
    """Code lengths of the readings if nothing has changed, nats."""

    total: float
    before: FloatArray
    """Of the blocks up to each one, shape (N,)."""
    dispersion: float
    """By how much evidence is divided."""

    def saved(self, cost: float, age: int) -> float:
        """What a code of this length for the blocks of an age saves, in nats that count."""
        return (self.total - float(self.before[-age - 1]) - cost) / self.dispersion


_Course = Callable[[Readings], tuple[Belief, float]]
"""The belief after all readings since an onset under a hypothesis, and their code length; called with more
and more readings, of which each is tracked once."""


def _cost_of(explanation: tuple[Belief, float]) -> float:
    """Code length of the readings, nats."""
    return explanation[1]


class ChangeDetector:
    """Tracks one plant and detects what has changed."""

    def __init__(
        self, parameters: Parameters, period: float, *, steps: bool = False
    ) -> None:
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
        self._expected_back: Hypothesis | None = None
        lasting = [
            h
            for h in self.hypotheses
            if h.fault is not Fault.DISTURBANCE and not h.vague
        ]
        self._jumps = list({h.index: h for h in lasting}.values())
        self._offset = next(h for h in self.hypotheses if h.fault is Fault.SENSOR_DRIFT)
        self._best: tuple[DetectedChange, _BestOfKind] | None = None
        self.changed = False
        """Whether a change of the plant is known that may be undone: its forecasts say nothing of the
        twin."""
        self._changed_at = -HORIZONS[-1]  # the last block of a changed plant
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
        return self.tracked.known >= _SEARCH.learn and not self.tracked.blind

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
        return float(
            belief.values[self.tracker.fading] + belief.values[self.tracker.push]
        )

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
        self._expected_back = step if shift else None

    def push(self, sample: Sample) -> DetectedChange | None:
        """Take a sample; when a block is full, return the change, if any."""
        stretch = self.tracked.full(sample)
        if stretch is None:
            return None
        if self.tracked.count % _SEARCH.every == 0:
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
            newcomer = tracked.known < _SEARCH.learn
            self.track_record.push(
                tracked.blocks, tracked.count, tracked.level, newcomer=newcomer
            )

    def pushes(self) -> FloatArray:
        """What has passed: how far it pushed the output in every block since its onset, in its unit."""
        assert self._best is not None  # noqa: S101
        _, h, age, level, _ = self._best[1]
        if h.ceases:
            return self._beyond(age, level)
        blocks = list(self.tracked.blocks)[-age:]
        size = self.tracked.size
        stretch = joined(blocks)
        course = self._course(h, blocks[0].before[level], level, stretch)
        beliefs = (
            course(stretch.part(0, size * count))[0] for count in range(1, age + 1)
        )
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
        assert self._best is not None  # noqa: S101
        return self.tracked.blocks[-self._best[1].age].before

    def adopt(self, before: Sequence[Belief] = ()) -> None:
        """Accept the change returned last as the new state of the plant; `before`: it is what it was then."""
        assert self._best is not None  # noqa: S101
        self.tracked.adopt(self._best[1].belief, before)
        self._reset()

    def _reset(self) -> None:
        self._best = None
        self._courses: dict[tuple[Hypothesis, int, int], _Course] = {}
        self._blocks_waited = 0  # since the last comparison
        self._comparisons = 0  # since jumps were last worth nothing
        self._clear()

    def _clear(self) -> None:
        """Look for jumps from now on only."""
        n = self.tracker.size
        kinds = len(self._jumps)
        starts = REACH // _SEARCH.every
        self._traces = Traces(
            np.zeros((n, kinds, starts)),
            np.zeros((kinds, starts)),
            np.zeros((kinds, starts)),
        )
        self._started = np.full(starts, -1)  # block count of each start

    def _start(self) -> None:
        """Start the traces of a jump that happens now."""
        start = self.tracked.count // _SEARCH.every % self._started.size
        self._started[start] = self.tracked.count
        for array in self._traces:
            array[..., start] = 0.0
        for k, jump in enumerate(self._jumps):
            self._traces.effects[jump.index, k, start] = 1.0

    def _search(self) -> DetectedChange | None:
        """The change, if a jump of any number saves more than it costs."""
        count = self.tracked.count
        longest = len(self.tracked.blocks)
        age = count - self._started
        is_possible = (
            (self._started >= 0) & (age >= _SEARCH.youngest) & (age <= longest)
        )
        worth = np.where(is_possible, self._worth_of_jumps(), 0.0)
        stepped = self._stepped
        no_jump = worth.max() < _SEARCH.worth * self.track_record.dispersion
        if no_jump and self._best is None and not stepped:
            self._comparisons = 0
            return None
        self._blocks_waited += 1
        if self._blocks_waited < min(
            1 + self._comparisons // _SEARCH.patience, _SEARCH.rarest
        ):
            return None
        self._blocks_waited = 0
        self._comparisons = self._comparisons + 1
        likeliest = stepped or int(age[np.argmax(worth.max(axis=0))])
        ages = {likeliest - _SEARCH.every, likeliest, likeliest + _SEARCH.every}
        if self._best is not None:
            ages.add(
                round(
                    (self.tracked.blocks[-1].first - self._best[0].first)
                    / self.tracked.size
                )
                + 1
            )
        ages_to_compare = sorted(a for a in ages if _SEARCH.youngest <= a <= longest)
        return self._compare(ages_to_compare) if ages_to_compare else None

    def _worth_of_jumps(self) -> FloatArray:
        """What a jump of each number at each moment saves, nats, shape (numbers, moments)."""
        spreads = np.array([[max(h.spread, abs(h.shift))] for h in self._jumps]) ** 2
        hits = self._traces.hits
        weights = self._traces.weights
        worth = 0.5 * hits**2 / (weights + 1.0 / spreads) - 0.5 * np.log1p(
            weights * spreads
        )
        return np.asarray(worth, dtype=np.float64)

    @property
    def _stepped(self) -> int:
        """Age of the newest block with a step of the reading that may be a shift, blocks; 0 without one.

        Such a step may be taken for an outlier, and leave no trace.
        """
        blocks = list(self.tracked.blocks) if self._steps or self._expected_back else []
        for age in range(_SEARCH.youngest, min(_SEARCH.step_age, len(blocks)) + 1):
            if (
                np.abs(np.diff(blocks[-age].stretch.output[1:])).max()
                >= self._offset.least
            ):
                return age
        return 0

    def _compare(self, ages: Sequence[int]) -> DetectedChange | None:
        """Compare every hypothesis of a change, `ages` blocks ago, with no change."""
        total, before = self.tracked.unchanged()
        unchanged = _Unchanged(total, before, self.track_record.dispersion)
        blocks = list(self.tracked.blocks)
        self._courses = {
            key: course
            for key, course in self._courses.items()
            if key[1] >= blocks[0].first
        }
        stretches = {age: joined(blocks[-age:]) for age in ages}
        best_of = self._best_of_each_kind(stretches, unchanged)
        best, *rivals = self._in_order(best_of)
        if best.gain < _SEARCH.worth:
            self._best = None
            return None
        gain = best.gain - self._cost_of_saying(len(best_of))
        if gain > 0.0 and not self._steps:
            # behind a lag, the inputs come with the delay that suits them
            cost, late = self._lateness(best.age, stretches[best.age])
            gain -= _LATE_INPUTS.coarse * max(0.0, unchanged.saved(cost, best.age))
            if gain < 0.0 and best.age >= _LATE_INPUTS.absorbed_after:
                self.tracked.adopt(late)
                self._reset()
                return None
        from_the_start = self._from_the_start(best, unchanged)
        if from_the_start is not None:
            best = best._replace(belief=from_the_start)
        h = best.hypothesis
        onset = blocks[-best.age]
        change = DetectedChange(
            hypothesis=h,
            gain=gain,
            lead=best.gain - max([0.0, *(f.gain for f in rivals)]),
            first=onset.first,
            before=float(onset.before[self.tracked.level].values[h.index]),
            value=float(best.belief.values[h.index]),
            begun=from_the_start is None,
            rivals=tuple(f.hypothesis.fault for f in rivals),
            gains=tuple(f.gain - (best.gain - gain) for f in rivals),
            off=self._shift(best_of[Fault.SENSOR_DRIFT]),
        )
        self._best = (change, best)
        return change

    def _cost_of_saying(self, kinds: int) -> float:
        """Code length of the hour in which a change began, of when in it, and of which kind it is, nats."""
        hour = code_length_of(1 + self.tracked.known // _SEARCH.hour)
        return hour + math.log(_SEARCH.hour / _SEARCH.every * kinds)

    def _best_of_each_kind(
        self, stretches: Mapping[int, Readings], unchanged: _Unchanged
    ) -> dict[Fault, _BestOfKind]:
        """The hypothesis of each kind that saves most, at one of these ages and a level."""
        best_of: dict[Fault, _BestOfKind] = {}
        likely = [
            *self.hypotheses,
            *([self._expected_back] if self._expected_back else []),
        ]
        for age, h, level in itertools.product(stretches, likely, self.tracked.levels):
            if level > self.tracked.level and (
                h.ceases or h.fault not in _LESS_ACCURATE
            ):
                continue
            belief, cost = self._run(h, age, level, stretches[age])
            gain = unchanged.saved(cost, age)
            if h.fault not in best_of or gain > best_of[h.fault].gain:
                best_of[h.fault] = _BestOfKind(gain, h, age, level, belief)
        return best_of

    def _in_order(self, best_of: Mapping[Fault, _BestOfKind]) -> list[_BestOfKind]:
        """The kinds that count, the best first: where something has passed, no number that has come back."""
        order = sorted(best_of.values(), key=lambda f: -f.gain)
        if self._passed(best_of[Fault.DISTURBANCE]):
            return [
                f
                for f in order
                if f.hypothesis.fault is Fault.DISTURBANCE or not self._came_back(f)
            ]
        return [f for f in order if f.hypothesis.fault is not Fault.DISTURBANCE]

    def _from_the_start(
        self, best: _BestOfKind, unchanged: _Unchanged
    ) -> Belief | None:
        """The belief if the change was there from the start; None if it has an onset.

        A change that explains as much from long before was there from the start.
        """
        oldest = len(self.tracked.blocks)
        if oldest - best.age < 2 * _SEARCH.every:
            return None
        belief, cost = self._run(
            best.hypothesis, oldest, best.level, joined(list(self.tracked.blocks))
        )
        return (
            belief
            if unchanged.saved(cost, oldest) > best.gain - _SEARCH.worth
            else None
        )

    def _lateness(self, age: int, stretch: Readings) -> tuple[float, Belief]:
        """Code length of the last blocks' readings if nothing has changed, but inputs act later than the
        equations say, and the belief after it."""
        blocks = list(self.tracked.blocks)
        inputs = np.concatenate([b.stretch.input for b in blocks])
        rivals = list(later_inputs(inputs, stretch.input.size, self._second))
        runs = (
            self.tracker.run(
                blocks[-age].before[level], stretch._replace(input=late), level
            )
            for late, level in itertools.product(rivals, self.tracked.levels)
        )
        belief, cost = min(runs, key=lambda run: run[1])
        return cost + math.log(len(rivals)), belief

    def _passed(self, candidate: _BestOfKind) -> bool:
        """Whether something has pushed the output and ceased."""
        return candidate.gain >= _SEARCH.worth and self._came_back(candidate)

    def _came_back(self, candidate: _BestOfKind) -> bool:
        """Whether a number is nearly where it was before."""
        h = candidate.hypothesis
        return h.ceases or abs(self._shift(candidate)) < _SEARCH.came_back * h.least

    def _shift(self, candidate: _BestOfKind) -> float:
        """By how much a number has changed."""
        before = self.tracked.blocks[-candidate.age].before[self.tracked.level]
        return float(
            (candidate.belief.values - before.values)[candidate.hypothesis.index]
        )

    def _run(
        self, h: Hypothesis, age: int, level: int, stretch: Readings
    ) -> tuple[Belief, float]:
        """The belief after the last blocks under a hypothesis at a level, and their readings' code length."""
        onset = self.tracked.blocks[-age]
        key = h, onset.first, level
        if key not in self._courses:
            self._courses[key] = self._course(h, onset.before[level], level, stretch)
        return self._courses[key](stretch)

    def _course(
        self, h: Hypothesis, before: Belief, level: int, stretch: Readings
    ) -> _Course:
        """How the plant runs under a hypothesis since an onset: through these readings at first, later
        through more."""
        tracker = self.tracker
        size = self.tracked.size
        if h.at_once:
            first_readings = stretch.output[: 2 + _SEARCH.every * size]
            largest_step = int(np.nanargmax(np.abs(np.diff(first_readings[1:]))))
            return self._jumped(h, before, stretch, largest_step, level)
        if h.fault is Fault.DRIVE_LOST:
            places = np.linspace(
                0, _SEARCH.every * size, _SEARCH.onsets, endpoint=False
            ).astype(int)
            jumps = [
                self._jumped(h, before, stretch, int(place), level) for place in places
            ]
            return lambda readings: min(
                (jump(readings) for jump in jumps), key=_cost_of
            )
        if h.ceases:
            return self._ceased(h, before, level)
        if h.slowly:
            opened = before.opened(tracker.rate, 0.0, h.spread / h.slowly)
            return self._rising(
                h, TrackedCourse(tracker, opened, level, rising=h.index)
            )
        drift = np.zeros(tracker.size)
        half = math.sqrt(0.5) * h.spread
        drift[h.index] = half / math.sqrt(h.lasting)
        opened = before.opened(h.index, h.shift, half)
        lasting = round(h.lasting / self._period)
        return TrackedCourse(tracker, opened, level, opened=drift, lasting=lasting).to

    def _rising(self, h: Hypothesis, course: TrackedCourse) -> _Course:
        """The course under a hypothesis by which a number changes evenly."""

        def to(readings: Readings) -> tuple[Belief, float]:
            belief, cost = course.to(readings)
            return belief.closed(self.tracker.rate), cost + h.price

        return to

    def _ceased(self, h: Hypothesis, before: Belief, level: int) -> _Course:
        """The course if a number changes, and is as before since the moment that explains most."""
        number = h.index
        step = _SEARCH.every * self.tracked.size
        spread = math.sqrt(before.covariance[number, number])
        belief = before.opened(number, h.shift, h.spread)
        begun = 0.0
        # and the code length of the readings until then
        since: list[tuple[float, TrackedCourse]] = []

        def to(readings: Readings) -> tuple[Belief, float]:
            nonlocal belief, begun
            for end in range(step * (1 + len(since)), len(readings.input), step):
                belief, cost = self.tracker.run(
                    belief, readings.part(end - step, end), level
                )
                begun += cost
                after = belief.closed(number).opened(
                    number, before.values[number], spread
                )
                since.append((begun, TrackedCourse(self.tracker, after, level)))
            explanations = []
            for end, (until, course) in zip(
                itertools.count(step, step), since, strict=False
            ):
                after, cost_since = course.to(readings.part(end, len(readings.input)))
                explanations.append((after, until + cost_since + h.price))
            return min(explanations, key=_cost_of, default=(before, math.inf))

        return to

    def _jumped(
        self, h: Hypothesis, before: Belief, stretch: Readings, place: int, level: int
    ) -> _Course:
        """The course if a number jumps before the reading at this place."""
        belief = before
        begun = 0.0
        if place > 0:
            belief, begun = self.tracker.run(belief, stretch.part(0, place), level)
        course = TrackedCourse(
            self.tracker, belief.opened(h.index, h.shift, h.spread), level
        )

        def to(readings: Readings) -> tuple[Belief, float]:
            after, cost_since = course.to(readings.part(place, len(readings.input)))
            return after, begun + cost_since + h.price

        return to


def code_length_of(number: int) -> float:
    """Length of a code for a whole number from 1 on, in nats.

    Rissanen's universal prior (Annals of Statistics 11, 1983), whose probabilities add up to 1.
    """
    bits = math.log2(_UNIVERSAL)
    logarithm = math.log2(max(number, 1))
    while logarithm > 0.0:
        bits = bits + logarithm
        logarithm = math.log2(logarithm)
    return bits * math.log(2.0)
