"""The engine: takes samples and matches, returns verdicts."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from twinmatch.comparing import (
    ADMITTED,
    DECIDED_FROM,
    REFUSED,
    Candidate,
    TrustLevel,
    Verdict,
)
from twinmatch.dynamics import Parameters
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import Status
from twinmatch.health import SLOW, Alarm, Fault, Health, HealthState, Monitor
from twinmatch.signals import Sample, Window
from twinmatch.twin.candidates import UNSCORED, CandidatePool
from twinmatch.twin.forecaster import Forecaster
from twinmatch.twin.gaps import GapFiller
from twinmatch.twin.matcher import MatchReport, MatchRequest, carry_out, one_thread
from twinmatch.twin.mirror import Residuals, residuals
from twinmatch.twin.schedule import InputSchedule, Schedule, Trigger
from twinmatch.twin.settings import TwinSettings
from twinmatch.twin.structure_fits import watched
from twinmatch.twin.trust import BandCheck, BandHistory, trust_level

MOST_STAMPS = 10_000
"""Number of samples for which stamps are kept for verdicts still due."""


class Step(NamedTuple):
    """The results of one sample or match."""

    verdicts: tuple[Verdict, ...]
    """Verdicts in order."""
    request: MatchRequest | None
    """The match to request now; its answer is awaited."""


class _Decision(NamedTuple):
    """The decision on a match."""

    word: str
    """`ADMITTED` or `REFUSED`; empty if no match was requested."""
    reason: str


class _Assessment(NamedTuple):
    """How far the twin is to be trusted at a sample; the fields are those of a verdict."""

    level: TrustLevel
    fault: str
    fault_since: int | None
    structure: str
    structure_parameters: Parameters | None
    driven_rms_y: float
    closed_rms_u: float
    miss_since: int | None
    held_low: float
    held_high: float


class Discriminator:
    """Judges the family at every trigger of the schedule, and the plant's health at every sample.

    It alone owns schedule and family. At an excited trigger it requests a match of that window and waits for
    the answer; samples that arrive meanwhile are queued. So a request depends only on the samples before it,
    the order of verdicts does not depend on when matches arrive, and live nodes and a replay give the same
    verdicts. A fault of the plant is reported immediately, by a verdict between the triggers.
    """

    def __init__(
        self,
        settings: TwinSettings | None = None,
        given: Sequence[Candidate] = (),
        followed: Callable[[Sample], None] = lambda _: None,
    ) -> None:
        """Begin with the given candidates only (their twins are judged on the first excited window).

        `followed` is called with every sample as soon as all candidates can forecast from it.
        """
        self._followed = followed
        self.stamps: dict[int, int] = {}
        """Stamps of the newest samples and stand-ins, ns, by index."""
        self.settings = settings or TwinSettings()
        self.monitor = Monitor(replace(self.settings.health, period=self.settings.period))
        self._schedule = _schedule(self.settings)
        self._external = [model for model in watched(self.settings.plant) if model.is_external]
        self._pool = CandidatePool(self.settings, self._spoilt)
        self._bands = BandHistory(self.settings.limits.doubtful, self.settings.noise.output)
        self._given = list(given)
        self._waiting: deque[Sample | Trigger] = deque()
        self._filler = GapFiller.of(self.settings)
        self._request: MatchRequest | None = None
        self._fits: Future[None] | None = None
        self._settled: int | None = None
        self._recent: deque[Sample] = deque(maxlen=self.settings.schedule.stride)
        self._health: Health | None = None

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

    def push_sample(self, sample: Sample) -> Step:
        """Take one sample; return the verdicts now due, and the match to request.

        A few samples lost before it get stand-ins, which count nowhere. After more,
        everything starts over.
        """
        for one in self._filler.take(sample):
            self._waiting.append(one)
            self.stamps[one.index] = one.stamp
            if len(self.stamps) > MOST_STAMPS:
                del self.stamps[next(iter(self.stamps))]
            trigger = self._schedule.push(one)
            if trigger is not None:
                self._waiting.append(trigger)
        return Step((), None) if self._request is not None else self._settle([])

    def push_match(self, report: MatchReport) -> Step:
        """Take one match; return the verdicts now due, and the next match to request.

        An unexpected match is ignored: a repeated answer, or one to another discriminator.
        """
        if self._request is None or not report.answers(self._request):
            return Step((), None)
        self._request = None
        trigger = self._waiting.popleft()
        assert isinstance(trigger, Trigger)  # noqa: S101 — only a trigger is waited for
        return self._settle([self._judged(trigger, self._admit(trigger, report), report)])

    def _settle(self, verdicts: list[Verdict]) -> Step:
        """Process the queue until it is empty or a match is needed."""
        while self._waiting:
            item = self._waiting[0]
            if isinstance(item, Sample):
                self._settled = item.index
                due = self._watch(item)
                self.forecaster.push(item)
                self.forecaster.notes = self._notes()
                if item.seen:
                    self._followed(item)
                if due is not None:
                    verdicts.append(due())
            elif not item.excited:
                verdicts.append(self._judged(item, _Decision("", item.reason)))
            elif (alarm := self.monitor.fault_between(item.window.first, item.window.last)) is not None:
                reason = f"not matched: {alarm.fault.value} since sample {alarm.first}: {alarm.reason}"
                verdicts.append(self._judged(item, _Decision(REFUSED, reason)))
            else:
                self._request = self._new_request(item)
                if not self._external:  # most of a match is compiled code, which releases the GIL
                    with_match = ThreadPoolExecutor(1)
                    self._fits = with_match.submit(self._fit, item)
                    with_match.shutdown(wait=False)
                break
            self._waiting.popleft()
        return Step(tuple(verdicts), self._request)

    def _new_request(self, trigger: Trigger) -> MatchRequest:
        """The request for a trigger; its incumbent is the regime's current candidate."""
        with one_thread():
            while self._given:
                self._admitted(self._given.pop(0), trigger.window)
        rival = self._pool.incumbent_at(trigger.operating_point)
        incumbent = rival.parameters if rival else None
        return MatchRequest(
            sample=trigger.sample,
            operating_point=trigger.operating_point,
            window=trigger.window,
            start=incumbent or self.settings.start,
            incumbent=incumbent,
        )

    def _watch(self, sample: Sample) -> Callable[[], Verdict] | None:
        """Judge the plant's health; return the verdict due if a fault has just begun or ended, which is to be
        completed when the candidates have taken the sample, too."""
        if self._recent and not sample.follows(self._recent[-1]):
            if sample.index <= self._recent[-1].index:  # another session: the old alarms have other indices
                self.monitor = Monitor(self.monitor.settings)
            self._recent.clear()
        self._recent.append(sample)
        nominal = self.nominal
        self._health = self.monitor.push(sample, nominal.parameters if nominal else None)
        news = self._health.news
        if news is None:
            return None
        window = Window.from_samples(list(self._recent), self.settings.period)
        reason = news.reason
        gone: tuple[str, ...] = ()
        if news.last is not None:
            reason = f"{news.fault.value} is over: the plant responds normally again"
        with one_thread():
            if news.last is None:
                gone = self._remove_spoilt(news)
            self._pool.score_leader()
        return self._verdict(sample.index, window, _Decision("", reason), dismissed=gone)

    def _remove_spoilt(self, alarm: Alarm) -> tuple[str, ...]:
        """Remove the candidates that were matched while the fault was already on; return their names."""
        if alarm.fault in SLOW:  # the plant has changed since then, but still obeys its drive
            self._pool.structures.cut(alarm.first)
            return ()
        return self._pool.expel(alarm.first, alarm.flagged)

    def _fit(self, trigger: Trigger) -> None:
        with one_thread():
            self._pool.structures.push(trigger.window, excited=trigger.excited)

    def _judged(self, trigger: Trigger, decision: _Decision, report: MatchReport | None = None) -> Verdict:
        """The verdict on a window and the decision on its match.

        If the window cannot be scored, the scores of the verdict before stand.
        """
        window, pool = trigger.window, self._pool
        with one_thread():
            if self._fits is not None:
                self._fits.result()
                self._fits = None
            elif self.monitor.fault_between(window.first, window.last) is None:
                self._fit(trigger)
            pool.enter()
            scored = bool(decision.word) and not pool.empty
            if scored:
                try:
                    pool.score(window)
                except TwinmatchError as error:
                    scored = False
                    decision = decision._replace(reason=f"nothing could be identified: {error}")
            if not scored:
                pool.score_leader()
            doubtful = scored and report is not None and report.match.status is Status.NOT_EXPLAINED
            return self._verdict(trigger.sample, window, decision, stands=not scored, doubtful=doubtful)()

    def _verdict(
        self,
        sample: int,
        window: Window,
        decision: _Decision,
        *,
        stands: bool = True,
        doubtful: bool = False,
        dismissed: tuple[str, ...] = (),
    ) -> Callable[[], Verdict]:
        """The verdict on a window with the newest scores; its forecasts are added when it is called."""
        scores = self._pool.scores or UNSCORED
        bands = self._checked_bands(window)
        assessment = self._assessed(bands, window, doubtful=doubtful)

        def verdict() -> Verdict:
            forecaster = self.forecaster
            leader, confidence, forecasts = forecaster.leader, forecaster.confidence, forecaster.scores
            level, useless = assessment.level, any(s.useless for s in forecasts if s.name == leader)
            if useless and level is TrustLevel.TRUSTED:
                level = TrustLevel.DOUBTFUL
            sentences = (forecaster.sentence, scores.certainty)
            return Verdict(
                sample=sample,
                first=window.first,
                last=window.last,
                stands=stands,
                reason=decision.reason,
                match=decision.word,
                dismissed=dismissed,
                decimals=self.settings.decimals,
                leader=leader,
                leader_confidence=float("nan") if leader is None else confidence,
                decided=leader is not None and confidence >= DECIDED_FROM,
                horizons=forecaster.settings.horizons,
                forecasts=forecasts,
                **bands._asdict(),
                **assessment._replace(level=level)._asdict(),
                **scores._replace(certainty="; ".join(s for s in sentences if s))._asdict(),
            )

        return verdict

    def _assessed(self, bands: BandCheck, window: Window, *, doubtful: bool) -> _Assessment:
        """Residuals, fault and level at the end of a window; `doubtful`: no match explains it."""
        found, choice = self._residuals(window), self._pool.structures.choice
        low, high = self._bands.levels or (float("nan"), float("nan"))
        level, fault, since = trust_level(bands, self.settings.limits.doubtful), "", None
        if doubtful and level is TrustLevel.TRUSTED:
            level = TrustLevel.DOUBTFUL
        health = self._health
        if health is not None and health.state is HealthState.FAULT and health.fault is not None:
            fault, since = health.fault.value, health.since
            # A plant that has changed still obeys its drive: its next matches adapt the twin.
            level = TrustLevel.DOUBTFUL if health.fault in (*SLOW, Fault.DISTURBANCE) else TrustLevel.FAULT
        return _Assessment(
            level=level,
            fault=fault,
            fault_since=since,
            structure=choice.chosen if choice else "",
            structure_parameters=choice.parameters if choice else None,
            driven_rms_y=found.y,
            closed_rms_u=found.u,
            miss_since=self._bands.since,
            held_low=low,
            held_high=high,
        )

    def _checked_bands(self, window: Window) -> BandCheck:
        """How the newest samples lie in the bands that the leader forecast for them."""
        samples = min(self.settings.schedule.stride, len(window))
        check = self.forecaster.check_bands(samples)
        if check is None:
            return BandCheck()
        newest = [s.output for s in self._recent][-samples:]
        self._bands.push(check, self._recent[-1].index - len(newest) + 1, np.array(newest))
        return check

    def _residuals(self, window: Window) -> Residuals:
        nominal = self.nominal
        if nominal is None:
            return Residuals(float("nan"), float("nan"))
        alarms = self.monitor.alarms
        over = alarms[-1].last if alarms else None  # residuals during a past fault are not the twin's
        first = max(
            window.first, window.last - self.settings.schedule.stride + 1, 0 if over is None else over + 1
        )
        newest = window.part(min(first, window.last), window.last)
        return residuals(nominal.parameters, newest, self.settings.law)

    def _notes(self) -> tuple[str, ...]:
        """Reservations on forecasts at this sample, and structures that no longer take part."""
        lost = tuple(f"{model.structure_name}: {model.lost}" for model in self._external if model.lost)
        health, since = self._health, self._bands.since
        if health is not None and health.state is HealthState.FAULT and health.fault is not None:
            fault = f"the plant has shown {health.fault.value} since sample {health.since}"
            return (f"{fault}: this forecast is for a healthy plant", *lost)
        if since is not None:
            outside = f"readings have been outside the bands since sample {since}"
            return (f"{outside}: these bands may not hold", *lost)
        return lost

    def _spoilt(self, first: int, last: int) -> bool:
        """Whether the plant was known to be at fault between two samples."""
        return self.monitor.fault_between(first, last) is not None

    def _admit(self, trigger: Trigger, report: MatchReport) -> _Decision:
        match, window = report.match, trigger.window
        if match.status is not Status.ACCEPTED:
            return _Decision(REFUSED, f"match refused: {match.reason}")
        name = f"{report.operating_point:g} {self.settings.plant.output.unit}"
        free, covariance = match.of_parameters()
        candidate = Candidate(name, report.operating_point, match.parameters, window, free, covariance)
        with one_thread():
            return self._admitted(candidate, window)

    def _admitted(self, candidate: Candidate, window: Window) -> _Decision:
        try:
            return _Decision(ADMITTED, self._pool.admit(candidate, window))
        except TwinmatchError as error:
            return _Decision(REFUSED, f"no models identified for candidate {candidate.name}: {error}")


class Outcome(NamedTuple):
    """The results of one sample."""

    match: MatchReport | None
    verdicts: tuple[Verdict, ...]


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
        self._matching = matching or self.settings

    def push(self, sample: Sample) -> Outcome:
        """Take one sample; return the match and the verdicts that it triggers."""
        step = self.discriminator.push_sample(sample)
        if step.request is None:
            return Outcome(None, step.verdicts)
        report = carry_out(step.request, self._matching)
        return Outcome(report, step.verdicts + self.discriminator.push_match(report).verdicts)


def _schedule(settings: TwinSettings) -> Schedule:
    """A schedule by the set-point if the loop is known; otherwise by the input."""
    if settings.law is None:
        return InputSchedule(settings.schedule, settings.period, settings.regime_width)
    return Schedule(settings.schedule, settings.period)
