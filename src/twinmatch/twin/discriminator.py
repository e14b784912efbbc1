"""The discriminator: takes samples and matches, returns verdicts."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from twinmatch.comparing import (
    ADMITTED,
    REFUSED,
    Candidate,
    TrustLevel,
    Verdict,
)
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import Status
from twinmatch.health import SLOW, Alarm, Health, Monitor, State
from twinmatch.signals import Sample, Window
from twinmatch.twin.bench import Bench
from twinmatch.twin.forecaster import Forecaster
from twinmatch.twin.input_schedule import InputSchedule
from twinmatch.twin.matcher import MatchReport, MatchRequest
from twinmatch.twin.promises import Promise, Promises, trust_level
from twinmatch.twin.residuals import Residuals, residuals
from twinmatch.twin.schedule import Schedule, Trigger
from twinmatch.twin.settings import TwinSettings
from twinmatch.twin.structure_watch import watched
from twinmatch.twin.threads import one_thread

__all__ = ["Discriminator", "Step"]


class Step(NamedTuple):
    """The results of one sample or match."""

    verdicts: tuple[Verdict, ...]
    """Verdicts in order."""
    request: MatchRequest | None
    """The match to request now; its answer is awaited."""


class _Decision(NamedTuple):
    """The decision on a match."""

    word: str
    """`ADMITTED` or `REFUSED`."""
    reason: str


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
        self.settings = settings or TwinSettings()
        self.monitor = Monitor(replace(self.settings.health, period=self.settings.period))
        self._schedule = _schedule(self.settings)
        self._elsewhere = [model for model in watched(self.settings.plant) if model.is_elsewhere]
        self._bench = Bench(self.settings, self._spoilt)
        self._promises = Promises(self.settings.limits.doubtful, self.settings.noise.output)
        self._given = list(given)
        self._waiting: deque[Sample | Trigger] = deque()
        self._request: MatchRequest | None = None
        self._settled: int | None = None
        self._recent: deque[Sample] = deque(maxlen=self.settings.schedule.stride)
        self._health: Health | None = None
        self._standing: Verdict | None = None

    @property
    def forecaster(self) -> Forecaster:
        """The forecaster of all candidates, at the newest settled sample."""
        return self._bench.forecaster

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
        if self._standing is None or self._standing.nominal is None:
            return None
        return self._bench.members.candidate(self._standing.nominal)

    def push_sample(self, sample: Sample) -> Step:
        """Take one sample; return the verdicts now due, and the match to request."""
        self._waiting.append(sample)
        trigger = self._schedule.push(sample)
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
                self._followed(item)
                verdicts += [self._bench.with_forecasts(verdict) for verdict in due]
            elif not item.excited:
                verdicts.append(self._judged(item, None))
            elif (alarm := self.monitor.fault_between(item.window.first, item.window.last)) is not None:
                reason = f"not matched: {alarm.fault.value} since sample {alarm.first}: {alarm.reason}"
                verdicts.append(self._judged(item, _Decision(REFUSED, reason)))
            else:
                self._request = self._new_request(item)
                break
            self._waiting.popleft()
        return Step(tuple(verdicts), self._request)

    def _new_request(self, trigger: Trigger) -> MatchRequest:
        """The request for a trigger; its incumbent is the regime's current candidate."""
        with one_thread():
            while self._given:
                self._admitted(self._given.pop(0), trigger.window)
        rival = self._bench.members.standing_at(trigger.operating_point)
        incumbent = rival.parameters if rival else None
        return MatchRequest(
            sample=trigger.sample,
            operating_point=trigger.operating_point,
            window=trigger.window,
            start=incumbent or self.settings.start,
            incumbent=incumbent,
        )

    def _watch(self, sample: Sample) -> list[Verdict]:
        """Judge the plant's health; return a verdict if a fault has just begun or ended."""
        if self._recent and sample.index != self._recent[-1].index + 1:
            if sample.index <= self._recent[-1].index:  # another session: the old alarms have other indices
                self.monitor = Monitor(self.monitor.settings)
            self._recent.clear()
        self._recent.append(sample)
        nominal = self.nominal
        self._health = self.monitor.push(sample, nominal.parameters if nominal else None)
        news = self._health.news
        if news is None:
            return []
        window = Window.from_samples(list(self._recent), self.settings.period)
        if news.last is not None:
            reason = f"{news.fault.value} is over: the plant responds normally again"
            return [self._stand(sample.index, window, reason)]
        with one_thread():
            gone = self._remove_spoilt(news)
        return [replace(self._stand(sample.index, window, news.reason), dismissed=gone)]

    def _remove_spoilt(self, alarm: Alarm) -> tuple[str, ...]:
        """Remove the candidates that were matched while the fault was already on; return their names."""
        if alarm.fault in SLOW:  # the plant has changed since then, but still obeys its drive
            self._bench.renew(alarm.first)
            return ()
        self._standing, gone = self._bench.expel(self._standing, alarm.first, alarm.flagged)
        return gone

    def _judged(
        self, trigger: Trigger, decision: _Decision | None, report: MatchReport | None = None
    ) -> Verdict:
        """The verdict on a window and the decision on its match; None if no match was requested."""
        with one_thread():
            verdict = self._judge(trigger, decision, report)
        return self._bench.with_forecasts(replace(verdict, match=decision.word if decision else ""))

    def _notes(self) -> tuple[str, ...]:
        """Reservations on forecasts at this sample, and structures that no longer take part."""
        lost = tuple(f"{model.structure_name}: {model.lost}" for model in self._elsewhere if model.lost)
        return (*self._reservations(), *lost)

    def _reservations(self) -> tuple[str, ...]:
        health, since = self._health, self._promises.since
        if health is not None and health.state is State.FAULT and health.fault is not None:
            fault = f"the plant has shown {health.fault.value} since sample {health.since}"
            return (f"{fault}: this forecast is for a healthy plant",)
        if since is not None:
            return (f"readings have been outside the bands since sample {since}: these bands may not hold",)
        return ()

    def _spoilt(self, first: int, last: int) -> bool:
        """Whether the plant was known to be at fault between two samples."""
        return self.monitor.fault_between(first, last) is not None

    def _judge(self, trigger: Trigger, decision: _Decision | None, report: MatchReport | None) -> Verdict:
        sample, window = trigger.sample, trigger.window
        if self.monitor.fault_between(window.first, window.last) is None:
            self._bench.watch(window, excited=trigger.excited)
        self._bench.enter()
        if decision is None:
            return self._stand(sample, window, trigger.reason)
        if not len(self._bench.members):
            return self._stand(sample, window, decision.reason)
        fresh = replace(self._standing or self._empty(), stands=False, reason=decision.reason)
        try:
            scored = self._bench.score(fresh, window)
        except TwinmatchError as error:
            return self._stand(sample, window, f"nothing could be identified: {error}")
        doubtful = report is not None and report.match.status is Status.NOT_EXPLAINED
        self._standing = self._at(scored, sample, window, doubtful=doubtful)
        return self._standing

    def _stand(self, sample: int, window: Window, reason: str) -> Verdict:
        """Repeat the previous verdict, marked as such; only health, residuals and level are new."""
        if self._standing is not None:
            with one_thread():
                self._standing = self._bench.with_leader(self._standing)
        base = replace(self._standing or self._empty(), stands=True, reason=reason)
        return self._at(base, sample, window)

    def _at(self, verdict: Verdict, sample: int, window: Window, *, doubtful: bool = False) -> Verdict:
        """Update the verdict for this sample: window, residuals of the nominal, fault, level."""
        found, choice = self._residuals(verdict.nominal, window), self._bench.choice
        promise, held = self._promised(window), self._promises.held or (float("nan"), float("nan"))
        level, fault, since = trust_level(promise, self.settings.limits.doubtful), "", None
        if doubtful and level is TrustLevel.TRUSTED:
            level = TrustLevel.DOUBTFUL
        health = self._health
        if health is not None and health.state is State.FAULT and health.fault is not None:
            fault, since = health.fault.value, health.since
            # A plant that has changed still obeys its drive: its next matches adapt the twin.
            level = TrustLevel.DOUBTFUL if health.fault in SLOW else TrustLevel.FAULT
        return replace(
            verdict,
            sample=sample,
            first=window.first,
            last=window.last,
            level=level,
            fault=fault,
            fault_since=since,
            structure=choice.chosen if choice else "",
            structure_parameters=choice.parameters if choice else None,
            driven_rms_y=found.y,
            closed_rms_u=found.u,
            **promise._asdict(),
            miss_since=self._promises.since,
            held_low=held[0],
            held_high=held[1],
        )

    def _promised(self, window: Window) -> Promise:
        """How the newest samples lie in the bands that the leader forecast for them."""
        samples = min(self.settings.schedule.stride, len(window))
        promise = self.forecaster.promise(samples)
        if promise is None:
            return Promise(*[float("nan")] * 4)
        newest = [s.output for s in self._recent][-samples:]
        self._promises.push(promise, self._recent[-1].index - len(newest) + 1, np.array(newest))
        return promise

    def _empty(self) -> Verdict:
        return Verdict(
            sample=0,
            first=0,
            last=0,
            level=TrustLevel.UNKNOWN,
            stands=True,
            nominal=None,
            reason="",
            decimals=self.settings.decimals,
            candidates=(),
            order=None,
            nu_gap=(),
            driven_rms_y=float("nan"),
            closed_rms_u=float("nan"),
        )

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
            return _Decision(ADMITTED, self._bench.take_in(candidate, window))
        except TwinmatchError as error:
            return _Decision(REFUSED, f"no models identified for candidate {candidate.name}: {error}")

    def _residuals(self, nominal: str | None, window: Window) -> Residuals:
        if nominal is None:
            return Residuals(float("nan"), float("nan"))
        alarms = self.monitor.alarms
        over = alarms[-1].last if alarms else None  # residuals during a past fault are not the twin's
        first = max(
            window.first, window.last - self.settings.schedule.stride + 1, 0 if over is None else over + 1
        )
        newest = window.part(min(first, window.last), window.last)
        return residuals(self._bench.members.candidate(nominal).parameters, newest, self.settings.gains)


def _schedule(settings: TwinSettings) -> Schedule:
    """A schedule by the set-point if the loop is known; otherwise by the input."""
    if settings.gains is None:
        return InputSchedule(settings.schedule, settings.period, settings.regime_width)
    return Schedule(settings.schedule, settings.period)
