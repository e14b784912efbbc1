"""Alarms by channel of a plant with several signals: which hypothesis is named, and when it is over."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from twinmatch.dynamics import Parameters
from twinmatch.health.channel_alarms import ChannelAlarm, ChannelAlarms
from twinmatch.health.evidence import Competition
from twinmatch.health.faults import (
    EVERY,
    SLOW,
    TRAITS,
    Alarm,
    EstimatedReading,
    Fault,
    Health,
    HealthState,
    Lie,
    Subject,
)
from twinmatch.health.hypotheses import MORE, ChangeRow
from twinmatch.health.runaway import RUNNING
from twinmatch.health.sentences import LEARNED, FaultSentences
from twinmatch.health.standing import (
    OF_A_DRIVE,
    UNDOING,
    NamedChange,
    StandingChanges,
    is_of_sensor,
)
from twinmatch.health.suspects import Suspect, suspected_sensor
from twinmatch.health.unbelieved import UnbelievedSensors
from twinmatch.settings import Rule
from twinmatch.signals import Sample

CHANGE: Final = 3.0
"""Evidence from which a change is reported, nats."""
LEAD: Final = 4.0
"""By how much the evidence of a cause must lead every other cause to be named."""


class _Naming(Rule):
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
    more: float = 2.0 * CHANGE
    """Evidence from which a drive is said to do more than before, nats: what equations lack of the exchange
    between two loops looks like that. And from which a second fault is named while a sensor lies, by whose readings
    it is judged as well."""
    much: float = 3.0 * CHANGE
    """Evidence from which a small share of a drive is named though the equations are inexact, nats."""
    certain: float = 2.0
    """Standard deviations of its size by which an unnamed change differs from none, and a lost drive from a
    weak one."""
    confirm: int = 3
    """Samples in a row with a reading that the sensor cannot give."""


_NAMING: Final = _Naming()


_OF_THE_PLANT: Final = frozenset(
    f for f, traits in TRAITS.items() if traits.another_plant
)
"""Faults that make another plant."""
_LEARNED_FIRST: Final = _OF_THE_PLANT | {Fault.DRIFT, Fault.DISTURBANCE}
"""Faults that may be parameters that are not known yet: a push that fades looks like one as well."""


class _Passing(Rule):
    """When something that passes has passed."""

    shown: float = 15.0
    """Time for which a push that has passed is shown, s."""
    faded: float = 0.3
    """Share of a push from which on it has passed."""


_PASSING: Final = _Passing()


_BY_ITSELF: Final = (Fault.SENSOR_FROZEN, Fault.SENSOR_IMPLAUSIBLE)
"""Faults that a sensor's own readings show."""
_LOST_FROM: Final = -0.8
"""Change of a drive's share, from 1, from which on the drive is lost: a fifth of its effect is left."""


def _end_plant(*suspects: Suspect) -> bool:
    """Whether all of them say that the plant is again as it was before a change."""
    return all(
        suspect.row.is_end and not is_of_sensor(suspect.row) for suspect in suspects
    )


def _is_of_whole_plant(suspect: Suspect) -> bool:
    """Whether a change concerns all of a plant: what all drives share, losses or the room."""
    fault, place = suspect.cause
    is_of_all_drives = fault in OF_A_DRIVE and place == EVERY
    return is_of_all_drives or TRAITS[fault].subject is Subject.PARAMETER


def _is_impossible(suspect: Suspect) -> bool:
    """Whether it says that a parameter, such as losses, is nothing or less: then the equations lack what has
    changed."""
    return suspect.row.is_relative and suspect.shift <= -1.0


class ChannelMonitor:
    """Watches one plant with any number of inputs and outputs."""

    def __init__(self, parameters: Parameters, period: float) -> None:
        """Begin with typical parameters and the sample time, s."""
        self.competition = Competition(parameters, period)
        self._said = ChannelAlarms()
        # as of a `Monitor`: here names say what is known
        self.reservation = self.doubt = ""
        self.estimates: tuple[EstimatedReading, ...] = ()
        """What sensors should read now that are not believed."""
        self.suspects: list[Suspect] = []
        """What competes now, the best first."""
        self.sentences = FaultSentences(parameters.model, period)
        self._impossible = np.zeros(len(parameters.model.plant.outputs), dtype=np.int64)
        """Readings in a row of each output that its sensor cannot give."""
        self._standing = StandingChanges(self.competition)
        self._unbelieved = UnbelievedSensors(self.competition, parameters.model.plant)
        outputs = parameters.model.plant.outputs.values()
        self._spans = np.array([output.readable for output in outputs])
        self._values = self._spans.mean(axis=1)
        self._begin = self._index = -2
        self._lie_ended = -math.inf
        """Sample at which the readings of a sensor were last taken again."""
        self._leads: tuple[object, int] = (None, 0)
        self._unnamed = 0

    @property
    def alarms(self) -> tuple[ChannelAlarm, ...]:
        """The newest alarms, oldest first, as many as are kept; only the last can still be on."""
        return self._said.kept

    @property
    def on(self) -> ChannelAlarm | None:
        """The alarm that is on."""
        return self._said.on

    def fault_between(
        self, first: int, last: int, *, slow: bool = False
    ) -> Alarm | None:
        """The first alarm that touches these samples; see `touching`."""
        return self._said.fault_between(first, last, slow=slow)

    def excuses_between(self, first: int, last: int) -> bool:
        """Whether the plant is known to have been another between two samples, or to have become another."""
        return self._said.excuses_between(first, last)

    def lie_between(self, first: int, last: int) -> Lie | None:
        """The lie of a sensor that is known between two samples, both included; None without one.

        An alarm ends when another begins, a lie does not.
        """
        return self._unbelieved.lie_between(first, last)

    def push(self, sample: Sample, _: Parameters | None = None) -> Health:
        """Take one sample; judge the plant as it is now, without asking any twin."""
        before = self._said.newest
        self._push(sample)
        self.estimates = self._unbelieved.estimates(sample)
        newest = self._said.newest
        on = self.on
        news = newest if newest is not before else None
        nan = math.nan
        if on is None:
            return Health(
                sample.index, HealthState.HEALTHY, None, None, "", nan, nan, news
            )
        return Health(
            sample.index,
            HealthState.FAULT,
            on.fault,
            on.first,
            on.reason,
            nan,
            nan,
            news,
            on.signal,
        )

    def _push(self, sample: Sample) -> None:
        if sample.index != self._index + 1:
            self._begin = sample.index
            self.competition.restart()
            self.competition.through.clear()  # nobody knows where the plant went
        self._index = sample.index
        read = np.array(sample.refused or sample.outputs)
        possible = (
            np.isfinite(read)
            & (read >= self._spans[:, 0])
            & (read <= self._spans[:, 1])
        )
        counts = possible & sample.seen & (not sample.refused)
        self._values = np.where(possible, read, self._values)
        self.competition.push(sample, self._values, counts)
        self._impossible = np.where(possible, 0, self._impossible + 1)
        for output in np.flatnonzero(self._impossible == _NAMING.confirm).tolist():
            if self._unbelieved.has_run_away(output):
                continue  # it is known to lie
            born = self.competition.count - _NAMING.confirm
            best = suspected_sensor(Fault.SENSOR_IMPLAUSIBLE, output, math.inf, born)
            self._raise(Fault.SENSOR_IMPLAUSIBLE, best, [best])
            # no filter has taken such readings: the newest is best
            self._unbelieved.read_through(output, 0)
        self._name_frozen_until_now()
        self._judge_jumps(self.competition.jumps.together(_NAMING.confirm - 1))
        self._judge_run_away(self.competition.run_away(_NAMING.confirm))
        self._end_run_away()
        suspects = self._lost_and_weak(self.competition.suspects())
        self.suspects = [suspect for suspect in suspects if self._counts(suspect)]
        self._judge(self.suspects)
        self._end_what_was_learned_back()
        self._believe_sensors_that_are_right()

    def _believe_sensors_that_are_right(self) -> None:
        """Take readings again that were left out, of sensors that no longer lie."""
        lying = np.array([self._lies(output) for output in range(self._spans.shape[0])])
        newest = self._said.newest
        since = self._index if newest is None else newest.first
        if self._unbelieved.settle(lying, since, self._index):
            self._begin_again_behind_a_lie()

    def _name_frozen_until_now(self) -> None:
        """Name sensors that have moved again, and by that show that they were frozen; forget what they showed."""
        for output, value in enumerate(self._values.tolist()):
            born = self.competition.frozen_until_now(output, value)
            # This alarm is over at once: one of several sensors would be over with it, though they are still off.
            is_free = self._is_nothing_named and not self._is_of_several
            if born is None or not is_free:
                continue
            best = suspected_sensor(Fault.SENSOR_FROZEN, output, CHANGE, born)
            reason = self.sentences.was_frozen(output, self._index - self._begin - born)
            self._raise(Fault.SENSOR_FROZEN, best, [best], reason=reason)
            self._said.end(self._index)
            self.competition.forget_since(output, born)
            self._begin_again_behind_a_lie()

    def _begin_again_behind_a_lie(self) -> None:
        """Readings of a sensor are taken again from the next sample on, as after a gap."""
        self._lie_ended = self._index
        self._begin = self._index + 1
        self._restart_waiting()

    def _judge_run_away(self, outputs: list[int]) -> None:
        """Name a sensor whose reading has moved farther than its plant can; of several at once, say that it is not
        known what is wrong."""
        if len(outputs) == 1:
            self._name_run_away(outputs[0])
        elif outputs:
            first = self._index + 1 - round(RUNNING.lasts * self.competition.second)
            born = max(first - self._begin, 0)
            self._raise_at_once(
                outputs, first, self.sentences.ran_away_at_once(outputs)
            )
            for output in outputs:
                self._unbelieved.leave_out_run_away(output, born)
            self._restart_waiting()

    def _name_run_away(self, output: int) -> None:
        competition = self.competition
        lasted = round(RUNNING.lasts * competition.second)
        born = max(competition.count - lasted, 0)
        moved = float(competition.runaways.moved[output])
        row = self._row_of_jump(output)
        best = Suspect(row.cause, math.inf, row, moved, 0.0, born, -1)
        self._raise(
            Fault.SENSOR_DRIFT,
            best,
            [best],
            reason=self.sentences.ran_away(output, moved),
        )
        self._unbelieved.leave_out_run_away(output, born)
        self._restart_waiting()

    def _restart_waiting(self) -> None:
        """Have every cause lead, or wait for a name, from now on."""
        self._leads = (None, 0)
        self._unnamed = 0

    def _end_run_away(self) -> None:
        """End the alarms of readings that had run away, and are back."""
        for output in self._unbelieved.back(self._values):
            is_of_several = (
                self._is_of_several and not self._unbelieved.any_has_run_away
            )
            if is_of_several or self._said.is_on(Fault.SENSOR_DRIFT, output):
                self._said.end(self._index)

    @property
    def _is_nothing_named(self) -> bool:
        """Whether no alarm is on, or only one without a name, which may have been a frozen sensor."""
        return self.on is None or self.on.fault is Fault.DRIFT

    @property
    def _is_of_several(self) -> bool:
        """Whether the alarm that is on says that several sensors are wrong at once."""
        return self.on is not None and not self.on.suspects

    def _judge_jumps(self, outputs: list[int]) -> None:
        """Report readings that have jumped at once, or that such a jump is over.

        What several sensors show at once is nothing that the plant does, and nothing that one sensor does:
        there is none by which another could be read through.
        """
        if (
            not outputs
            or self.competition.known < _NAMING.start * self.competition.second
        ):
            return
        jumps = {
            output: self.competition.sensors[output].jump.size for output in outputs
        }
        rows = {output: self._row_of_jump(output) for output in outputs}
        before = self.competition.believed_before(self.competition.count)
        returned = [
            named
            for named in self._standing.jumped
            if self._standing.has_come_back(named, jumps.get(named.row.cause[1], 0.0))
        ]
        self.competition.adopt_jumps(outputs)
        self._standing.remove(returned, self._index)
        if returned:
            on = self.on
            is_jump_on = on is not None and on.fault is Fault.DRIFT
            if is_jump_on and not self._standing.jumped:
                self._said.end(self._index)
            return
        self._standing.note(
            NamedChange(Fault.DRIFT, rows[output], before, jumps[output])
            for output in outputs
        )
        first = self._index - _NAMING.confirm + 1
        self._raise_at_once(outputs, first, self.sentences.jumped(outputs))
        self._standing.expect_back()

    def _row_of_jump(self, output: int) -> ChangeRow:
        cause = (Fault.SENSOR_DRIFT, output)
        return next(
            row
            for row in self.competition.rows
            if row.cause == cause and not row.slowly
        )

    def _raise_at_once(self, outputs: list[int], first: int, reason: str) -> None:
        """Begin an alarm of several sensors at once, of which none is named."""
        alarm = ChannelAlarm(
            Fault.DRIFT,
            first,
            flagged=self._index,
            last=None,
            reason=reason,
            spoils=True,
            signal=self.sentences.signal_of(outputs[0]),
            size=math.nan,
            rivals=(),
            suspects=(),
        )
        self._said.begin(alarm)

    def _lies(self, output: int) -> bool:
        """Whether the sensor of an output is known to be off, or frozen or without sense now."""
        on = self.on
        if self._unbelieved.has_run_away(output):
            return True
        by_alarm = (
            on is not None
            and on.fault in _BY_ITSELF
            and on.suspects[0].cause[1] == output
        )
        return by_alarm or self._standing.is_off(output)

    def _lost_and_weak(self, suspects: list[Suspect]) -> list[Suspect]:
        """The suspects, with drives called lost or weak by what is left of their effect, the best first.

        What a drive explained when it was followed as a lost one says nothing for a weak one, which has rows of
        its own.
        """
        called = []
        for suspect in suspects:
            named = self._lost_or_weak(suspect)
            was_lost = suspect.cause[0] is Fault.DRIVE_LOST
            if not (was_lost and named.cause[0] is Fault.DRIVE_WEAK):
                called.append(named)
        return called

    def _lost_or_weak(self, suspect: Suspect) -> Suspect:
        """The suspect; a drive is lost if certainly nearly nothing is left of its effect, and weak if more may
        be, whatever it was followed as."""
        fault, drive = suspect.cause
        if fault not in OF_A_DRIVE or suspect.row.is_end:
            return suspect
        share = suspect.shift + self.competition.believed(suspect.row.number)
        is_lost = share + _NAMING.certain * suspect.error <= _LOST_FROM
        return replace(
            suspect, cause=(Fault.DRIVE_LOST if is_lost else Fault.DRIVE_WEAK, drive)
        )

    def shows(self, suspect: Suspect) -> bool:
        """Whether it can be seen yet: a sensor that repeats its reading is frozen once the plant should have
        moved."""
        fault, output = suspect.cause
        return fault is not Fault.SENSOR_FROZEN or self.competition.frozen(
            output, self._values[output]
        )

    def _counts(self, suspect: Suspect) -> bool:
        """Whether a suspect competes: a push does once it has passed, as it explains anything while it
        lasts."""
        if suspect.cause[0] is not Fault.DISTURBANCE:
            return True
        return (
            self._is_material(suspect)
            and self.competition.remains(suspect) < _PASSING.faded
        )

    def _judge(self, suspects: list[Suspect]) -> None:
        """End the alarm that is over; raise one for a cause that has led for long enough, or for none that
        leads."""
        competition = self.competition
        on = self.on
        if on is not None and self._over(on, suspects):
            self._said.end(self._index)
        if (
            not suspects
            or suspects[0].evidence < CHANGE
            or competition.count < _NAMING.start * competition.second
        ):
            self._restart_waiting()
            return
        named = [suspect for suspect in suspects if suspect.cause[0] is not Fault.DRIFT]
        if named and named[0].evidence > suspects[0].evidence - LEAD:
            # the unknown, which may act as anything does, counts only far ahead
            suspects = named
        best = suspects[0]
        rivals = [
            suspect.evidence
            for suspect in suspects[1:]
            if self._exclude_each_other(suspect, best)
        ]
        if not competition.may_accuse(best):
            return
        is_ahead = best.evidence - max([0.0, *rivals]) >= LEAD
        leads = is_ahead and not self._is_one_of_the_whole(best)
        self._leads = (
            best.cause,
            self._leads[1] + 1 if self._leads[0] == best.cause else 1,
        )
        if self._leads[1] < _NAMING.holds:
            return
        if leads and (
            best.cause[0] is Fault.SENSOR_FROZEN or self._is_to_be_named(best)
        ):
            self._name(best, suspects)
        elif not leads:
            self._wait_for_a_name(best, suspects)

    def _is_one_of_the_whole(self, best: Suspect) -> bool:
        """Whether it is a change of the whole plant that inexact equations do not tell from others: where heat is
        stored and lost decides what a supply, losses and a room look like."""
        is_change = not best.row.is_end and _is_of_whole_plant(best)
        return is_change and (self.competition.is_inexact or _is_impossible(best))

    def _wait_for_a_name(self, best: Suspect, suspects: list[Suspect]) -> None:
        """Report a change without a name once none has been found for long enough."""
        is_reported = self._began_known(best) and self._is_material(best)
        is_open = self._may_cross(best) or self._may_be_of_states(best)
        if not is_reported or is_open:
            self._unnamed = 0
            return
        self._unnamed += 1
        if self._is_unnamed_for_good(best):
            self._standing.note_suspect(best.cause[0], best)
            self._learn(best)
            return
        enough = best.evidence >= 2.0 * CHANGE
        has_waited = self._unnamed > _NAMING.unnamed * self.competition.second
        if enough and has_waited and self.on is None:
            self._raise(Fault.DRIFT, best, suspects)

    def _is_unnamed_for_good(self, best: Suspect) -> bool:
        """Whether a reported change without a name will not get one, because its onset is forgotten soon.

        Without it, a cause that began later, and that the same change would explain, were the best. So its likeliest
        cause is taken for how the plant is, and its end is expected.
        """
        is_reported = self.on is not None and self.on.fault is Fault.DRIFT
        is_of_plant = best.cause[0] in _OF_THE_PLANT
        return is_reported and is_of_plant and self.competition.is_forgotten_soon(best)

    def _over(self, on: ChannelAlarm, suspects: list[Suspect]) -> bool:
        """Whether the fault of the alarm that is on has ended."""
        if on.fault is Fault.SENSOR_FROZEN:
            return self.competition.sensors[on.suspects[0].cause[1]].repeats == 0
        if on.fault is Fault.SENSOR_IMPLAUSIBLE:
            return not self._impossible[on.suspects[0].cause[1]]
        if on.fault is Fault.DISTURBANCE:
            return self._index - on.flagged > _PASSING.shown * self.competition.second
        if self._standing.jumped:
            return False
        if self._is_of_several and self._unbelieved.any_has_run_away:
            return False
        return on.fault is Fault.DRIFT and (not suspects or suspects[0].evidence < 0.0)

    def _is_to_be_named(self, best: Suspect) -> bool:
        """Whether a change that leads is to be named.

        If not, it may be learned in silence: the end of a named change, or a change of a plant that is not
        known yet.
        """
        if self._lacks_proof(best):
            return False
        undone = self._standing.undone_by(best)
        if undone:
            self._end(undone)
            self._adopt(best)
            return False
        if best.row.is_end:
            return False
        young = self._is_young(best)
        is_slow = best.cause[0] in _OF_THE_PLANT or best.cause[0] is Fault.DRIFT
        if is_slow and self.competition.rough:
            return False
        is_large = abs(best.shift) >= self._least_reported(best)
        if is_large and not young:
            seems_to_do_more = self._does_more(best) and self._may_cross(best)
            return not seems_to_do_more and not self._creeps_unseen(best)
        if best.evidence > 2.0 * CHANGE:
            self._learn(best)
        return False

    def _lacks_proof(self, best: Suspect) -> bool:
        """Whether something else than its rivals may explain the samples as well."""
        fault = best.cause[0]
        is_new = not best.row.is_end
        if is_new and fault is Fault.DRIVE_WEAK and self._is_open(best):
            return True
        if fault in OF_A_DRIVE and not self.competition.was_asked(best):
            return True
        if is_new and fault in OF_A_DRIVE and self.competition.stands_since(best):
            return True
        if self._may_be_of_states(best):
            return True
        if self._gives_back(best) and self._seems_back(best):
            return True
        is_new_room = is_new and fault is Fault.ROOM_CHANGED
        is_beside_a_lost_drive = is_new and fault in _OF_THE_PLANT and self._has_lost()
        is_beside_a_lie = self._is_beside_a_lie(best) or self._is_behind_a_lie
        needs_more = is_new_room or is_beside_a_lost_drive or is_beside_a_lie
        return needs_more and best.evidence < _NAMING.more

    @staticmethod
    def _gives_back(best: Suspect) -> bool:
        """Whether it says that a drive does as much again as before, which heat from another one looks like."""
        is_of_a_drive = best.cause[0] in OF_A_DRIVE and best.cause[1] != EVERY
        return best.row.is_end and is_of_a_drive and best.shift > 0.0

    def _seems_back(self, best: Suspect) -> bool:
        """Whether what crosses explains nearly as well that a drive does as much again as before; that an end is
        expected does not count, as what crosses is none and comes with every move of the other drives."""
        expected = self.competition.expects_ends_by
        return self.competition.crossing > best.evidence - LEAD - expected

    def _has_lost(self) -> bool:
        """Whether a drive is known to be lost: the plant then goes where nothing has shown how well the equations
        describe it."""
        return self.on is not None and self.on.fault is Fault.DRIVE_LOST

    def _is_beside_a_lie(self, suspect: Suspect) -> bool:
        """Whether another sensor than the one it concerns is known to lie."""
        fault, place = suspect.cause
        concerned = place if TRAITS[fault].subject is Subject.OUTPUT else None
        outputs = range(self._spans.shape[0])
        return any(self._lies(output) for output in outputs if output != concerned)

    def _may_be_of_states(self, suspect: Suspect) -> bool:
        """Whether it began as soon as readings were taken again of a sensor that had lied: then it may be what nobody
        saw of the states meanwhile."""
        is_of_plant = not suspect.row.is_end and not is_of_sensor(suspect.row)
        began_at_once = suspect.born < _NAMING.start * self.competition.second
        return is_of_plant and began_at_once and self._is_behind_a_lie

    @property
    def _is_behind_a_lie(self) -> bool:
        """Whether the readings of a sensor have been taken again for so short a time that states which nobody saw
        meanwhile may still show."""
        settles = UNDOING.settles * self.competition.second
        return self._index - self._lie_ended < settles

    def _age(self, suspect: Suspect) -> float:
        """Time since its onset, in s of a plant as fast as the rig."""
        return (self.competition.count - suspect.born) / self.competition.second

    def _is_open(self, drive: Suspect) -> bool:
        """Whether a weak drive may still be a lost one, or one that does more an exchange that the equations
        lack; or what all of them share be what the equations lack of the plant. A small share may be one of the
        equations if these are inexact: what a drive does may depend on where the plant is."""
        is_small = self.competition.is_inexact and abs(drive.shift) < MORE
        if is_small and drive.evidence < _NAMING.much:
            return True
        is_of_all = drive.cause[1] == EVERY
        needs_more = self._does_more(drive) or is_of_all
        lacks_evidence = needs_more and drive.evidence < _NAMING.more
        return lacks_evidence or self._age(drive) < _NAMING.sized

    def _began_known(self, best: Suspect) -> bool:
        """Whether the plant was known well when the change began."""
        return self.competition.known - self._age(best) >= _NAMING.learned

    def _is_material(self, best: Suspect) -> bool:
        """Whether a change is one that is reported, and not one that has shrunk to nothing since."""
        return abs(best.shift) >= max(
            self._least_reported(best), _NAMING.certain * best.error
        )

    def _least_reported(self, suspect: Suspect) -> float:
        """The smallest size of such a change that is reported.

        A drive that does more has to do more than what may cross from the others, as far as they have moved.
        """
        onset = self._begin + suspect.born
        remains = self._may_remain(suspect, onset)
        least = max(suspect.row.least, remains)
        if not self._does_more(suspect):
            return least
        if suspect.cause[1] == EVERY or remains or self._is_behind_a_lie:
            return max(least, MORE)
        if suspect.evidence - max(self.competition.crossing, 0.0) >= _NAMING.much:
            return least
        return max(least, self.competition.most_that_crosses(suspect))

    def _may_remain(self, suspect: Suspect, onset: int) -> float:
        """How much of a change that was over shortly before may be left, in the unit of a suspect that may be this; a
        reading that jumps has changed again."""
        if is_of_sensor(suspect.row) and not suspect.row.slowly:
            return 0.0
        return self._standing.may_remain(suspect.row.number, onset)

    @staticmethod
    def _does_more(suspect: Suspect) -> bool:
        """Whether it is a drive that does more than before, whatever it was followed as."""
        return suspect.cause[0] is Fault.DRIVE_WEAK and suspect.shift > 0.0

    def _is_young(self, best: Suspect) -> bool:
        """Whether the plant is not known for long enough to say that this has changed.

        A reading that creeps away is one more parameter while the others are not known yet.
        """
        known = self.competition.known
        if best.cause[0] is Fault.DRIVE_LOST:
            return False
        if best.cause[0] in _LEARNED_FIRST or best.row.slowly:
            return not self._began_known(best)
        return known < _NAMING.young

    def _may_cross(self, best: Suspect) -> bool:
        """Whether what the equations lack of the exchange between the loops explains the samples nearly as
        well."""
        return self.competition.crossing > max(0.0, best.evidence - LEAD)

    def _creeps_unseen(self, best: Suspect) -> bool:
        """Whether it is a creeping change while a drive is lost: what the equations lack creeps as well."""
        return self._has_lost() and best.row.slowly > 0.0

    @staticmethod
    def _exclude_each_other(suspect: Suspect, best: Suspect) -> bool:
        """Whether a suspect must be excluded before the best one is named.

        Two faults of one number need not be told apart, as a lost drive is weak, too; but a weak drive is not
        named while it may be a lost one.
        """
        if _end_plant(suspect, best):
            return False
        may_be_lost = (
            best.cause[0] is Fault.DRIVE_WEAK and suspect.cause[0] is Fault.DRIVE_LOST
        )
        is_same = (suspect.row.number, suspect.row.also) == (
            best.row.number,
            best.row.also,
        )
        return may_be_lost or not is_same

    def _end(self, undone: list[NamedChange]) -> None:
        """Named changes no longer stand, and no alarm of them is on."""
        self._standing.remove(undone, self._index)
        faults = {named.fault for named in undone}
        if self.on is not None and self.on.fault in faults:
            self._said.end(self._index)

    def _end_what_was_learned_back(self) -> None:
        """End changes of drives that the filters have unlearned by themselves."""
        learned_back = self._standing.learned_back()
        if learned_back:
            self._end(learned_back)
            self._standing.expect_back()

    def _name(self, best: Suspect, suspects: list[Suspect]) -> None:
        fault, signal = best.cause
        if fault is Fault.SENSOR_FROZEN:
            if self.shows(best) and self._is_nothing_named:
                self._raise(fault, best, suspects)
                self.competition.sensors[signal].is_accused = True
                self._unbelieved.leave_out(signal, best.born)
                self._restart_waiting()
            return
        if fault is Fault.DRIFT:
            self._wait_for_a_name(best, suspects)
            return
        if not self._said.is_on(fault, signal):
            self._raise(fault, best, suspects)
        if fault is not Fault.DISTURBANCE:
            self._standing.note_suspect(fault, best)
        self._adopt(best)
        if fault is Fault.SENSOR_DRIFT:
            self._unbelieved.read_through(signal, best.born)

    def _learn(self, best: Suspect) -> None:
        """Take a change without a name for how the plant is, and say so where it has been reported."""
        self._adopt(best)
        if self.on is not None and self.on.fault is Fault.DRIFT and self.on.suspects:
            self._said.end(self._index, LEARNED)

    def _adopt(self, best: Suspect) -> None:
        """Take a change for how the plant is from now on."""
        self.competition.adopt(best)
        self._restart_waiting()
        self._standing.expect_back()

    def _raise(
        self, fault: Fault, best: Suspect, suspects: list[Suspect], reason: str = ""
    ) -> None:
        """Begin an alarm; its sentence is that of its fault, if it has no `reason` of its own."""
        first = min(self._begin + best.born, self._index)
        is_one_of_the_whole = self._is_one_of_the_whole(best)
        near = [
            suspect
            for suspect in suspects
            if suspect.evidence > max(0.0, best.evidence - LEAD)
            or (is_one_of_the_whole and _is_of_whole_plant(suspect))
        ]
        rivals = tuple(
            dict.fromkeys(self.sentences.called(suspect.cause) for suspect in near)
        )
        share = self._standing.share_left(best)
        signal, size, usual_reason = self.sentences.said(fault, best, share, rivals)
        said = reason or usual_reason
        concerns_sensor = TRAITS[fault].subject is Subject.OUTPUT
        if concerns_sensor and self._unbelieved.is_blind_without(best.cause[1]):
            said = self.sentences.blind(said)
        alarm = ChannelAlarm(
            fault,
            first,
            flagged=self._index,
            last=None,
            reason=said,
            spoils=fault not in SLOW,
            signal=signal,
            size=size,
            rivals=rivals if fault is Fault.DRIFT else (),
            suspects=tuple(suspects),
        )
        self._said.begin(alarm)
