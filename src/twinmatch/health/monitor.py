"""The health monitor: takes samples, returns judgements."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Final

from twinmatch.dynamics import Parameters
from twinmatch.health.balance import BLOCK, TRIAL, Balance
from twinmatch.health.earned import NOTHING
from twinmatch.health.faults import (
    PRECEDENCE,
    SLOW,
    TRAITS,
    Alarm,
    EstimatedReading,
    Evidence,
    Fault,
    Health,
    HealthState,
    Lie,
    touching,
)
from twinmatch.health.lagged_effect import LaggedEffect, is_lagged
from twinmatch.health.late_input import LateInput
from twinmatch.health.refusals import stamps_apart
from twinmatch.health.rivals import Cause
from twinmatch.health.sentences import FaultSentences
from twinmatch.health.settings import HealthSettings
from twinmatch.health.slow_changes import SlowChanges
from twinmatch.health.traces import DriveEffect, Effect, Lag, Repeats
from twinmatch.settings import Rule
from twinmatch.signals import Sample


class _Reporting(Rule):
    """When a fault is reported, and when it is over."""

    confirm: int = 3
    """Consecutive samples that must show a drive without effect; refused ones that replace another fault."""
    weakly: float = 20.0
    """Time for which a drive must show too small an effect, s."""
    recovered: float = 15.0
    """Time without any trace after which a sensor counts as recovered, s."""
    over: float = 7.0
    """Nats, a thousand to one, by which the whole effect of a drive explains more than the share
    reported."""
    stood: float = 30.0
    """Time for which a reading must stand that explains a missing effect better than a lost drive, s."""
    shows: float = 60.0
    """Time after which a drive that works shows some effect against larger losses, s."""
    prove: float = 10.0
    """Time for which the plant must follow the drive before the drive counts as recovered, s."""
    unproven: float = 120.0
    """Time without any trace after which the drive counts as recovered without proof, s."""


_REPORTING: Final = _Reporting()


_OF_THE_DRIVE: Final = (Fault.DRIVE_LOST, Fault.DRIVE_WEAK)
"""Faults of which an effect of the drive that is missing is the trace."""
_REFUSED: Final = Fault.SENSOR_IMPLAUSIBLE
_KEPT: Final = 1000
"""Number of alarms kept: more than any window that is still matched can overlap."""
_NEWCOMER: Final = "the twin does not describe this plant yet"


class Monitor:
    """Watches one plant.

    Push every sample once, in order, as `Refusals` settled it, with the current parameters of the nominal
    twin, or None as long as there is none. If the plant file declares no typical parameters, drive faults and
    slow changes are not judged before there is a nominal twin: defaults are where a search begins, not what
    is known.

    A gap in the indices or in the stamps restarts the traces and keeps what was learned: unobserved time
    says nothing about the plant.
    """

    def __init__(self, settings: HealthSettings | None = None) -> None:
        """Begin without samples."""
        self.settings = settings or HealthSettings()
        self._known = bool(self.settings.reference.model.plant.typical)
        """Whether the drive's effect on this plant is known, if only roughly."""
        self._sentences = FaultSentences(
            self.settings.reference.model, self.settings.period
        )
        self._span = self.settings.reference.model.plant.output.readable
        self._lag = Lag(self.settings.pace)
        self._begin_with(self.settings)
        self._repeats = self._new_repeats()
        self._given: Parameters | None = None
        self._until_trial = 0  # blocks until the given parameters are tried again
        self._newest: Sample | None = None
        self._before: Sample | None = None  # the newest one, unless it is not usable
        # of the unbroken run of samples; no index can follow −2
        self._begin = self._index = -2
        self._contrary = 0  # samples in a row without the drive's effect
        self._feeble = 0  # samples in a row with too small an effect
        # samples in a row without any trace, except that of a slow change
        self._quiet = 0
        self._proofs = 0  # of those, the ones in which the plant followed the drive
        self._alarms: deque[Alarm] = deque(maxlen=_KEPT)
        self._refused = 0  # refused readings in a row
        self._refused_at = -2  # index of the newest one
        self._open = False  # whether the last alarm is still on
        self._is_tracked = False  # whether tracking raised it, and not a trace

    def _begin_with(self, settings: HealthSettings) -> None:
        """Judge the drive's effect by the settings' twin."""
        twin = settings.reference
        period = settings.period
        self._balance = Balance(twin, period)
        lagged = is_lagged(twin, period)
        self._lagged_effect = LaggedEffect(twin, period) if lagged else None
        """For a plant whose output the drive moves only after many samples."""
        self._acts_within_sample = not lagged
        """Whether what the drive does within a sample is its effect; otherwise it is a small part of it, and
        smaller than the errors of the states that the output does not show."""
        self._effect: DriveEffect = self._lagged_effect or Effect(
            settings.pace, self._balance.noise
        )
        self._slow = SlowChanges(settings, self._sentences, steps=lagged)
        self._timing = LateInput(settings.followed, period) if lagged else None
        self._delay = 0
        """How much later than the equations say inputs act, samples."""

    @property
    def estimates(self) -> tuple[EstimatedReading, ...]:
        """What sensors should read that are not believed: with a single one, nobody knows."""
        return ()

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """The newest alarms, oldest first, as many as are kept; only the last can still be on."""
        return tuple(self._alarms)

    def fault_between(
        self, first: int, last: int, *, slow: bool = False
    ) -> Alarm | None:
        """The first alarm that touches these samples; see `touching`."""
        return touching(self._alarms, first, last, slow=slow)

    def excuses_between(self, first: int, last: int) -> bool:
        """Whether the plant is known to have been another between two samples, or to have become another."""
        return any(alarm.excuses_between(first, last) for alarm in self._alarms)

    def lie_between(self, first: int, last: int) -> Lie | None:
        """The lie of the sensor that is known between two samples, both included; None without one."""
        lies = [
            Lie(alarm.signal, alarm.first, alarm.last)
            for alarm in self._alarms
            if alarm.lies
        ]
        return next((lie for lie in lies if lie.overlaps(first, last)), None)

    def push(self, sample: Sample, parameters: Parameters | None = None) -> Health:
        """Take one sample; judge the plant as it is now."""
        previous = self._newest
        self._newest = sample
        if self._is_behind_gap(previous, sample):
            self._restart(sample.index)
        elif previous is not None and not sample.follows(previous):
            # Readings were refused for long, and may be off from now on.
            self._before = None
            self._restart_traces()
            self._slow.restart(offset=True)
        self._index = sample.index
        if parameters is not self._given:
            self._given = parameters
            self._until_trial = 0
            if parameters is not None:
                self._take(parameters)
        before = self._before
        evidence = self._examine(sample) if sample.usable else None
        starting = (
            sample.index - self._begin
        ) * self.settings.period < self.settings.start
        if sample.refused:
            evidence = self._sentences.refused(before, sample)
            starting = False
            self._refused_at = sample.index
            if self._brief and not sample.usable:
                # from now on it is the fault of a sensor that has failed
                self._alarms[-1] = replace(self._alarms[-1], spoils=True)
        self._refused = self._refused + 1 if sample.refused else 0
        self._before = sample if sample.usable else None
        news = self._judge(sample.index, evidence, starting=starting)
        return self._health(sample.index, evidence, news, starting=starting)

    def withdraw(self) -> None:
        """Take the fault of impossible readings back at the next sample: such steps have recurred."""
        if self._open and self._alarms[-1].fault is _REFUSED:
            reason = self._sentences.recurring()
            self._alarms[-1] = replace(self._alarms[-1], withdrawn=reason)

    def _is_behind_gap(self, previous: Sample | None, sample: Sample) -> bool:
        """Whether a sample begins a run: the first, or one behind a gap in the indices or in the stamps."""
        if previous is None or sample.index != previous.index + 1:
            return True
        return stamps_apart(previous, sample, self.settings.period)

    def _take(self, parameters: Parameters) -> None:
        """Begin with the first parameters of a plant that its file does not describe; try later ones."""
        if not self._known:
            self._known = True
            self._begin_with(replace(self.settings, reference=parameters))
            return
        if self._lagged_effect is not None:
            self._lagged_effect.take(parameters)
        if not self.settings.reference.model.plant.typical:
            self._slow.propose(parameters)

    @property
    def reservation(self) -> str:
        """Why nobody can be accused yet, in words; empty once somebody has predicted the plant."""
        if self._predictor.earned:
            return ""
        late = self._delay * self.settings.period
        return (
            f"{_NEWCOMER}: its input seems to act {late:g} s late"
            if late
            else _NEWCOMER
        )

    @property
    def doubt(self) -> str:
        """Why no reading can be relied on, in words; empty unless the readings have shifted, or may have."""
        return self._slow.doubt

    @property
    def _brief(self) -> bool:
        """Whether the fault that is on consists of a few refused readings, which count nowhere."""
        return (
            self._open
            and not self._alarms[-1].spoils
            and self._alarms[-1].fault is _REFUSED
        )

    @property
    def _blind(self) -> bool:
        """Whether the fault that is on lets nothing be learned about the plant."""
        return (
            self._open
            and self._alarms[-1].spoils
            and TRAITS[self._alarms[-1].fault].blinds
        )

    def _restart(self, index: int) -> None:
        if index <= self._index:  # another session
            self._alarms.clear()
            self._open = False
            self._slow.forget()
        self._begin = index
        self._before = None
        self._repeats = self._new_repeats()
        self._restart_traces()
        self._balance.restart()
        self._slow.restart()
        if self._timing is not None:
            self._timing.restart()

    def _new_repeats(self) -> Repeats:
        plant = self.settings.reference.model.plant
        steps = plant.sensor.resolution if plant.sensor is not None else 0.0
        return Repeats(
            self.settings.period, self.settings.frozen, self._balance.noise, steps
        )

    def _restart_traces(self) -> None:
        self._effect.restart()
        self._lag.restart()
        self._contrary = self._feeble = 0

    def _try(self) -> None:
        """Switch to the balance of the given parameters if it is smoother than this one, which is rough."""
        self._until_trial -= 1
        if self._given is None or self._until_trial >= 0 or not self._balance.rough:
            return
        self._until_trial = TRIAL
        better = self._balance.better_of(self._given)
        if better is not self._balance and self._lagged_effect is None:
            # sums of another balance say nothing beside the errors of this one
            self._restart_traces()
        self._balance = better

    def _examine(self, sample: Sample) -> Evidence | None:
        """Add the sample to the traces; return the worst evidence."""
        before = self._before
        if before is None:
            return None
        output = sample.output
        change = output - before.output
        movement = self._balance.step(before, output)
        low, high = self._span
        inward = float(output <= low) - float(output >= high)
        after = movement.drive + movement.passive
        if not self._known:
            self._repeats.push(change, after, inward, earned=False)
            return (
                self._sentences.frozen(sample, self._repeats)
                if self._repeats.stands
                else None
            )
        stood = self._repeats.stands
        acting = self._acting(sample)
        if self._lagged_effect is not None:
            self._lagged_effect.newcomer = not self._slow.compares
            self._lagged_effect.freeze(
                self._open and self._alarms[-1].fault is Fault.DRIVE_LOST
            )
            after = self._lagged_effect.push(sample, self._slow.offset)
        error = (
            self._balance.roughness * self.settings.pace
            if self._acts_within_sample
            else 0.0
        )
        self._repeats.push(
            change,
            after,
            inward,
            error,
            earned=self._predictor.earned,
        )
        if stood and not self._repeats.stands:
            # it moves again, from wherever the plant went meanwhile
            self._restart_traces()
            return None
        self._lag.push(movement)
        if self._acts_within_sample and isinstance(self._effect, Effect):
            # a lost drive makes it rough, too
            rough = min(self._balance.roughness, self._balance.at_rest)
            self._effect.push(movement, rough, earned=self._balance.sees_drive)
        self._learn()
        self._track(acting)
        return self._weigh(sample)

    @property
    def _predictor(self) -> Balance | LaggedEffect | SlowChanges:
        """The one that sees best how the plant moves."""
        if (
            self._lagged_effect is not None
            and self.settings.reference.model.plant.loop is not None
        ):
            return self._lagged_effect
        return self._balance if self._acts_within_sample else self._slow

    def _acting(self, sample: Sample) -> Sample:
        """The sample with the input that acts now, if inputs act later than the equations say."""
        if self._timing is None:
            return sample
        faulty = self._contrary > 0 or self._blind
        self._timing.push(sample, learn=not faulty)
        if self._lagged_effect is not None:
            self._lagged_effect.delays = self._timing.credible
        if self._timing.delay != self._delay:
            self._delay = self._timing.delay
            self._slow.forget()
        return replace(sample, inputs=(self._timing.input,)) if self._delay else sample

    def _weigh(self, sample: Sample) -> Evidence | None:
        """The worst evidence of all traces: a frozen sensor, a missing effect of the drive, a slow change."""
        if self._repeats.stands:
            return self._sentences.frozen(sample, self._repeats)
        # What looks weak may be a twin that expects too much, so the balance must have been good.
        smooth = self._balance.smooth and self._lagged_effect is None
        least = self.settings.weak if smooth else self.settings.lost
        if self._effect.share < least and not self._repeats.unusual:
            return self._effect_missing(sample.index)
        self._contrary = self._feeble = 0
        if self._frozen_rather_than_lost(sample.index):
            return self._sentences.frozen(sample, self._repeats)
        slow = self._slow.evidence
        if slow is not None and 0 < sample.index - slow.first <= self._repeats.count:
            # no reading has changed since: the sensor may be frozen
            return slow._replace(sure=False)
        if slow is not None and slow.fault is Fault.DRIVE_LOST and self._effect.follows:
            return slow._replace(sure=False)
        return slow

    def _frozen_rather_than_lost(self, index: int) -> bool:
        """Whether a reading that has stood for long explains a missing effect better than a lost drive."""
        if self._lagged_effect is None or self._lagged_effect.rival is not Cause.FROZEN:
            return False
        slow = self._slow.evidence
        stood = self._repeats.count
        if slow is not None and index - slow.first > stood:
            # a change that began before the reading stood explains it, too
            return False
        return stood * self.settings.pace >= _REPORTING.stood

    def _track(self, sample: Sample) -> None:
        """Look for slow changes, unless a graver fault is on or the session has only begun."""
        if self._blind:
            return
        if (sample.index - self._begin) * self.settings.period >= self.settings.start:
            self._slow.push(sample)

    def _effect_missing(self, index: int) -> Evidence:
        """The evidence for a missing effect: a lost drive, a weak one, or readings that lag."""
        is_lost = self._effect.share < self.settings.lost
        self._contrary = self._contrary + 1 if is_lost else 0
        self._feeble += 1
        lag = self._lag_of_readings()
        if lag is not None:
            return self._sentences.late(
                index, self._effect, lag, sure=self._is_surely_lost
            )
        if is_lost and (self._is_surely_lost or not self._is_surely_weak):
            return self._lost_drive(index)
        return self._sentences.weak(
            index, self._effect, self._feeble, sure=self._is_surely_weak
        )

    def _lag_of_readings(self) -> float | None:
        """By how much readings that come late lag, s; None if that does not explain the missing effect."""
        if self._lagged_effect is not None:
            return None
        lag = self._lag.seconds(self._effect.length)
        if lag is None:
            return None
        return lag * (self.settings.period / self.settings.pace)

    @property
    def _is_surely_lost(self) -> bool:
        """Whether a lost drive has shown for long enough to be reported."""
        is_confirmed = self._contrary >= _REPORTING.confirm
        if self._acts_within_sample and not self._balance.earned:
            # A balance that has not predicted this plant may not know how late it follows.
            lasted = (self._contrary + self._effect.length) * self.settings.pace
            return is_confirmed and lasted >= _REPORTING.shows
        return is_confirmed

    @property
    def _is_surely_weak(self) -> bool:
        """Whether a weak drive has shown for long enough to be reported."""
        lasted = self._feeble * self.settings.pace
        return self._balance.smooth and lasted >= _REPORTING.weakly

    def _lost_drive(self, index: int) -> Evidence:
        """The evidence for a lost drive or, as long as larger losses may explain the same, for what is known of
        either."""
        losses_may_explain = self._losses_may_explain
        cannot_compare = self._lagged_effect is not None and not self._slow.compares
        missing = self._sentences.lost(
            index,
            self._effect,
            sure=self._is_surely_lost,
            lagged=losses_may_explain or cannot_compare,
        )
        if not losses_may_explain:
            return missing
        named = self._slow.evidence
        if named is not None and named.sure and named.fault is not Fault.DRIFT:
            return named
        return missing._replace(fault=Fault.DRIFT)

    @property
    def _losses_may_explain(self) -> bool:
        """Whether larger losses may explain a missing effect as well: behind a lag, they do for a minute."""
        is_comparable = (
            self._lagged_effect is not None and not self._blind and self._slow.compares
        )
        if not is_comparable or self._slow.blames_drive:
            return False
        lasts = self._index - self._alarms[-1].flagged if self._unsettled else 0
        return (
            lasts * self.settings.pace < _REPORTING.shows
            or self._effect.share > NOTHING
        )

    @property
    def _unsettled(self) -> bool:
        """Whether the alarm that is on says that the drive or the losses have changed."""
        return (
            self._open
            and self._alarms[-1].fault is Fault.DRIFT
            and not self._is_tracked
        )

    def _learn(self) -> None:
        """Learn from a block once it is full, unless something was wrong in it."""
        full = self._balance.block()
        if full is None:
            return
        quiet = self._quiet * self.settings.pace >= BLOCK
        if not self._open:
            self._balance.compare(*full)
        self._balance.learn(*full, healthy=quiet and not self._slow.suspected)
        if quiet:
            self._try()

    def _judge(
        self, index: int, evidence: Evidence | None, *, starting: bool
    ) -> Alarm | None:
        """Open and close alarms; return the one that changed."""
        # A refused reading that was replaced interrupts nothing: the sample remains usable.
        is_replaced = (
            evidence is not None
            and evidence.fault is _REFUSED
            and self._before is not None
        )
        if evidence is not None and not evidence.tracked and not is_replaced:
            self._quiet = self._proofs = 0
        else:
            self._quiet += 1
            self._proofs += self._effect.follows
        if evidence is not None and evidence.sure and not starting:
            news = self._raise(index, evidence)
            if news is not None:
                return news
        if self._open and self._recovered():
            if (
                self._alarms[-1].fault in _OF_THE_DRIVE
                and self._acts_within_sample
                and not self._is_tracked
            ):
                # stretches that reach back into the fault show it still
                self._restart_traces()
                self._slow.restart()
            if self._brief:
                return self._close(self._refused_at)
            return self._close(index - (1 if self._is_tracked else self._quiet))
        return None

    def _raise(self, index: int, evidence: Evidence) -> Alarm | None:
        """Open an alarm, in place of the one that is on if this fault may replace it; None if it may not."""
        earliest = self._earliest_begin()
        if self._open:
            self._note_tracked(index, evidence)
            if not self._may_replace(evidence):
                return None
            is_same_trace = self._unsettled and evidence.fault not in SLOW
            if self._brief:
                self._close(self._refused_at)
            elif is_same_trace:
                began = min(evidence.first, self._alarms[-1].first)
                evidence = evidence._replace(first=began)
                self._close(index - 1)
            else:
                earliest = index
                self._close(index - 1)
        self._alarms.append(
            Alarm(
                evidence.fault,
                max(evidence.first, earliest),
                index,
                None,
                evidence.reason,
                spoils=evidence.fault not in SLOW and evidence.fault is not _REFUSED,
                signal=self._sentences.signal(evidence.fault),
            )
        )
        self._begun(index, evidence)
        return self._alarms[-1]

    def _earliest_begin(self) -> int:
        """The sample from which on the trace of an alarm counts: behind the newest alarm that is over. A few refused
        readings end no trace."""
        ends = [a.last for a in self._alarms if a.last is not None and a.alters]
        return max(self._begin, ends[-1] + 1) if ends else self._begin

    def _note_tracked(self, index: int, evidence: Evidence) -> None:
        """Note that the tracker has found the fault of the alarm that is on, which the drive's effect has reported."""
        on = self._alarms[-1].fault
        is_of_alarm = evidence.tracked and evidence.fault is on
        if is_of_alarm and self._slow.reported is None:
            self._slow.mark_reported(index)
            self._is_tracked = self._is_tracked or on is Fault.DRIFT

    def _may_replace(self, evidence: Evidence) -> bool:
        """Whether an alarm of this fault may replace the one that is on."""
        on = self._alarms[-1].fault
        preceding = (
            frozenset(Fault) - {_REFUSED} if self._brief else PRECEDENCE.get(on, ())
        )
        if evidence.fault not in preceding:
            return False
        return evidence.fault is not _REFUSED or self._refused >= _REPORTING.confirm

    def _begun(self, index: int, evidence: Evidence) -> None:
        """Have every part know of an alarm that has begun."""
        self._open = True
        self._is_tracked = evidence.tracked
        self._balance.forget_newest()
        self._slow.propose(None)
        if evidence.fault is Fault.DISTURBANCE and not self._acts_within_sample:
            self._restart_traces()  # stretches that reach back into it lack an effect
        if evidence.fault in _OF_THE_DRIVE and isinstance(self._effect, Effect):
            self._effect.accuse()
        if self._blind:
            self._slow.restart()
        elif evidence.tracked:
            self._slow.mark_reported(index)

    def _recovered(self) -> bool:
        """Whether the fault that is on is over."""
        fault = self._alarms[-1].fault
        quiet = self._quiet * self.settings.pace
        proven = self._proofs * self.settings.pace
        if self._alarms[-1].withdrawn:
            return True
        if self._is_tracked:
            return self._slow.over(self._index)
        if (
            fault in _OF_THE_DRIVE
            and self._acts_within_sample
            and isinstance(self._effect, Effect)
        ):
            return self._effect.returned >= _REPORTING.over
        if fault in (*_OF_THE_DRIVE, Fault.SENSOR_LATE, Fault.DRIFT):
            suspected = fault is Fault.DRIFT and self._slow.suspected
            return (
                proven >= _REPORTING.prove or quiet >= _REPORTING.unproven
            ) and not suspected
        if self._brief:
            return (
                self._index - self._refused_at
            ) * self.settings.pace >= _REPORTING.recovered
        return quiet >= _REPORTING.recovered

    def _close(self, last: int) -> Alarm:
        """End the alarm that is on, whose trace had this last sample."""
        self._alarms[-1] = replace(self._alarms[-1], last=last)
        self._open = False
        return self._alarms[-1]

    def _health(
        self,
        index: int,
        evidence: Evidence | None,
        news: Alarm | None,
        *,
        starting: bool,
    ) -> Health:
        share = self._effect.share
        rate = self._slow.rate
        if self._open:
            alarm = self._alarms[-1]
            is_same = evidence is not None and evidence.fault is alarm.fault
            reason = (
                evidence.reason if evidence is not None and is_same else alarm.reason
            )
            since = alarm.first
            signal = alarm.signal
            return Health(
                index,
                HealthState.FAULT,
                alarm.fault,
                since,
                reason,
                share,
                rate,
                news,
                signal,
            )
        if evidence is None:
            return Health(index, HealthState.HEALTHY, None, None, "", share, rate, news)
        # At the start a late camera looks like a dead drive, and is far more common.
        may_be_camera = starting and evidence.fault in _OF_THE_DRIVE
        fault = None if may_be_camera else evidence.fault
        reason = f"during start-up: {evidence.reason}" if starting else evidence.reason
        first = max(evidence.first, self._begin)
        return Health(
            index, HealthState.SUSPECT, fault, first, reason, share, rate, news
        )
