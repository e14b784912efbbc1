"""The competition: what the readings say for every change, beyond its price, against all that is healthy.

Every change begins again every two seconds, in each level of the healthy mixture that counts; what it saves
of the code of the readings since is its evidence.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from typing import Final, NamedTuple

import numpy as np

from twinmatch.dynamics import Parameters
from twinmatch.dynamics.bank import (
    LEAST_SHARE,
    ChangeRows,
    Reading,
    spawn,
    step,
    tally,
    unborn,
)
from twinmatch.health.acting_inputs import CROSSING
from twinmatch.health.change_table import BETWEEN_ONSETS, ChangeTable
from twinmatch.health.faults import EVERY, HOUR, TRAITS, Fault, Subject
from twinmatch.health.hypotheses import ChangeRow, rows_of
from twinmatch.health.jumps import JumpsOfReadings
from twinmatch.health.mixture import HealthyMixture
from twinmatch.health.reading_through import ReadThrough, Rehearsal
from twinmatch.health.recent_samples import REMEMBERED, RecentSamples
from twinmatch.health.runaway import RUNNING, Runaways
from twinmatch.health.sensors import Jump, LearnedSensor
from twinmatch.health.suspects import Suspect, suspected_sensor
from twinmatch.settings import Rule
from twinmatch.signals import BoolArray, FloatArray, Sample

_INEXACT: Final = 3.0
"""Times the expected squared errors from which on equations are inexact: kits that their file describes come to
1.3, those of the package `tclab` to 5 where set-points have moved, a fermenter in a file of lags to 4.6."""


class _ReadingThrough(Rule):
    """When it is known what an estimate without a sensor is worth; times in s of a plant as fast as the rig."""

    rehearsed: float = 300.0
    """Time from which on the plant is known well enough to read through a sensor."""
    known_well: float = 900.0
    """Time from which on a rehearsal shows what later estimates are worth: what begins before is off by 1.5 to 2.5 °C
    on a kit whose later rehearsals are off by 0.1 to 0.4 °C."""


_READING_THROUGH: Final = _ReadingThrough()


_SLOTS: Final = 6
"""Onsets of every change that are followed in each level."""
_LEAST_LOG_WEIGHT: Final = math.log(0.01)
"""Log-weight of a level from which on changes begin in it."""
_CERTAIN: Final = 2.0
"""Standard deviations of what may cross up to which it may."""
_INTERESTING: Final = -6.0
"""Evidence below which a cause is not looked at, nats."""


class _TracePlaces(NamedTuple):
    """Where traces are in the bank: by level, by row of the table, and then by slot."""

    levels: int
    rows: int

    @property
    def total(self) -> int:
        """Number of traces for which there is room."""
        return self.levels * self.rows * _SLOTS

    def of(self, level: int, row: int) -> range:
        """The places of a row's traces in a level."""
        begin = (level * self.rows + row) * _SLOTS
        return range(begin, begin + _SLOTS)

    def row_of(self, trace: int) -> int:
        """The row of a trace."""
        return trace // _SLOTS % self.rows


class ExpectedEnd(NamedTuple):
    """The end of a change that was named."""

    row: ChangeRow
    """What it ends."""
    before: FloatArray
    """What was believed before that change, shape (N,)."""


class Competition:
    """All hypotheses about one plant; push every sample."""

    def __init__(self, parameters: Parameters, period: float) -> None:
        """Begin with these parameters in the tracked structure; `period` is the sample time, s."""
        self._model = parameters.model
        self.healthy = HealthyMixture(parameters, period)
        self.second = self.healthy.second
        outputs = self._model.plant.outputs.values()
        self.sensors = [
            LearnedSensor(output.noise, output.span, self.second) for output in outputs
        ]
        self._usual = rows_of(self._model)
        self._suspected = False
        self.rehearsals = [Rehearsal(self.second, output.noise) for output in outputs]
        """Of each sensor that is right: how far off it is when it is read through."""
        self.through: dict[int, ReadThrough] = {}
        """Estimates of the outputs whose sensors lie, by their places."""
        self._recent = RecentSamples(self.second, self.healthy.inputs.latest)
        drives = self._model.plant.drives.values()
        limits = np.array([drive.limits for drive in drives])
        self.jumps = JumpsOfReadings(self.sensors, self._recent, np.ptp(limits, axis=1))
        self.runaways = Runaways(
            len(self.sensors), self.second, self._farthest_movements
        )
        self.untaken: set[int] = set()
        """Outputs whose readings no filter takes, as they say nothing of the plant."""
        self.expect_back([])
        self.restart()

    @property
    def drives(self) -> int:
        """Number of drives of the plant."""
        return self.healthy.drives

    @property
    def known(self) -> float:
        """Time since the beginning, in s of a plant as fast as the rig."""
        return self.healthy.known / self.second

    def restart(self) -> None:
        """Start over after a gap, keeping what was learned about the plant."""
        self.count = 0
        """Samples since the last gap."""
        self._recent.restart()
        self.healthy.restart()
        for sensor, rehearsal in zip(self.sensors, self.rehearsals, strict=True):
            sensor.restart()
            rehearsal.drop()
        self.runaways.restart()
        self._clear()

    def _clear(self) -> None:
        """Changes begin from now on only."""
        self._traces.born[:] = -1
        self._totals[:] = -np.inf

    def expect_back(self, ends: list[ExpectedEnd]) -> None:
        """Make the table of changes, with those that may end, and room for their traces."""
        self._ends = ends
        healthy = self.healthy
        self._changes = ChangeTable(self._usual, [end.row for end in ends], healthy)
        self._places = _TracePlaces(healthy.levels, len(self.rows))
        self._traces = unborn(self._places.total, len(healthy.numbers))
        explanations = len(self._changes.explanations)
        self._totals = np.full(explanations, -np.inf)
        self._likeliest = np.zeros(explanations, dtype=np.int64)

    @property
    def rows(self) -> list[ChangeRow]:
        """All changes that may begin now, and the ends of those that were named."""
        return self._changes.rows

    @property
    def table(self) -> ChangeRows:
        """The same as the bank of hypotheses takes them."""
        return self._changes.of_bank

    @property
    def expects_ends_by(self) -> float:
        """By how much the end of a change is expected more than a change that has not begun, nats."""
        return self._changes.expects_ends_by

    def push(self, sample: Sample, values: FloatArray, counts: BoolArray) -> None:
        """Take the readings of a sample, and which of them count."""
        healthy = self.healthy
        is_taken = counts & ~self._are_among(self.untaken)
        if self.count and self.count % self._recent.between_onsets == 0:
            self._begin_traces()
        row = self._model.disturbance_row(sample.disturbances or None)
        u = np.array(sample.inputs)
        self._recent.take(values, np.abs(u - self._model.rest))
        healthy.forecasts.take(sample, values, is_taken)
        healthy.open(values, u, row)
        for sensor, value, is_sound in self._by_sensor(values, counts):
            sensor.read(value, counts=is_sound)
        inputs = healthy.inputs.take(u, healthy.arriving(u))
        reading, variance = self._reading(values, is_taken, inputs, row)
        self._recent.take_arrived(reading.crossing.copy())
        step(
            self._model.kernels.code,
            healthy.fixed,
            healthy.members,
            self._traces,
            self.table,
            healthy.levels,
            reading,
            self.count,
        )
        is_repeated = np.array([sensor.repeated for sensor in self.sensors])
        healthy.forecasts.take_fresh(values, variance, is_taken & ~is_repeated)
        self._rehearse(reading, variance)
        self._estimate(reading, variance)
        self._weigh(values, is_taken)
        healthy.forecasts.compare(
            values,
            variance,
            all_count=bool(is_taken.all()),
            count=self.count,
            known=healthy.known,
            best=healthy.best,
            reach=self._recent.reach,
        )
        self._learn(values, counts)
        self.count += 1
        healthy.known += 1
        noise = np.array([sensor.noise for sensor in self.sensors])
        self.runaways.take(values, counts, np.maximum(noise, self._model.noise))

    def _farthest_movements(self) -> tuple[FloatArray, FloatArray]:
        """By how much the plant, as it was believed to be before, lets each output fall and rise at most while readings
        run away, shape (o,) each."""
        before = self.believed_before(self.count - self.runaways.lasts)
        since = REMEMBERED.before + RUNNING.lasts
        return self.healthy.farthest_movements(before, since, RUNNING.lasts)

    def run_away(self, samples: int) -> list[int]:
        """Outputs whose readings have run away for so many samples, which the equations forecast well before; with
        one, those that begin to."""
        if self.known < _READING_THROUGH.rehearsed:
            return []
        variance = np.array([sensor.variance for sensor in self.sensors])
        is_forecast_well = self.healthy.forecasts.skill.knows(variance)
        may_be_accused = is_forecast_well & ~self._are_among(self.untaken)
        return self.runaways.lasting(samples, may_be_accused)

    def _are_among(self, outputs: Collection[int]) -> BoolArray:
        """Which outputs are among these, shape (o,)."""
        is_among = np.zeros(len(self.sensors), dtype=bool)
        is_among[list(outputs)] = True
        return is_among

    def _by_sensor(
        self, values: FloatArray, counts: BoolArray
    ) -> Iterator[tuple[LearnedSensor, float, bool]]:
        """Each sensor with its reading, and whether that counts."""
        return zip(self.sensors, values.tolist(), counts.tolist(), strict=True)

    def _estimate(self, reading: Reading, variance: FloatArray) -> None:
        """Estimate the outputs whose sensors lie, without the readings of these."""
        if not self.through:
            return
        is_right = reading.seen & ~self._are_among(self.through)
        for output, estimator in self.through.items():
            estimator.push(reading._replace(seen=is_right), variance[output])

    def _weigh(self, values: FloatArray, is_taken: BoolArray) -> None:
        """Weigh all that is healthy by the readings that are taken, and every change against that."""
        healthy = self.healthy
        gained = healthy.members.gained[healthy.best].tolist()
        readings = self._by_sensor(values, is_taken)
        without_equations = [
            sensor.walked(value, nats, counts=counts)
            for (sensor, value, counts), nats in zip(readings, gained, strict=True)
        ]
        total = healthy.weigh(sum(without_equations))
        tally(
            self._traces,
            self.table,
            healthy.levels,
            total,
            healthy.forecasts.doubts,
            self.count,
            self._totals,
            self._likeliest,
        )

    def _learn(self, values: FloatArray, counts: BoolArray) -> None:
        """Have each sensor learn from its reading, beside what the most probable filter expected."""
        members = self.healthy.members
        gained = members.gained[self.healthy.best].tolist()
        expected = members.expected[self.healthy.best].tolist()
        readings = self._by_sensor(values, counts)
        for (sensor, value, is_sound), nats, due in zip(
            readings, gained, expected, strict=True
        ):
            sensor.learn(value, nats, due, counts=is_sound)

    def leave_out(self, output: int) -> None:
        """Have no filter take the readings of an output that is read through, and have all forget what they have
        taught: they believe what the estimate does."""
        self.untaken.add(output)
        self.healthy.continue_from(self.through[output].belief)
        self._clear()

    def take_again(self, output: int, before: FloatArray) -> None:
        """Take the readings of an output again, as after a gap: every healthy member believes of the plant, and of
        that sensor, what was believed `before` they said nothing, shape (N,)."""
        self.untaken.discard(output)
        is_led_back = self.healthy.of_plant.copy()
        is_led_back[self.healthy.numbers[f"offset {output}"]] = True
        healthy_members = self.healthy.members.at[: self.healthy.healthy]
        healthy_members[:, is_led_back] = before[is_led_back]
        self.restart()

    def _reading(
        self, values: FloatArray, counts: BoolArray, inputs: FloatArray, row: FloatArray
    ) -> tuple[Reading, FloatArray]:
        """Readings with what is known of their sensors, and the variances of their noise."""
        learned = np.array(
            [(s.repeated, s.noise, s.step, s.pause, s.variance) for s in self.sensors]
        )
        repeated, noise, digit, pauses, variance = np.ascontiguousarray(learned.T)
        reading = Reading(
            y=values,
            seen=counts,
            repeated=repeated,
            noise=noise,
            step=digit,
            pauses=pauses,
            inputs=inputs,
            crossing=self.healthy.inputs.crossing,
            disturbances=row,
        )
        return reading, variance

    def _begin_traces(self) -> None:
        """Follow changes that begin now, and forget those that began too long ago."""
        healthy = self.healthy
        if not self._suspected and healthy.choose_way():
            self._clear()
        weights = healthy.log_weights[: healthy.levels].copy()
        # if not even the last but one is careful enough, nobody is accused
        weights[-1] = -np.inf
        spawn(
            self._traces,
            self.table,
            healthy.members.at,
            weights,
            _LEAST_LOG_WEIGHT,
            healthy.inputs.usual,
            self._recent.reach,
            self.count,
        )
        self._recent.take_belief(healthy.members.at[healthy.best].copy())
        for place, end in enumerate(self._ends):
            self._aim(end, len(self._usual) + place)

    def _aim(self, end: ExpectedEnd, place: int) -> None:
        """Have the onsets of an end that begin now lead back to what was believed before; `place` is that of its
        row."""
        healthy = self.healthy
        for level in range(healthy.levels):
            for trace in self._places.of(level, place):
                if self._traces.born[trace] == self.count:
                    way = healthy.way_back(level, end.before)
                    way_of_row = np.where(self._moves(end.row), way, 0.0)
                    self._aim_trace(trace, way_of_row)

    def _aim_trace(self, trace: int, way: FloatArray) -> None:
        """Have an onset that begins now change all numbers on the way back, shape (N,)."""
        row = self._places.row_of(trace)
        self._traces.trace[trace] = way
        self._traces.way[trace] = way[self.table.number[row]]
        relative = self.table.relative[row]
        if relative >= 0:
            self._traces.bends[trace] = way[self.table.number[relative]]

    def _moves(self, row: ChangeRow) -> BoolArray:
        """Which numbers of a belief a change has moved, shape (N,): those of the plant, as what a name does not
        explain is learned as others of them; or the offset of one sensor."""
        if row.is_of_plant:
            return self.healthy.of_plant
        is_number = np.zeros(len(self.healthy.numbers), dtype=bool)
        is_number[self.healthy.numbers[row.number]] = True
        return is_number

    def believed_before(self, born: int) -> FloatArray:
        """What was believed before a change that began at a sample, shape (N,)."""
        remembered = self._recent.believed_before(self.count - born)
        if remembered is None:
            return np.array(self.healthy.members.at[self.healthy.best])
        return remembered

    def change_since(self, row: ChangeRow, before: FloatArray) -> float:
        """How far the number of a row is now from what was believed before."""
        healthy = self.healthy
        number = healthy.numbers[row.number]
        change = float(healthy.members.at[healthy.best, number] - before[number])
        return _in_unit_of(row, change)

    def effect_since(self, drive: int, before: FloatArray) -> float:
        """By how much more a drive does now than by what was believed before, as a share of that.

        Its share alone does not say that: a filter may learn the same as another parameter.
        """
        healthy = self.healthy
        then = np.linalg.norm(healthy.effect_of(drive, before))
        now = np.linalg.norm(healthy.effect_of(drive, healthy.members.at[healthy.best]))
        return float(now / then) - 1.0 if then > 0.0 else 0.0

    def _rehearse(self, reading: Reading, variance: FloatArray) -> None:
        """Read through each sensor that is right, to know what such an estimate is worth."""
        for output, rehearsal in enumerate(self.rehearsals):
            if (
                rehearsal.on is None
                and self.known >= _READING_THROUGH.rehearsed
                and not self.through
            ):
                rehearsal.begin(
                    self._without(output, 0),
                    early=self.known < _READING_THROUGH.known_well,
                )
            rehearsal.push(reading, float(variance[output]), output)

    def _without(self, output: int, since: int) -> ReadThrough:
        """An estimate of an output that ascribes nothing to its sensor, by a filter from before `since`."""
        healthy = self.healthy
        band = self.rehearsals[output].band
        return ReadThrough(
            self._model,
            healthy.without(output, since),
            healthy.fixed,
            output,
            table=self.table,
            band=band,
        )

    @property
    def _price_of_hour(self) -> float:
        """The hour in which a change began has to be said, too: the longer a plant is known, the dearer;
        nats."""
        return 2.0 * math.log(1.0 + self.known / HOUR)

    def suspects(self) -> list[Suspect]:
        """Every cause with its evidence, the best first."""
        least = _INTERESTING + self._price_of_hour
        is_interesting = (self._totals >= least) & ~self._changes.crosses
        places = np.flatnonzero(is_interesting).tolist()
        suspects = [self._suspect(place) for place in places]
        for output, sensor in enumerate(self.sensors):
            evidence = self._evidence_of_frozen(sensor.frozen)
            if evidence >= _INTERESTING:
                born = self.count - sensor.repeats
                suspects.append(
                    suspected_sensor(Fault.SENSOR_FROZEN, output, evidence, born)
                )
        suspects.sort(key=lambda suspect: -suspect.evidence)
        self._suspected = bool(suspects) and suspects[0].evidence > 0.0
        return suspects

    def _suspect(self, explanation: int) -> Suspect:
        """The cause of an explanation, given by place, by its likeliest trace."""
        trace = int(self._likeliest[explanation])
        row = self.rows[self._places.row_of(trace)]
        born = int(self._traces.born[trace])
        size = float(self._traces.mean[trace])
        way = float(self._traces.way[trace])
        shift = size * way
        error = math.sqrt(self._traces.variance[trace]) * abs(way)
        evidence = float(self._totals[explanation]) - self._price_of_hour
        evidence -= row.cost_of_impossible(shift, error, self.believed(row.number))
        share = self._share_come(row, born)
        return Suspect(
            row.cause,
            evidence,
            row,
            shift * share,
            error * share,
            born,
            trace,
            returned=size if row.is_end else 0.0,
        )

    def _share_come(self, row: ChangeRow, born: int) -> float:
        """The part of a ramp that has come so far; 1 of what comes at once."""
        if not row.slowly:
            return 1.0
        healthy = self.healthy
        slowly = row.slowly * healthy.scale
        return min((self.count - born) * healthy.period / slowly, 1.0)

    def _evidence_of_frozen(self, frozen: float) -> float:
        """Evidence that a sensor is frozen, nats beyond its price, of what its repeats say for that."""
        moments = math.log(HOUR * self.second)
        return frozen - moments - self._price_of_hour

    @property
    def crossing(self) -> float:
        """Evidence that drives act on each other's places in another way than the equations say, nats; −∞ if
        the plant has one drive."""
        totals = self._totals[self._changes.crosses]
        return float(totals.max(initial=-math.inf)) - self._price_of_hour

    def frozen(self, output: int, value: float) -> bool:
        """Whether a reading is far from what was expected before it began to repeat itself."""
        sensor = self.sensors[output]
        missed = self.healthy.forecasts.missed(
            self.count - 1 - sensor.repeats, output, value, sensor.variance
        )
        return missed or self.rehearsals[output].missed(sensor.repeats, value)

    def frozen_until_now(self, output: int, value: float) -> int | None:
        """Since which sample, counted from the last gap, a sensor was frozen that has moved again at this reading;
        None if it was not, or if that does not show.

        It has stood for longer than it usually does, and moves to where it is expected by an estimate that does not
        use it. A sensor that is off from now on moves away from there. An estimate that began while it stood is
        nearer to where it stood than to where the plant is, if anything.
        """
        sensor = self.sensors[output]
        run = sensor.ended_run
        estimator = self.rehearsals[output].newest
        if run is None or estimator is None or self.jumps.any_but_of(output):
            return None
        least = RUNNING.noises * max(sensor.noise, self._model.noise[output])
        if self._evidence_of_frozen(run.frozen) < 0.0 or abs(value - run.value) < least:
            return None
        off = abs(value - estimator.estimate.value)
        is_expected = off <= least or not estimator.is_missed_by(value)
        is_nearer = off < abs(run.value - estimator.estimate.value)
        return self.count - 1 - run.repeats if is_expected and is_nearer else None

    def forget_since(self, output: int, since: int) -> None:
        """Forget what the readings of an output have taught since a sample, counted from the last gap, and take them
        again: all filters continue from an estimate that has not used them."""
        estimator = self.rehearsals[output].newest
        if estimator is not None:
            self.healthy.continue_from(estimator.belief)
        self.take_again(output, self.believed_before(since))

    def read_through(self, output: int, since: int) -> None:
        """Estimate an output without its sensor from now on.

        The sensor has lied since the sample `since`, counted from the last gap. An estimate that was
        rehearsed before that is continued, if there is one.
        """
        if output not in self.through:
            estimator = self.rehearsals[output].on
            if estimator is None or estimator.samples <= self.count - since:
                estimator = self._without(output, since)
            estimator.rehearsed = estimator.samples
            self.through[output] = estimator
            for rehearsal in self.rehearsals:  # those of the others take its readings
                rehearsal.drop()

    def is_forgotten_soon(self, suspect: Suspect) -> bool:
        """Whether its onset is so long ago that it is not followed much longer."""
        age = self.count - suspect.born
        return age >= (REMEMBERED.reach - 2.0 * BETWEEN_ONSETS) * self.second

    def was_asked(self, suspect: Suspect) -> bool:
        """Whether a drive, or one of all drives, has been asked since it is said to have changed for more than
        what comes sooner or later if its input acts at another time than the equations say.

        A drive that is switched off a few seconds after that has shown nothing but when it acts.
        """
        latest = self.healthy.inputs.latest
        since = self.count - suspect.born
        commands = self._recent.commands[-since - latest :]
        asked = commands[-since:].sum(axis=0)
        is_enough = asked > latest * commands.max(axis=0)
        drive = suspect.cause[1]
        return bool(is_enough.any() if drive == EVERY else is_enough[drive])

    def stands_since(self, suspect: Suspect) -> bool:
        """Whether the readings that a drive moves most have only been repeated since it is said to have changed; of
        all drives, whether the readings of all have.

        A frozen sensor shows the same, and no drive that has changed leaves its reading where it was for long.
        """
        since = self.count - suspect.born
        drive = suspect.cause[1]
        drives = range(self.drives) if drive == EVERY else (drive,)
        believed = self.healthy.members.at[self.healthy.best]
        outputs = [
            int(np.argmax(np.abs(self.healthy.effect_of(j, believed)))) for j in drives
        ]
        return all(self.sensors[output].repeats >= since for output in outputs)

    def most_that_crosses(self, suspect: Suspect) -> float:
        """The most that may have crossed to the drive of a suspect from the others, as far as they have moved, as
        a share of what that drive was asked for since; infinite if it was asked for nothing, or is the only one."""
        row = self._row_of_crossing(suspect.cause[1])
        if row is None:
            return math.inf
        since = max(self.count - suspect.born, 1)
        before = round(CROSSING.usual * self.second)
        asked = self._recent.commands[-since:, suspect.cause[1]].mean()
        arrived = self._recent.arrived[-since - before :]
        moved = arrived.max(axis=0) - arrived.min(axis=0)
        crosses = _CERTAIN * row.spread * float(np.array(row.follows) @ moved)
        return crosses / float(asked) if asked > 0.0 else math.inf

    def _row_of_crossing(self, drive: int) -> ChangeRow | None:
        """The row of what arrives at a drive from the others, if there are any."""
        rows = (row for row in self._usual if row.crosses and row.cause[1] == drive)
        return next(rows, None)

    def may_accuse(self, suspect: Suspect) -> bool:
        """Whether the equations forecast well what they would be believed in: the output that a cause
        concerns, or all of them. No plant moves as a reading does that jumps.

        A change is not believed in either if a linear model has forecast what the equations missed since.
        """
        fault, place = suspect.cause
        if fault is Fault.SENSOR_DRIFT and not suspect.row.slowly:
            age = self.count - suspect.born
            return self.jumps.explain(place, suspect.shift, age)
        variance = np.array([sensor.variance for sensor in self.sensors])
        healthy = self.healthy
        since = healthy.known - (self.count - suspect.born)
        knows = healthy.forecasts.skill.knows(variance)
        is_explained = healthy.forecasts.newest.explained(since, variance)
        concerns_one_output = (
            TRAITS[fault].subject is Subject.OUTPUT or fault is Fault.DISTURBANCE
        )
        if concerns_one_output:
            return bool(knows[place] and not is_explained[place])
        is_missed = healthy.forecasts.newest.missed(since, variance)
        all_explained = is_missed.any() and is_explained[is_missed].all()
        return bool(knows.all() and not all_explained)

    @property
    def rough(self) -> bool:
        """Whether even the most careful of the levels does not doubt the equations enough."""
        return self.healthy.best == self.healthy.levels - 1

    @property
    def is_inexact(self) -> bool:
        """Whether the equations' forecasts have erred far more than is expected of them, as those of a plant do
        that is not linear where its equations are."""
        return bool(self.healthy.forecasts.doubts.max() > _INEXACT)

    def believed(self, name: str) -> float:
        """The believed value of one of the numbers."""
        return self.number_in(self.healthy.members.at[self.healthy.best], name)

    def number_in(self, belief: FloatArray, name: str) -> float:
        """The value of one of the numbers in a belief, shape (N,)."""
        return float(belief[self.healthy.numbers[name]])

    def remains(self, suspect: Suspect) -> float:
        """Share of a jump of the number that has not faded."""
        return float(
            self._traces.trace[suspect.trace, self.healthy.numbers[suspect.row.number]]
        )

    def adopt_jumps(self, outputs: list[int]) -> None:
        """Take jumps of several readings for what they are off by, in every healthy member."""
        members = self.healthy.members
        for output in outputs:
            place = self.healthy.numbers[f"offset {output}"]
            sensor = self.sensors[output]
            members.at[: self.healthy.healthy, place] += sensor.jump.size
            members.covariance[: self.healthy.healthy, place, place] += (
                2.0 * sensor.variance
            )
            sensor.jump = Jump(0, 0.0)
        self._clear()
        self.healthy.forecasts.forget()
        for rehearsal in self.rehearsals:
            rehearsal.drop()

    def _adopted(
        self, row: ChangeRow, trace: FloatArray, shift: float
    ) -> tuple[FloatArray, FloatArray]:
        """What a change adds to a belief, and the derivative of that by its size."""
        change = shift * trace
        by_size = trace.copy()
        if row.is_end:
            logged = self.healthy.logged
            factors = 1.0 + np.maximum(change[logged], LEAST_SHARE)
            change[logged] = np.log(factors)
            by_size[logged] /= factors
        elif row.is_relative:
            number = self.healthy.numbers[row.number]
            factor = 1.0 + max(shift, LEAST_SHARE)
            change[number] = math.log(factor) * trace[number]
            by_size[number] = trace[number] / factor
        return change, by_size

    def _trace_of(self, suspect: Suspect, b: int) -> int:
        """The trace of a suspect in a healthy member: its own, if it has one that began then."""
        if b >= self.healthy.levels:
            return suspect.trace
        row = self._places.row_of(suspect.trace)
        for trace in self._places.of(b, row):
            if self._traces.born[trace] == suspect.born:
                return trace
        return suspect.trace

    def left_after(self, suspect: Suspect, row: ChangeRow, before: FloatArray) -> float:
        """How far the number of a row would be from what was believed before, if a suspect were taken for how the
        plant is: a filter may have learned by itself what the suspect explains."""
        healthy = self.healthy
        t = self._trace_of(suspect, healthy.best)
        change, _ = self._adopted(
            suspect.row, self._traces.trace[t], float(self._traces.mean[t])
        )
        number = healthy.numbers[row.number]
        believed = float(healthy.members.at[healthy.best, number])
        left = believed + float(change[number]) - float(before[number])
        return _in_unit_of(row, left)

    def adopt(self, suspect: Suspect) -> None:
        """Take a change for how the plant is, in every healthy member: by its own trace, if it has one that
        began then."""
        traces = self._traces
        members = self.healthy.members
        for b in range(self.healthy.healthy):
            t = self._trace_of(suspect, b)
            change, spread = self._adopted(
                suspect.row, traces.trace[t], float(traces.mean[t])
            )
            members.at[b] += change
            members.covariance[b] += np.outer(spread, spread) * traces.variance[t]
        self._clear()
        self.healthy.forecasts.forget()
        for output, rehearsal in enumerate(self.rehearsals):
            if suspect.cause != (Fault.SENSOR_DRIFT, output):
                # its rehearsal does not use that sensor
                rehearsal.drop()


def _in_unit_of(row: ChangeRow, change: float) -> float:
    """A change of the number of a row in the row's unit: of a logarithm as a share."""
    return math.expm1(change) if row.is_relative else change
