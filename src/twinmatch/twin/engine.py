"""The engine: takes samples and matches, returns verdicts."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from twinmatch.comparing import ADMITTED, REFUSED, Candidate, Verdict
from twinmatch.defects import Defect
from twinmatch.dynamics.movement import InputEffect
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import Status
from twinmatch.fitting.excitation import unexpected_movement, why_not_moved
from twinmatch.fitting.match import not_determined
from twinmatch.health import SLOW, Alarm, EstimatedReading, Monitor
from twinmatch.signals import FloatArray, Sample, Signals, Window
from twinmatch.twin.candidates import CandidatePool, FamilyModels, name_at
from twinmatch.twin.defect_reports import DefectReports
from twinmatch.twin.door import Door
from twinmatch.twin.forecaster import Forecaster, Snapshot
from twinmatch.twin.knowledge import Knowledge, MatchResult, no_verdict, verdict_of
from twinmatch.twin.law_on_estimates import LawOnEstimates
from twinmatch.twin.law_trials import LawTrials
from twinmatch.twin.matcher import MatchReport, MatchRequest, carry_out, one_thread
from twinmatch.twin.mirror import Residuals, residuals
from twinmatch.twin.plant_watch import PlantWatch
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


@dataclass
class _StepSoFar:
    """The results of one sample or match, while it is processed; see `Step`."""

    verdicts: list[Verdict]
    snapshots: list[Snapshot] = field(default_factory=list)
    settled: list[Sample] = field(default_factory=list)
    estimates: list[EstimatedReading] = field(default_factory=list)

    def ended_by(self, request: MatchRequest | None) -> Step:
        """The results once nothing waits, or a match has to be requested."""
        return Step(
            tuple(self.verdicts),
            request,
            tuple(self.snapshots),
            tuple(self.settled),
            tuple(self.estimates),
        )


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
        self._watched: int | None = None
        """The newest sample, once the plant's health has been judged at it."""
        self._settled: int | None = None
        self._recent: deque[Sample] = deque(maxlen=self.settings.schedule.stride)
        self._watch = PlantWatch(self.settings)
        self._defects = DefectReports(self.settings.schedule.stride)
        self._begin_candidates()
        self._law_on_estimates = self._new_law_on_estimates()
        self._last_on_estimate: int | None = None
        """Newest sample at which the law took an estimate in place of a reading."""
        self._trials = LawTrials()

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
        """Learn that a law on trial drove from sample `first` to `last`; infinite while it drives.

        Nothing is matched on these samples or learned from them, since forecasts are for the law before.
        """
        self._trials.note(first, last)

    @property
    def monitor(self) -> Monitor | ChannelMonitor:
        """The monitor that judges the plant's health."""
        return self._watch.monitor

    @property
    def defects(self) -> dict[str, Defect]:
        """Defects of this program that prevented verdicts, by their places."""
        return self._defects.logged

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
        step = _StepSoFar(verdicts)
        while (sample := self._next(step.verdicts)) is not None:
            step.settled.append(sample)
            self._settled = sample.index
            self.stamps[sample.index] = sample.stamp
            if len(self.stamps) > MAX_STAMPS:
                del self.stamps[next(iter(self.stamps))]
            self._process(sample, step)
            if self._request is not None:
                break
        return step.ended_by(self._request)

    def _process(self, sample: Sample, step: _StepSoFar) -> None:
        """Judge the plant at a settled sample, and then what is due; a part that raises an error starts over."""
        outputs_taken = self._taken_by_law(sample)
        self._watched = None
        try:
            self._judge_plant(sample)
        except Exception as error:
            step.verdicts += self._start_over(
                error, sample.index, self._watch.start_over
            )
            return
        step.estimates += self.monitor.estimates
        try:
            step.verdicts += self._take(sample, outputs_taken)
            if self._snapshots and sample.usable and (sample.seen or sample.refused):
                step.snapshots.append(self.forecaster.snapshot())
            step.verdicts += self._scheduled(sample)
        except Exception as error:
            step.verdicts += self._start_over(
                error, sample.index, self._begin_candidates
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
            verdicts += self._start_over(error, oldest.index, self._door.restart)
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
        defect = self._defects.log(error)
        if not self._defects.is_due(defect, sample):
            return []
        return [self._no_verdict(sample, window, defect)]

    def _window_at(self, sample: int) -> tuple[int, int]:
        """First and last sample of the window that was due at a sample, or of the newest ones."""
        if self._due is not None and self._due.sample == sample:
            return self._due.window.first, self._due.window.last
        return (self._recent[0].index if self._recent else sample), sample

    def _no_verdict(
        self, sample: int, window: tuple[int, int], defect: Defect
    ) -> Verdict:
        """The verdict in place of one that could not be made."""
        horizons = self.settings.forecasts.horizons
        verdict = no_verdict(
            sample,
            window,
            defect,
            health=self._watch.health,
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
        if trial := self._trials.between(first, last):
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
        news = self._watch.news
        dismissed = () if news is None else self._learn_of(news)
        if sample.usable:
            self.forecaster.push(sample, taken)
        verdicts = []
        if news is not None:
            verdicts.append(self._verdict_on(news, sample, dismissed))
        self.forecaster.notes = self._notes()
        return verdicts

    def _learn_of(self, news: Alarm) -> tuple[str, ...]:
        """Remove what an alarm that has begun or ended makes worthless; return the names of the candidates."""
        dismissed = self._remove_spoilt(news) if news.last is None else ()
        if news.excuses:
            self.forecaster.forget_since(news.first)
        return dismissed

    def _verdict_on(
        self, news: Alarm, sample: Sample, dismissed: tuple[str, ...]
    ) -> Verdict:
        """The verdict on an alarm that has begun or ended at a sample."""
        if news.last is None:
            reason = news.reason
        elif news.withdrawn:
            reason = news.withdrawn
        else:
            reason = f"{news.fault.value} is over: the plant responds normally again"
        match = MatchResult(reason=reason)
        window = Window.from_samples(
            list(self._recent) or [sample], self.settings.period
        )
        with one_thread():
            self._pool.score_leader()
            known = self._known(sample.index, window, match, dismissed=dismissed)
            return self._verdict_of(known)

    def _new_law_on_estimates(self) -> LawOnEstimates:
        return LawOnEstimates(self.settings.read_through, self.settings.period)

    def _taken_by_law(self, sample: Sample) -> Signals | None:
        """The outputs that the law took where sensors are read through; None: those of the sample.

        In place of a reading that a trusted twin has not believed for a while it takes what was estimated at
        the sample before.
        """
        if not self.settings.read_through or self._watched is None:
            return None
        taken = self._law_on_estimates.taken_after(
            self._watched, self.monitor.estimates
        )
        if not taken:
            return None
        self._last_on_estimate = sample.index
        return tuple(map(taken.get, self.settings.plant.outputs, sample.outputs))

    def _judge_plant(self, sample: Sample) -> None:
        """Judge the plant's health at a sample."""
        if self._recent and not sample.follows(self._recent[-1]):
            is_other_session = not sample.continues(self._recent[-1])
            if is_other_session:
                self._watch.begin_session()
                self._law_on_estimates = self._new_law_on_estimates()
                self._last_on_estimate = None
                self._trials = LawTrials()
            self._recent.clear()
        if sample.usable:
            self._recent.append(sample)
        self._watch.push(sample, self.nominal, steps_recur=self._door.steps_recur)
        self._watched = sample.index

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
        """The verdict on a window and on its match."""
        window = trigger.window
        pool = self._pool
        with one_thread():
            if not self._watch.is_at_fault(window.first, window.last):
                pool.structures.push(window, excited=trigger.excited)
            dismissed = pool.leave_memory()
            pool.enter()
            match, is_scored = self._score(window, match)
            knowledge = self._known(
                trigger.sample, window, match, scored=is_scored, dismissed=dismissed
            )
            verdict = self._verdict_of(knowledge)
            self._door.learn(verdict)
            return verdict

    def _score(self, window: Window, match: MatchResult) -> tuple[MatchResult, bool]:
        """Score all candidates on a window if its match was requested.

        Returns the match, with the reason if nothing could be identified, and whether the window was scored;
        otherwise the scores of the verdict before stand.
        """
        was_requested = bool(match.word)
        if was_requested and not self._pool.empty:
            try:
                self._pool.score(window)
            except TwinmatchError as error:
                match = MatchResult(match.word, f"nothing could be identified: {error}")
            else:
                return match, True
        self._pool.score_leader()
        return match, False

    def _verdict_of(self, known: Knowledge) -> Verdict:
        """The verdict on what is known. If a defect prevents only this, no part has to start over."""
        try:
            verdict = verdict_of(known)
        except Exception as error:
            return self._no_verdict(
                known.sample, known.window, self._defects.log(error)
            )
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
            health=self._watch.health,
            monitor=self.monitor,
            trial=self._why_not_compared(window),
            trusted=self._trusted,
            decimals=self.settings.decimals,
        )

    def _compared(self, window: Window) -> int:
        """How many of the newest samples are compared with the bands when a window is judged."""
        return min(self.settings.schedule.stride, len(window))

    def _why_not_compared(self, window: Window) -> str:
        """Why a law on trial keeps the newest samples from being compared; empty if none does."""
        if not self._recent:
            return ""
        return self._trials.why_not_compared(
            self._recent[-1].index,
            self._compared(window),
            max(self.forecaster.horizons),
        )

    def _check_bands(self, window: Window) -> BandCheck:
        """How the newest samples lie in the bands that the leader forecast for them."""
        if not self._recent or self._why_not_compared(window):
            return BandCheck()
        samples = self._compared(window)
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
        # before the end of a fault, residuals are not the twin's
        first = max(
            window.first,
            window.last - self.settings.schedule.stride + 1,
            self._watch.first_after_fault,
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
        reservation = self._reservation()
        return (reservation, *lost) if reservation else lost

    def _reservation(self) -> str:
        """Why forecasts from this sample may not hold: the gravest reason; empty without one."""
        settled = self._settled
        if settled is not None and (trial := self._trials.between(settled, settled)):
            return f"{trial}: this forecast is for the law before"
        if fault := self._watch.fault_in_words:
            return f"{fault}: this forecast is for a healthy plant"
        since = self._bands.since
        if since is not None:
            outside = f"readings have been outside the bands since sample {since}"
            return f"{outside}: these bands may not hold"
        return ""

    def spoilt(self, first: int, last: int) -> bool:
        """Whether forecasts between two samples count neither for nor against a twin.

        The plant was at fault then, a sensor lied, another law drove the plant, or it became another one or
        was repaired in between, as far as that is known now.
        """
        return (
            self._watch.is_at_fault(first, last)
            or self.monitor.excuses_between(first, last)
            or bool(self._trials.between(first, last))
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
