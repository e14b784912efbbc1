"""The engine: takes samples and matches, returns verdicts."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from twinmatch.comparing import ADMITTED, REFUSED, Candidate, Verdict
from twinmatch.defects import Defect, defect_of, log_once
from twinmatch.dynamics.movement import InputEffect
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import Status
from twinmatch.fitting.excitation import unexpected_movement, why_not_moved
from twinmatch.fitting.match import not_determined
from twinmatch.health import SLOW, Alarm, EstimatedReading, Health, HealthState, Monitor
from twinmatch.signals import FloatArray, Sample, Signals, Window
from twinmatch.twin.candidates import CandidatePool, FamilyModels, name_at
from twinmatch.twin.door import Door
from twinmatch.twin.forecaster import Forecaster, Snapshot
from twinmatch.twin.knowledge import Knowledge, MatchResult, no_verdict, verdict_of
from twinmatch.twin.law_on_estimates import LawOnEstimates
from twinmatch.twin.matcher import MatchReport, MatchRequest, carry_out, one_thread
from twinmatch.twin.mirror import Residuals, residuals
from twinmatch.twin.schedule import Schedule, Trigger
from twinmatch.twin.settings import TwinSettings
from twinmatch.twin.structure_fits import watched
from twinmatch.twin.trust import BandCheck, BandHistory

if TYPE_CHECKING:
    from twinmatch.health.channels import ChannelMonitor

MAX_STAMPS = 10_000
"""Number of samples for which stamps are kept for verdicts still due."""


class Step(NamedTuple):
    """The results of one sample or match."""

    verdicts: tuple[Verdict, ...]
    """Verdicts in order."""
    request: MatchRequest | None
    """The match to request now; its answer is awaited."""
    snapshots: tuple[Snapshot, ...] = ()
    """The candidates' outlooks at every sample that they have taken now, lost ones excepted; empty unless the
    discriminator was made with `snapshots`."""
    settled: tuple[Sample, ...] = ()
    """The samples that it has taken now, and stand-ins, as the door settled them."""
    estimates: tuple[EstimatedReading, ...] = ()
    """Of sensors that were not believed at these samples, what they should have read."""


class _Recurring(NamedTuple):
    """A defect that may be raised at every sample."""

    place: str
    reported: int
    """Sample of the newest verdict that reported it."""
    newest: int
    """Newest sample at which it was raised."""


class Discriminator:
    """Judges the family at every trigger of the schedule, and the plant's health at every sample.

    It alone owns schedule and family. At an excited trigger it requests a match of that window and waits for
    the answer; samples that arrive meanwhile are queued. So a request depends only on the samples before it,
    the order of verdicts does not depend on when matches arrive, and live nodes and a replay give the same
    verdicts. A fault of the plant is reported immediately, by a verdict between the triggers.

    An error of this program's own ends no run: the verdict of that sample says what was raised and where, and
    the part that raised it, whose state may be half changed, starts over. The other parts continue as behind
    a lost sample.
    """

    def __init__(
        self,
        settings: TwinSettings | None = None,
        given: Sequence[Candidate] = (),
        *,
        snapshots: bool = False,
    ) -> None:
        """Begin with the given candidates only.

        Those that are exact are judged on the first excited window. Remembered ones forecast from the first
        sample on, and what they say of the parameters is the prior of all fits.

        `snapshots`: whether steps have them. A snapshot takes longer than a sample without one.
        """
        self._snapshots = snapshots
        self.stamps: dict[int, int] = {}
        """Stamps of the newest samples and stand-ins, ns, by index."""
        self._uninformed = settings or TwinSettings()
        """The settings without what remembered candidates say."""
        self.settings = self._uninformed.informed_by(given)
        self._candidates_at_start = tuple(given)
        self._external = [
            model for model in watched(self.settings.plant) if model.is_external
        ]
        self._door = Door(self.settings)
        self._steps_recurred = False
        """Whether refused steps have recurred, and the fault of them has been taken back."""
        self._watched: int | None = None
        """The newest sample, once the plant's health has been judged at it."""
        self._settled: int | None = None
        self._recent: deque[Sample] = deque(maxlen=self.settings.schedule.stride)
        self._health: Health | None = None
        self._fault_before: Health | None = None
        """The fault that was on when the monitor had to start over; it counts until another one is seen."""
        self.defects: dict[str, Defect] = {}
        """Defects of this program that prevented verdicts, by their places."""
        self._recurring: _Recurring | None = None
        self._begin_health()
        self._begin_candidates()
        self._law_on_estimates = self._new_law_on_estimates()
        self._last_on_estimate: int | None = None
        """Newest sample at which the law took an estimate in place of a reading."""
        self._trials: dict[int, float] = {}
        """By the first sample at which a law on trial drove the last one; infinite while it drives."""

    def _begin_door(self) -> None:
        """Settle samples without knowing any before."""
        self._door.restart()
        self._steps_recurred = False

    def _begin_health(self) -> None:
        """Watch the plant's health without a past; a fault that is on stays on."""
        if self._health is not None and self._health.state is HealthState.FAULT:
            self._fault_before = self._health
        self.monitor = _monitor(self.settings)

    def _begin_candidates(self) -> None:
        """Schedule and candidates as at the start."""
        candidates = self._candidates_at_start
        self._schedule = _schedule(self.settings)
        self._pool = CandidatePool(
            self.settings,
            self.spoilt,
            [candidate for candidate in candidates if candidate.remembered],
        )
        self._bands = BandHistory(
            self.settings.limits.doubtful, self.settings.noise.all[0]
        )
        self._given = [
            candidate for candidate in candidates if not candidate.remembered
        ]
        self._due: Trigger | None = None
        self._request: MatchRequest | None = None
        self._trusted: tuple[float, ...] = ()

    def tell_of_trial(self, first: int, last: float = math.inf) -> None:
        """Learn that a law on trial drove from sample `first` to `last`.

        Nothing is matched on these samples or learned from them, since forecasts are for the law before.
        """
        self._trials[first] = last

    def _trial_between(self, first: int, last: int) -> str:
        """That a law on trial drove between two samples, in words; empty if none did."""
        begins = [
            begin
            for begin, end in self._trials.items()
            if begin <= last and end >= first
        ]
        return f"a law on trial has driven since sample {begins[-1]}" if begins else ""

    def _forecasts_of_trial(self, samples: int) -> str:
        """Why the newest samples are not compared with what was forecast for them; empty if they are.

        They are not where a law on trial drove when the forecasts were made, or has driven since.
        """
        newest = self._recent[-1].index
        reach = samples + max(self.forecaster.horizons)
        if not self._trial_between(newest - reach, newest):
            return ""
        ends = max(end for begin, end in self._trials.items() if begin <= newest)
        if ends >= newest:
            return "a law is on trial: its samples are not compared with forecasts for the law before"
        over = f"a law on trial drove until sample {ends:.0f}"
        return f"{over}: measurements are compared with forecasts again after sample {ends + reach:.0f}"

    @property
    def forecaster(self) -> Forecaster:
        """The forecaster of all candidates, at the newest settled sample."""
        return self._pool.forecaster

    @property
    def request(self) -> MatchRequest | None:
        """The request whose answer is awaited, if any; sending it again gives the same answer."""
        return self._request

    @property
    def settled(self) -> int | None:
        """Index of the newest sample with all its verdicts given; None before the first."""
        return self._settled if self._request is None else self._request.sample - 1

    @property
    def nominal(self) -> Candidate | None:
        """The current nominal candidate."""
        return self._pool.nominal

    @property
    def models(self) -> FamilyModels:
        """Box–Jenkins models of the twins of the current family."""
        return self._pool.models

    def push_sample(self, sample: Sample) -> Step:
        """Take one sample; return the verdicts now due, and the match to request.

        A few samples lost before it get stand-ins, and so do a few refused readings; these count nowhere.
        After more, everything starts over.
        """
        self._door.push(sample)
        return Step((), None) if self._request is not None else self._settle([])

    def settle_rest(self, samples: Iterable[Sample]) -> list[Sample]:
        """Settle the samples that follow, which nothing else takes: this discriminator ends here."""
        for sample in samples:
            self._door.push(sample)
        return self._door.settled()

    def push_match(self, report: MatchReport) -> Step:
        """Take one match; return the verdicts now due, and the next match to request.

        An unexpected match is ignored: a repeated answer, or one to another discriminator.
        """
        if self._request is None or not report.answers(self._request):
            return Step((), None)
        self._request = None
        trigger = self._due
        assert trigger is not None  # noqa: S101
        verdicts: list[Verdict] = []
        try:
            verdicts.append(self._judge(trigger, self._admit(trigger, report)))
        except Exception as error:
            verdicts += self._start_over(error, trigger.sample, self._begin_candidates)
        return self._settle(verdicts)

    def _settle(self, verdicts: list[Verdict]) -> Step:
        """Process the queue until it is empty or a match is needed."""
        snapshots: list[Snapshot] = []
        settled: list[Sample] = []
        estimates: list[EstimatedReading] = []
        while (sample := self._next(verdicts)) is not None:
            settled.append(sample)
            self._settled = sample.index
            self.stamps[sample.index] = sample.stamp
            if len(self.stamps) > MAX_STAMPS:
                del self.stamps[next(iter(self.stamps))]
            outputs_taken = self._taken_by_law(sample)
            self._watched = None
            try:
                self._watch(sample)
            except Exception as error:
                verdicts += self._start_over(error, sample.index, self._begin_health)
            if self._watched is None:
                continue
            estimates += self.monitor.estimates
            try:
                verdicts += self._take(sample, outputs_taken)
                if (
                    self._snapshots
                    and sample.usable
                    and (sample.seen or sample.refused)
                ):
                    snapshots.append(self.forecaster.snapshot())
                verdicts += self._scheduled(sample)
            except Exception as error:
                verdicts += self._start_over(
                    error, sample.index, self._begin_candidates
                )
            if self._request is not None:
                break
        return Step(
            tuple(verdicts),
            self._request,
            tuple(snapshots),
            tuple(settled),
            tuple(estimates),
        )

    def _scheduled(self, sample: Sample) -> list[Verdict]:
        """The verdicts on the window that a sample completes, unless its match has to be requested first."""
        if not sample.usable:
            return []
        self._due = self._schedule.push(sample)
        return [] if self._due is None else self._on_trigger(self._due)

    def _next(self, verdicts: list[Verdict]) -> Sample | None:
        """The next settled sample; None once nothing waits at the door.

        The door settles a sample only when all before it have been taken: it learns from their verdicts.
        """
        oldest = self._door.oldest
        if oldest is None:
            return None
        settled: Sample | None = None
        try:
            settled = self._door.next()
        except Exception as error:
            verdicts += self._start_over(error, oldest.index, self._begin_door)
        # a door passes every sample on, also one at which it had a defect
        return replace(oldest, usable=False) if settled is None else settled

    def _start_over(
        self, error: Exception, sample: int, start_over: Callable[[], None]
    ) -> list[Verdict]:
        """Have a part start over that has raised an error, which no user can fix, at a sample.

        Returns the verdict that says so, in place of the one that could not be made, if it is due.
        """
        window = self._window_at(sample)
        start_over()
        defect = self._logged(error)
        if not self._is_due(sample, defect):
            return []
        return [self._no_verdict(sample, window, defect)]

    def _logged(self, error: Exception) -> Defect:
        """The defect behind an error, logged; an error that the user can fix is raised again."""
        if isinstance(error, TwinmatchError):
            raise error
        defect = defect_of(error)
        log_once("no verdict could be made", defect, self.defects)
        return defect

    def _window_at(self, sample: int) -> tuple[int, int]:
        """First and last sample of the window that was due at a sample, or of the newest ones."""
        if self._due is not None and self._due.sample == sample:
            return self._due.window.first, self._due.window.last
        return (self._recent[0].index if self._recent else sample), sample

    def _is_due(self, sample: int, defect: Defect) -> bool:
        """Whether a verdict reports a defect at a sample.

        One that is raised at every sample is reported as rarely as the schedule checks a quiet plant.
        """
        before = self._recurring
        if before is None or (before.place, before.newest) != (
            defect.place,
            sample - 1,
        ):
            self._recurring = _Recurring(defect.place, reported=sample, newest=sample)
            return True
        is_due = sample - before.reported >= self.settings.schedule.stride
        self._recurring = _Recurring(
            defect.place, sample if is_due else before.reported, sample
        )
        return is_due

    def _no_verdict(
        self, sample: int, window: tuple[int, int], defect: Defect
    ) -> Verdict:
        """The verdict in place of one that could not be made."""
        horizons = self.settings.forecasts.horizons
        verdict = no_verdict(
            sample,
            window,
            defect,
            health=self._health,
            horizons=horizons,
            decimals=self.settings.decimals,
        )
        self._law_on_estimates.take(verdict)
        return verdict

    def _on_trigger(self, trigger: Trigger) -> list[Verdict]:
        """Judge a window, or request its match."""
        if not trigger.excited:
            return [self._judge(trigger, MatchResult(reason=trigger.reason))]
        if reason := self._why_not_matched(trigger.window):
            return [self._judge(trigger, MatchResult(REFUSED, reason))]
        self._request = self._new_request(trigger)
        return []

    def _why_not_matched(self, window: Window) -> str:
        """Why samples do not show the plant as its law drives it; empty if they do."""
        first = window.first
        last = window.last
        if alarm := self.monitor.fault_between(first, last):
            return f"not matched: {alarm.fault.value} since sample {alarm.first}: {alarm.reason}"
        if self._last_on_estimate is not None and first <= self._last_on_estimate:
            return f"not matched: the law ran on an estimate until sample {self._last_on_estimate}"
        if lie := self.monitor.lie_between(first, last):
            return f"not matched: the readings of {lie.signal} were off from sample {lie.first} on"
        if trial := self._trial_between(first, last):
            return f"not matched: {trial}"
        return ""

    def _new_request(self, trigger: Trigger) -> MatchRequest:
        """The request for a trigger; its incumbent is the regime's current candidate."""
        with one_thread():
            while self._given:
                self._admitted(self._given.pop(0), trigger.window)
        candidate = self._pool.incumbent_at(trigger.operating_point)
        incumbent = candidate.parameters if candidate else None
        start = incumbent or self.settings.start
        if self._pool.estranged and start.model.structure_name in self.settings.prior:
            # in the structure of the memory, its values would be the prior
            start = self._uninformed.start
        return MatchRequest(
            sample=trigger.sample,
            operating_point=trigger.operating_point,
            window=trigger.window,
            start=start,
            incumbent=incumbent,
        )

    def _take(self, sample: Sample, taken: Signals | None) -> list[Verdict]:
        """Have all candidates take a sample at which the plant's health has been judged.

        `taken` are the outputs that the law took; None: those of the sample. Returns the verdict that is due
        if a fault has just begun or ended.
        """
        verdicts: list[Verdict] = []
        news = self._health.news if self._health is not None else None
        has_begun = news is not None and news.last is None
        gone = self._remove_spoilt(news) if news is not None and has_begun else ()
        if news is not None and news.excuses:
            self.forecaster.forget_since(news.first)
        if sample.usable:
            self.forecaster.push(sample, taken)
        if news is not None:
            reason = (
                news.withdrawn
                or f"{news.fault.value} is over: the plant responds normally again"
            )
            match = MatchResult(reason=news.reason if has_begun else reason)
            window = Window.from_samples(
                list(self._recent) or [sample], self.settings.period
            )
            with one_thread():
                self._pool.score_leader()
                verdicts.append(
                    self._verdict_of(
                        self._known(sample.index, window, match, dismissed=gone)
                    )
                )
        self.forecaster.notes = self._notes()
        return verdicts

    def _new_law_on_estimates(self) -> LawOnEstimates:
        return LawOnEstimates(self.settings.read_through, self.settings.period)

    def _taken_by_law(self, sample: Sample) -> Signals | None:
        """The outputs that the law took where sensors are read through; None: those of the sample.

        In place of a reading that a trusted twin has not believed for a while it takes what was estimated at
        the sample before.
        """
        if self._watched is None:
            return None
        taken = self._law_on_estimates.taken_after(
            self._watched, self.monitor.estimates
        )
        if not taken:
            return None
        self._last_on_estimate = sample.index
        return tuple(map(taken.get, self.settings.plant.outputs, sample.outputs))

    def _watch(self, sample: Sample) -> None:
        """Judge the plant's health at a sample; its `news` is an alarm that has just begun or ended."""
        if self._recent and not sample.follows(self._recent[-1]):
            is_other_session = not sample.continues(self._recent[-1])
            if is_other_session:
                # to which the indices of alarms and trials do not belong
                self.monitor = _monitor(self.settings)
                self._law_on_estimates = self._new_law_on_estimates()
                self._last_on_estimate = None
                self._trials = {}
                self._fault_before = None
            self._recent.clear()
        if sample.usable:
            self._recent.append(sample)
        nominal = self.nominal
        if (
            nominal is not None
            and self.monitor.fault_between(*nominal.samples, slow=True) is not None
        ):
            nominal = None  # it describes a plant at fault
        self._withdraw_recurring_steps()
        health = self.monitor.push(sample, nominal.parameters if nominal else None)
        if health.state is HealthState.FAULT:
            self._fault_before = None
        self._health = (
            health
            if self._fault_before is None
            else replace(self._fault_before, news=health.news)
        )
        self._watched = sample.index

    def _withdraw_recurring_steps(self) -> None:
        """Take back a fault of impossible readings once the door takes such steps for the plant's."""
        if (
            self._door.steps_recur
            and not self._steps_recurred
            and isinstance(self.monitor, Monitor)
        ):
            self._steps_recurred = True
            self.monitor.withdraw()

    def _remove_spoilt(self, alarm: Alarm) -> tuple[str, ...]:
        """Remove the candidates that were matched while the fault was already on; return their names."""
        if not alarm.spoils and not alarm.lies:
            if alarm.fault in SLOW:
                # the plant has changed since then, but still obeys its drive
                self._pool.structures.cut(alarm.first)
            return ()
        with one_thread():
            return self._pool.expel(alarm.first, alarm.flagged)

    def _judge(self, trigger: Trigger, match: MatchResult) -> Verdict:
        """The verdict on a window and on its match.

        If the window cannot be scored, the scores of the verdict before stand.
        """
        window = trigger.window
        pool = self._pool
        with one_thread():
            if not self._at_fault(window.first, window.last):
                pool.structures.push(window, excited=trigger.excited)
            dismissed = pool.leave_memory()
            pool.enter()
            was_matched = bool(match.word)
            scored = was_matched and not pool.empty
            if scored:
                try:
                    pool.score(window)
                except TwinmatchError as error:
                    scored = False
                    match = MatchResult(
                        match.word, f"nothing could be identified: {error}"
                    )
            if not scored:
                pool.score_leader()
            knowledge = self._known(
                trigger.sample, window, match, scored=scored, dismissed=dismissed
            )
            verdict = self._verdict_of(knowledge)
            self._door.learn(verdict)
            return verdict

    def _verdict_of(self, known: Knowledge) -> Verdict:
        """The verdict on what is known. If a defect prevents only this, no part has to start over."""
        try:
            verdict = verdict_of(known)
        except Exception as error:
            return self._no_verdict(known.sample, known.window, self._logged(error))
        self._trusted = verdict.trusted
        self._law_on_estimates.take(verdict)
        return verdict

    def _known(
        self,
        sample: int,
        window: Window,
        match: MatchResult,
        *,
        scored: bool = False,
        dismissed: tuple[str, ...] = (),
    ) -> Knowledge:
        """Who is asked for the verdict at a sample, when everything has taken it."""
        return Knowledge(
            sample=sample,
            window=(window.first, window.last),
            match=match,
            scored=scored,
            dismissed=dismissed,
            pool=self._pool,
            bands=self._check_bands(window),
            history=self._bands,
            residuals=self._residuals(window),
            health=self._health,
            monitor=self.monitor,
            trial=self._forecasts_of_trial(self._compared(window))
            if self._recent
            else "",
            trusted=self._trusted,
            decimals=self.settings.decimals,
        )

    def _compared(self, window: Window) -> int:
        """How many of the newest samples are compared with the bands when a window is judged."""
        return min(self.settings.schedule.stride, len(window))

    def _check_bands(self, window: Window) -> BandCheck:
        """How the newest samples lie in the bands that the leader forecast for them."""
        if not self._recent:
            return BandCheck()
        samples = self._compared(window)
        if self._forecasts_of_trial(samples):
            return BandCheck()
        check = self.forecaster.check_bands(samples)
        if check is None:
            return BandCheck()
        self._bands.push(check, self._recent[-1].index - samples + 1, samples)
        return check

    def _residuals(self, window: Window) -> Residuals:
        """Residuals of the nominal twin over the newest samples of a window; NaN without one."""
        nominal = self.nominal
        if nominal is None:
            return Residuals(float("nan"), float("nan"))
        alarms = [alarm for alarm in self.monitor.alarms if alarm.alters]
        end_of_fault = alarms[-1].last if alarms else None
        # before, residuals are not the twin's
        after_fault = 0 if end_of_fault is None else end_of_fault + 1
        first = max(
            window.first, window.last - self.settings.schedule.stride + 1, after_fault
        )
        newest = window.part(min(first, window.last), window.last)
        return residuals(nominal.parameters, newest, self.settings.law)

    def _notes(self) -> tuple[str, ...]:
        """Reservations on forecasts at this sample, and structures that no longer take part."""
        lost = tuple(
            f"{model.structure_name}: {model.lost}"
            for model in self._external
            if model.lost
        )
        health = self._health
        since = self._bands.since
        if self._settled is not None and (
            trial := self._trial_between(self._settled, self._settled)
        ):
            return (f"{trial}: this forecast is for the law before", *lost)
        if (
            health is not None
            and health.state is HealthState.FAULT
            and health.fault is not None
        ):
            fault = (
                f"the plant has shown {health.fault.value} since sample {health.since}"
            )
            return (f"{fault}: this forecast is for a healthy plant", *lost)
        if since is not None:
            outside = f"readings have been outside the bands since sample {since}"
            return (f"{outside}: these bands may not hold", *lost)
        return lost

    def spoilt(self, first: int, last: int) -> bool:
        """Whether forecasts between two samples count neither for nor against a twin.

        The plant was at fault then, a sensor lied, another law drove the plant, or it became another one or
        was repaired in between, as far as that is known now.
        """
        return (
            self._at_fault(first, last)
            or self.monitor.excuses_between(first, last)
            or bool(self._trial_between(first, last))
        )

    def _at_fault(self, first: int, last: int) -> bool:
        """Whether the plant was at fault between two samples, or a sensor lied, as far as that is known now."""
        return (
            self.monitor.fault_between(first, last) is not None
            or self.monitor.lie_between(first, last) is not None
        )

    def _admit(self, trigger: Trigger, report: MatchReport) -> MatchResult:
        """Make an accepted match a candidate, which is named after its operating point."""
        match = report.match
        window = trigger.window
        if match.status is not Status.ACCEPTED:
            return MatchResult(REFUSED, f"match refused: {match.reason}")
        name = name_at(report.operating_point, self.settings.plant)
        free, covariance = match.of_parameters()
        candidate = Candidate(
            name, report.operating_point, match.parameters, window, free, covariance
        )
        with one_thread():
            return self._admitted(candidate, window)

    def _admitted(self, candidate: Candidate, window: Window) -> MatchResult:
        """Have the pool admit a candidate, whose models are identified on this window."""
        try:
            return MatchResult(ADMITTED, self._pool.admit(candidate, window))
        except TwinmatchError as error:
            return MatchResult(
                REFUSED, f"no models identified for candidate {candidate.name}: {error}"
            )


class Outcome(NamedTuple):
    """The results of one sample."""

    match: MatchReport | None
    verdicts: tuple[Verdict, ...]
    settled: tuple[Sample, ...]
    """The sample as the door settled it, behind the stand-ins for those lost before it."""
    estimates: tuple[EstimatedReading, ...] = ()
    """Of sensors that were not believed, what they should have read."""


class Twin:
    """A discriminator whose match requests are answered immediately, on one stream of samples."""

    def __init__(
        self,
        settings: TwinSettings | None = None,
        given: Sequence[Candidate] = (),
        *,
        matching: TwinSettings | None = None,
    ) -> None:
        """Begin without samples, with the given candidates, if any.

        `matching`: settings for the matches; default: `settings`.
        """
        self.settings = settings or TwinSettings()
        self.discriminator = Discriminator(self.settings, given)
        self._matching = (matching or self.settings).informed_by(given)

    def push(self, sample: Sample) -> Outcome:
        """Take one sample; return the match and the verdicts that it triggers."""
        step = self.discriminator.push_sample(sample)
        if step.request is None:
            return Outcome(None, step.verdicts, step.settled, step.estimates)
        report = carry_out(step.request, self._matching)
        after = self.discriminator.push_match(report)
        settled = step.settled + after.settled
        estimates = step.estimates + after.estimates
        return Outcome(report, step.verdicts + after.verdicts, settled, estimates)


def _monitor(settings: TwinSettings) -> Monitor | ChannelMonitor:
    """Watches a plant with one loop as a whole, any other channel by channel."""
    health = replace(settings.health, period=settings.period)
    if settings.plant.single:
        return Monitor(health)
    from twinmatch.health.channels import ChannelMonitor  # noqa: PLC0415

    return ChannelMonitor(health.followed, health.period)


def _schedule(settings: TwinSettings) -> Schedule:
    """A schedule by the set-point if the loop is known; otherwise by the inputs."""

    def not_determined_by(window: Window) -> str:
        with one_thread():
            return not_determined(
                window, settings.start, settings.free, settings.noise, settings.law
            )

    least = settings.schedule.min_step * np.array(settings.units)

    def unexpected(window: Window, effect: InputEffect) -> FloatArray:
        with one_thread():
            return unexpected_movement(window, effect)

    def why_not_moved_in(window: Window) -> str:
        return why_not_moved(window, settings.plant, least)

    return Schedule(
        settings.schedule,
        settings.period,
        settings.effect,
        settings.regime_width,
        units=settings.units,
        undetermined=not_determined_by,
        unmoved=why_not_moved_in,
        unexpected=unexpected,
    )
