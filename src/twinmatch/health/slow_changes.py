"""Slow changes of a plant, from first suspicion to end: reported by name, or as an unnamed drift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from twinmatch.dynamics import Parameters
from twinmatch.dynamics.tracker import Belief
from twinmatch.health.changes import ChangeDetector, DetectedChange, Hypothesis
from twinmatch.health.faults import TRAITS, Evidence, Fault
from twinmatch.health.sentences import FaultSentences
from twinmatch.health.settings import HealthSettings
from twinmatch.health.trial import TwinOnTrial
from twinmatch.settings import Rule
from twinmatch.signals import Sample


class _SlowReports(Rule):
    """When a slow change is reported."""

    agreeing: int = 2
    """Consecutive comparisons that must agree on the kind of change."""
    unnamed: float = 2.0
    """Factor on the gain required of a change that has no cause, over that of one that has."""
    name_wait: float = 60.0
    """Time to wait for a name before an unnamed change is reported, s."""
    moved: float = 10.0
    """What has passed is reported if it moved the output by so many standard deviations of its noise."""
    clearly: float = 2.0
    """Lead of another cause over shifted readings that excludes them, as a multiple of the lead that a name
    needs."""


_REPORTS: Final = _SlowReports()


class _SlowEnds(Rule):
    """When a reported change is over."""

    accept: float = 600.0
    """Time after which a reported change counts as the plant's normal state, s; shifted readings never
    do."""
    remainder: float = 0.4
    """Share of a change that may remain when it counts as over."""
    grown: float = 2.0
    """Greatest factor by which a doubted shift may have grown until the readings come back."""
    doubted: float = 15.0
    """Least shift of readings that are doubted, in standard deviations of their noise."""


_ENDS: Final = _SlowEnds()


@dataclass
class _Reported:
    """The change that was reported last."""

    fault: Fault
    hypothesis: Hypothesis
    before: float
    """Value of the number before the change."""
    at: int
    """Sample at which it was reported."""
    beliefs: Sequence[Belief]
    """What was believed before the change, at every level."""


@dataclass
class _Shift:
    """Readings that have shifted, or may have."""

    size: float
    """In the output's unit."""
    since: int
    """Sample at which it was first believed."""
    before: float = 0.0
    """The believed offset of the readings before the shift."""
    named: bool = False
    """Whether it was reported by name: then the tracker follows it."""
    open: bool = True
    """Whether the comparison in which it came up continues."""


def _changes_the_same(reported: _Reported, hypothesis: Hypothesis) -> bool:
    """Whether a hypothesis is about the number of the reported change, so that it may be its end or
    growth."""
    if reported.fault is Fault.DRIFT and hypothesis.fault is Fault.SENSOR_DRIFT:
        return False  # what was reported without a name has one now
    return reported.hypothesis.index == hypothesis.index


class SlowChanges:
    """Turns what `ChangeDetector` detects into evidence for the monitor."""

    def __init__(
        self,
        settings: HealthSettings,
        sentences: FaultSentences,
        *,
        steps: bool = False,
    ) -> None:
        """Begin without samples; `steps`: whether only a sensor that has shifted makes a step."""
        self._settings = settings
        self._sentences = sentences
        self._steps = steps
        self._detector = ChangeDetector(settings.followed, settings.period, steps=steps)
        self._proposed: Parameters | None = None
        self._trial: TwinOnTrial | None = None
        self._change: DetectedChange | None = None
        self._reported: _Reported | None = None
        self._shift: _Shift | None = None
        self._likely = 0  # comparisons in a row in which the readings may have shifted
        self._over = False  # whether the reported change is reversed
        self.evidence: Evidence | None = None
        """The current evidence, if any."""
        self._agreeing = 0  # comparisons in a row that found this kind of change
        # sample from which on a name has been waited for
        self._unnamed_since: int | None = None

    @property
    def reported(self) -> Fault | None:
        """The last reported fault, unless it is over."""
        return self._reported.fault if self._reported is not None else None

    @property
    def earned(self) -> bool:
        """Whether the plant has been predicted far better than by saying that nothing changes."""
        return self._detector.track_record.earned

    @property
    def suspected(self) -> bool:
        """Whether something seems to have changed."""
        return self.evidence is not None

    @property
    def compares(self) -> bool:
        """Whether causes can be compared: the plant is known, and follows its equations."""
        return self.earned and self._detector.compares

    @property
    def blames_drive(self) -> bool:
        """Whether a lost drive explains the readings far better than anything else."""
        change = self._change
        if change is None or change.hypothesis.fault is not Fault.DRIVE_LOST:
            return False
        return change.lead >= self._settings.lead

    @property
    def rate(self) -> float:
        """Unexplained movement of the output, in its unit per second."""
        return self._detector.push_rate

    @property
    def offset(self) -> float:
        """By how much the readings are known to be shifted, in the output's unit."""
        return self._detector.offset

    @property
    def doubt(self) -> str:
        """Why no reading can be relied on, in words; empty unless the readings have shifted, or may have."""
        shift = self._shift
        if shift is None:
            return ""
        return self._sentences.doubted(
            self.offset - shift.before if shift.named else shift.size
        )

    def restart(self, *, offset: bool = False) -> None:
        """Start over after a gap or a fault; with `offset`, the reading may be off from now on.

        What was off stays off: time without readings does not show that they are right again.
        """
        self._detector.restart(offset=offset)
        if self._trial is not None:
            self._trial.detector.restart(offset=offset)
        if self.reported is not Fault.SENSOR_DRIFT:
            self._reported = None
        self._leave_doubt(lasting=True)
        self._clear_suspicion()

    def propose(self, parameters: Parameters | None) -> None:
        """Follow this twin instead once it has predicted the plant far better; None: a fault may have touched
        what is on trial."""
        self._proposed = parameters
        if parameters is None:
            self._trial = None

    def forget(self) -> None:
        """Start over with an unknown plant."""
        self._trial = None
        self._detector = ChangeDetector(
            self._settings.followed, self._settings.period, steps=self._steps
        )
        self._reported = self._shift = None
        self._clear_suspicion()

    def mark_reported(self, index: int) -> None:
        """Note that the evidence was reported; the changed plant is the baseline from now on."""
        change = self._change
        assert change is not None and self.evidence is not None  # noqa: PT018, S101
        self._reported = _Reported(
            self.evidence.fault,
            change.hypothesis,
            change.before,
            index,
            self._detector.before,
        )
        self._over = False
        if self.evidence.fault is Fault.SENSOR_DRIFT and not (
            self._shift and self._shift.named
        ):
            self._shift = _Shift(
                change.shift, index, change.before, named=True, open=False
            )
        traits = TRAITS[self.evidence.fault]
        if not traits.unnamed and not traits.blinds:
            # what has no name is an error of the twin
            self._detector.track_record.forget_newest()
        if (
            self.evidence.fault is not Fault.DRIFT
            or change.hypothesis.fault is Fault.DRIFT
        ):
            self._adopt(lasting=self.evidence.fault is Fault.DRIFT)
        self._expect_back()

    def over(self, index: int) -> bool:
        """Whether the reported change is over: reversed, or accepted as the plant's normal state."""
        if self._reported is None:
            return True
        is_accepted = (index - self._reported.at) * self._settings.pace >= _ENDS.accept
        over = self._over or (
            is_accepted and self._reported.fault is not Fault.SENSOR_DRIFT
        )
        if over:
            self._reported = None
        return over

    def push(self, sample: Sample) -> None:
        """Take a sample."""
        shift = self._shift
        if (
            shift
            and shift.named
            and abs(self.offset - shift.before) <= _ENDS.remainder * abs(shift.size)
        ):
            self._end_shift()
        self._detector.changed = (
            self.reported is not None and TRAITS[self.reported].another_plant
        )
        self._begin_trial()
        change = self._detector.push(sample)
        if self._trial is not None:
            self._try(self._trial, sample)
        if change is None:
            if not self._detector.suspected:
                self._over = self._over or self._ends_with_suspicion
                self._leave_doubt(lasting=self._lasted(sample.index))
                self._clear_suspicion()
            return
        fault = change.hypothesis.fault
        self._agreeing = (
            self._agreeing + 1
            if self._change and self._change.hypothesis.fault is fault
            else 1
        )
        self._change = change
        self._doubt_readings(change, sample.index)
        if not self._needs_no_report(change, sample.index):
            self.evidence = self._evidence(change, sample.index)

    def _begin_trial(self) -> None:
        """Try the proposed twin if its structure is another, or the followed one has not earned a name."""
        idle = (
            self._trial is None
            and self._reported is None
            and self._detector.tracked.between_blocks
        )
        if self._proposed is None or not idle:
            return
        settings = replace(self._settings, reference=self._proposed)
        self._proposed = None
        if (
            settings.followed.model is not self._settings.followed.model
            or not self.earned
        ):
            self._trial = TwinOnTrial(settings, self._detector, steps=self._steps)

    def _try(self, trial: TwinOnTrial, sample: Sample) -> None:
        """Have the twin on trial take a sample, too; follow it if it wins and nothing seems to be wrong."""
        trial.push(sample)
        faulty = (
            self._reported is not None
            or self._shift is not None
            or (self.suspected and self.earned)
        )
        if trial.won and not faulty:
            self._settings = trial.settings
            self._detector = trial.detector
            self._clear_suspicion()
            self._trial = None
        elif trial.lost:
            self._trial = None

    def _doubt_readings(self, change: DetectedChange, index: int) -> None:
        """Doubt the readings while nothing explains clearly more than that they have shifted."""
        settings = self._settings
        shift = self._shift
        behind = change.behind(Fault.SENSOR_DRIFT)
        least = _ENDS.doubted * settings.followed.model.plant.output.noise
        near = behind <= _REPORTS.clearly * settings.lead and abs(change.off) >= least
        is_evident = (
            change.gain - behind >= settings.change and change.begun and self.earned
        )
        sure = is_evident and self._separable(change)
        if shift is None:
            self._likely = self._likely + 1 if near and sure else 0
            if self._likely >= _REPORTS.agreeing:
                self._shift = _Shift(change.off, index)
        elif shift.open:
            self._likely = _REPORTS.agreeing if near else self._likely - 1
            if self._likely <= 0:
                self._end_shift()
            elif near:
                shift.size = change.off
        self._expect_back()

    def _expect_back(self) -> None:
        shift = self._shift
        offset = 0.0
        if shift is not None:
            offset = self.offset - shift.before if shift.named else shift.size
        self._detector.expect_back(-offset)

    def _lasted(self, index: int) -> bool:
        """Whether the readings have been doubted for as long as a name is waited for."""
        since = index if self._shift is None else self._shift.since
        return (index - since) * self._settings.pace >= _REPORTS.name_wait

    def _adopt(self, before: Sequence[Belief] = (), *, lasting: bool) -> None:
        """Learn the change, or that all is as `before`; `lasting`: a doubt that came up with it stays."""
        self._detector.adopt(before)
        self._leave_doubt(lasting=lasting)
        self._clear_suspicion()

    def _leave_doubt(self, *, lasting: bool) -> None:
        """The comparison in which a doubt came up has ended; `lasting`: without an answer."""
        if self._shift is not None and self._shift.open:
            self._shift.open = False
            if not lasting:
                self._end_shift()

    def _end_shift(self) -> None:
        self._over = self._over or self.reported is Fault.SENSOR_DRIFT
        self._shift = None
        self._likely = 0
        self._detector.expect_back(0.0)

    def _clear_suspicion(self) -> None:
        self.evidence = None
        self._change = None
        self._agreeing = 0
        self._unnamed_since = None

    @property
    def _ends_with_suspicion(self) -> bool:
        """Whether the reported change is over once nothing is suspected, as it has no number that could
        return."""
        return self._reported is not None and self._reported.fault in (
            Fault.DRIFT,
            Fault.DISTURBANCE,
        )

    def _needs_no_report(self, change: DetectedChange, index: int) -> bool:
        """Whether the change needs no report: always there, or the end or growth of a reported one."""
        if change.gain < self._settings.change or self._agreeing < _REPORTS.agreeing:
            return False
        returned = self._is_return(change)
        if returned:
            self._end_shift()
        if returned or not change.begun:
            self._adopt(lasting=self._lasted(index))
            return True
        reported = self._reported
        h = change.hypothesis
        if h.fault is Fault.DISTURBANCE:
            return self._absorbed(change)
        is_same = reported is not None and _changes_the_same(reported, h)
        if not is_same and h.parameter:
            return False
        usual = reported.before if reported is not None and is_same else 0.0
        remaining = change.value - usual
        back = abs(remaining) <= max(
            _ENDS.remainder * max(abs(change.shift), abs(change.before - usual)),
            h.least,
        )
        if not back and (not is_same or change.lead < self._settings.lead):
            return False
        before: Sequence[Belief] = ()
        if back and is_same and reported is not None:
            self._over = True
            before = reported.beliefs if TRAITS[reported.fault].another_plant else ()
        self._detector.track_record.forget_newest()
        self._adopt(before, lasting=True)
        return True

    def _is_return(self, change: DetectedChange) -> bool:
        """Whether readings that were only doubted are back where they were."""
        shift = self._shift
        if (
            shift is None
            or shift.named
            or shift.open
            or change.hypothesis.fault is not Fault.SENSOR_DRIFT
        ):
            return False
        # more than all of it, if it has grown since
        undone = -change.shift / shift.size
        return (
            1.0 - _ENDS.remainder <= undone <= _ENDS.grown
            and change.lead >= self._settings.lead
        )

    def _absorbed(self, change: DetectedChange) -> bool:
        """Whether what has passed needs no report: too small, or while a reported change is on."""
        if not self._surely_passed(change) or (
            self._reported is None and self._passage() is not None
        ):
            return False
        self._adopt(lasting=False)
        return True

    def _surely_passed(self, change: DetectedChange) -> bool:
        """Whether something that has passed explains far more than anything that would have lasted."""
        clearly = change.gain >= self._enough_unnamed
        return (
            clearly
            and change.lead >= self._settings.lead
            and self._agreeing >= _REPORTS.agreeing
        )

    @property
    def _enough_unnamed(self) -> float:
        """Gain required of what has no cause: a wrong twin, which misses such movements, is its rival."""
        return (
            _REPORTS.unnamed
            * self._settings.change
            * self._detector.track_record.missed
        )

    def _passage(self) -> tuple[float, float] | None:
        """How far something that has passed moved the output, and how long it lasted, s; None if that is too
        little to be reported."""
        assert self._change is not None  # noqa: S101
        pushes = self._detector.pushes()
        block = self._detector.block
        strong = np.abs(pushes) >= self._change.hypothesis.least * block
        noise = self._settings.followed.model.plant.output.noise
        if not strong.any() or np.abs(pushes).sum() < _REPORTS.moved * noise:
            return None
        return float(pushes.sum()), int(strong.sum()) * block

    def _evidence(self, change: DetectedChange, index: int) -> Evidence:
        """The evidence for a change."""
        h = change.hypothesis
        settings = self._settings
        enough = self._is_evident(change)
        material = abs(change.shift) >= h.least
        named = self._has_name(change)
        if named and h.fault is Fault.DRIVE_LOST:
            return Evidence(
                Fault.DRIVE_LOST, enough, change.first, self._sentence(change)
            )
        if named and h.fault is Fault.DISTURBANCE:
            has_passed = self._surely_passed(change) and enough
            reason = self._sentences.passed(*self._passage() or (0.0, 0.0))
            return Evidence(
                Fault.DISTURBANCE, has_passed, change.first, reason, tracked=True
            )
        if named:
            sure = enough and material
            reason = self._sentence(change)
            return Evidence(h.fault, sure, change.first, reason, tracked=True)
        if enough and self._unnamed_since is None:
            self._unnamed_since = index
        waited = self._unnamed_since is not None and (
            (index - self._unnamed_since) * settings.pace >= _REPORTS.name_wait
        )
        sure = enough and material and waited and change.gain >= self._enough_unnamed
        return Evidence(
            Fault.DRIFT, sure, change.first, self._ambiguous(change), tracked=True
        )

    def _is_evident(self, change: DetectedChange) -> bool:
        """Whether there is enough evidence that something has changed, whatever it is."""
        if self._agreeing < _REPORTS.agreeing or change.gain < self._settings.change:
            return False
        return change.begun and self.earned

    def _has_name(self, change: DetectedChange) -> bool:
        """Whether the cause that explains a change best may be named."""
        h = change.hypothesis
        if change.lead < self._settings.lead or h.fault is Fault.DRIFT:
            return False
        if h.vague and not h.ceases:
            return False  # it stands for anything that acts like it
        if h.fault is Fault.DRIVE_WEAK:
            # A lost drive is found by `Effect`, and one that does more has no fault name.
            return (
                change.shift < 0.0 and self._settings.lost - 1.0 <= change.value < 0.0
            )
        return h.fault is not Fault.SENSOR_DRIFT or self._separable(change)

    def _separable(self, change: DetectedChange) -> bool:
        """Whether shifted readings have a rival; changed surroundings, if not modelled, look the same."""
        kinds = (change.hypothesis.fault, *change.rivals)
        return Fault.ROOM_CHANGED in kinds or Fault.LOSSES_CHANGED in kinds

    def _ambiguous(self, change: DetectedChange) -> str:
        """Describe a change that the samples cannot attribute to one cause."""
        gains = zip(change.rivals, change.gains, strict=True)
        near = [
            TRAITS[fault].cause
            for fault, gain in gains
            if gain > change.gain - self._settings.lead
        ]
        names = list(dict.fromkeys([TRAITS[change.hypothesis.fault].cause, *near]))
        listed = (
            " or ".join(names)
            if len(names) < 3
            else f"{', '.join(names[:-1])} or {names[-1]}"
        )
        return (
            f"the plant no longer behaves as before; {listed} may have changed, "
            f"which these readings cannot distinguish: look at {self._sentences.surroundings}"
        )

    def _sentence(self, change: DetectedChange) -> str:
        """What has changed, by how much, and where to look."""
        h = change.hypothesis
        parameter = self._settings.followed.model.declared.get(h.parameter)
        share = 1.0 + change.value
        return self._sentences.changed(h.fault, parameter, change.shift, share)
