"""Samples and matches in, verdicts out."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from twinmatch.discrimination import (
    ADMITTED,
    REFUSED,
    Candidate,
    TrustLevel,
    Verdict,
)
from twinmatch.errors import TwinmatchError
from twinmatch.health import SLOW, Alarm, Health, Monitor, State
from twinmatch.matching import Status
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
    """What one sample or match brought about."""

    verdicts: tuple[Verdict, ...]
    """In order."""
    request: MatchRequest | None
    """A match to be asked for now; its answer is awaited."""


class _Fate(NamedTuple):
    """What became of a match."""

    word: str
    """`ADMITTED` or `REFUSED`."""
    reason: str


class Discriminator:
    """Judges the family at every trigger of the schedule, and the plant's health at every sample.

    Schedule and family are here and nowhere else. At an excited trigger it asks for the match of that
    window and waits for the answer; samples that come meanwhile wait behind it. So a request depends on
    nothing but the samples before it, verdicts come out in one order whenever matches arrive, and live nodes
    and a replay give the same ones. A fault of the plant is told at once, with a verdict between the
    triggers.
    """

    def __init__(
        self,
        settings: TwinSettings | None = None,
        given: Sequence[Candidate] = (),
        followed: Callable[[Sample], None] = lambda _: None,
    ) -> None:
        """Begin with no candidates but those given (their twins are judged on the first excited window).

        `followed` is called with every sample as soon as all candidates foretell from it.
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
        """Of all candidates, at the newest sample of which everything is said."""
        return self._bench.forecaster

    @property
    def request(self) -> MatchRequest | None:
        """The request whose answer is awaited, if any; it may be sent again, the answer is the same."""
        return self._request

    @property
    def settled(self) -> int | None:
        """Index of the newest sample of which everything is said; None before the first."""
        return self._settled if self._request is None else self._request.sample - 1

    @property
    def nominal(self) -> Candidate | None:
        """The nominal candidate as it stands."""
        if self._standing is None or self._standing.nominal is None:
            return None
        return self._bench.members.candidate(self._standing.nominal)

    def push_sample(self, sample: Sample) -> Step:
        """Take one sample; return the verdicts that became due, and the match to ask for."""
        self._waiting.append(sample)
        trigger = self._schedule.push(sample)
        if trigger is not None:
            self._waiting.append(trigger)
        return Step((), None) if self._request is not None else self._settle([])

    def push_match(self, report: MatchReport) -> Step:
        """Take one match; return the verdicts that became due, and the next match to ask for.

        A match nobody waits for changes nothing: an answer that came twice, or to another who asked.
        """
        if self._request is None or not report.answers(self._request):
            return Step((), None)
        self._request = None
        trigger = self._waiting.popleft()
        assert isinstance(trigger, Trigger)  # noqa: S101 — only a trigger is waited for
        return self._settle([self._judged(trigger, self._admit(trigger, report), report)])

    def _settle(self, verdicts: list[Verdict]) -> Step:
        """Go on until nothing waits, or a match has to be waited for."""
        while self._waiting:
            item = self._waiting[0]
            if isinstance(item, Sample):
                self._settled = item.index
                told = self._watch(item)
                self.forecaster.push(item)
                self.forecaster.notes = self._notes()
                self._followed(item)
                verdicts += [self._bench.with_forecasts(verdict) for verdict in told]
            elif not item.excited:
                verdicts.append(self._judged(item, None))
            elif (alarm := self.monitor.fault_between(item.window.first, item.window.last)) is not None:
                reason = f"not matched: {alarm.fault.value} since sample {alarm.first}: {alarm.reason}"
                verdicts.append(self._judged(item, _Fate(REFUSED, reason)))
            else:
                self._request = self._asked(item)
                break
            self._waiting.popleft()
        return Step(tuple(verdicts), self._request)

    def _asked(self, trigger: Trigger) -> MatchRequest:
        """What to ask for; the rival is who stands for the regime, as far as the family knows now."""
        with one_thread():
            while self._given:
                self._take_in(self._given.pop(0), trigger.window)
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
        """Judge the plant's health; return a verdict if a fault has just begun or gone."""
        if self._recent and sample.index != self._recent[-1].index + 1:
            if sample.index <= self._recent[-1].index:  # another session: old alarms are not in its count
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
            return [self._stand(sample.index, window, f"{news.fault.value} is over: the plant obeys again")]
        with one_thread():
            gone = self._let_go(news)
        return [replace(self._stand(sample.index, window, news.reason), dismissed=gone)]

    def _let_go(self, alarm: Alarm) -> tuple[str, ...]:
        """Dismiss the candidates that were matched while the fault was already there; return their names."""
        if alarm.fault in SLOW:  # the plant is another one since then, and obeys
            self._bench.renew(alarm.first)
            return ()
        self._standing, gone = self._bench.expel(self._standing, alarm.first, alarm.flagged)
        return gone

    def _judged(self, trigger: Trigger, fate: _Fate | None, report: MatchReport | None = None) -> Verdict:
        """The verdict on a window and what became of its match; None: none was to be made."""
        with one_thread():
            verdict = self._judge(trigger, fate, report)
        return self._bench.with_forecasts(replace(verdict, match=fate.word if fate else ""))

    def _notes(self) -> tuple[str, ...]:
        """What no forecast can promise at this sample, and which structure takes no part any more."""
        lost = tuple(f"{model.structure_name}: {model.lost}" for model in self._elsewhere if model.lost)
        return (*self._doubts(), *lost)

    def _doubts(self) -> tuple[str, ...]:
        health, since = self._health, self._promises.since
        if health is not None and health.state is State.FAULT and health.fault is not None:
            told = f"the plant shows {health.fault.value} since sample {health.since}"
            return (f"{told}: this is what a healthy plant would do",)
        if since is not None:
            return (f"what came lies outside the bands since sample {since}: these may not hold",)
        return ()

    def _spoilt(self, first: int, last: int) -> bool:
        """Whether the plant was known to be at fault between two samples."""
        return self.monitor.fault_between(first, last) is not None

    def _judge(self, trigger: Trigger, fate: _Fate | None, report: MatchReport | None) -> Verdict:
        sample, window = trigger.sample, trigger.window
        if self.monitor.fault_between(window.first, window.last) is None:
            self._bench.watch(window, excited=trigger.excited)
        self._bench.enter()
        if fate is None:
            return self._stand(sample, window, trigger.reason)
        if not len(self._bench.members):
            return self._stand(sample, window, fate.reason)
        fresh = replace(self._standing or self._nothing(), stands=False, reason=fate.reason)
        try:
            scored = self._bench.score(fresh, window)
        except TwinmatchError as error:
            return self._stand(sample, window, f"nothing could be identified: {error}")
        doubtful = report is not None and report.match.status is Status.NOT_EXPLAINED
        self._standing = self._at(scored, sample, window, doubtful=doubtful)
        return self._standing

    def _stand(self, sample: int, window: Window, reason: str) -> Verdict:
        """The verdict before, marked as standing; only health, residuals and level are new."""
        if self._standing is not None:
            with one_thread():
                self._standing = self._bench.let_lead(self._standing)
        base = replace(self._standing or self._nothing(), stands=True, reason=reason)
        return self._at(base, sample, window)

    def _at(self, verdict: Verdict, sample: int, window: Window, *, doubtful: bool = False) -> Verdict:
        """The verdict with what holds at this sample: window, residuals of the nominal, fault, level."""
        found, choice = self._residuals(verdict.nominal, window), self._bench.choice
        promise, held = self._promised(window), self._promises.held or (float("nan"), float("nan"))
        level, fault, since = trust_level(promise, self.settings.limits.doubtful), "", None
        if doubtful and level is TrustLevel.TRUSTED:
            level = TrustLevel.DOUBTFUL
        health = self._health
        if health is not None and health.state is State.FAULT and health.fault is not None:
            fault, since = health.fault.value, health.since
            # A plant that has changed still obeys: its next matches bring the twin up to it.
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
        """How the newest samples lie in the bands that the leader gave before them."""
        samples = min(self.settings.schedule.stride, len(window))
        promise = self.forecaster.promise(samples)
        if promise is None:
            return Promise(*[float("nan")] * 4)
        newest = [s.output for s in self._recent][-samples:]
        self._promises.push(promise, self._recent[-1].index - len(newest) + 1, np.array(newest))
        return promise

    def _nothing(self) -> Verdict:
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

    def _admit(self, trigger: Trigger, report: MatchReport) -> _Fate:
        match, window = report.match, trigger.window
        if match.status is not Status.ACCEPTED:
            return _Fate(REFUSED, f"match refused: {match.reason}")
        name = f"{report.operating_point:g} {self.settings.plant.output.unit}"
        free, covariance = match.of_parameters()
        candidate = Candidate(name, report.operating_point, match.parameters, window, free, covariance)
        with one_thread():
            return self._take_in(candidate, window)

    def _take_in(self, candidate: Candidate, window: Window) -> _Fate:
        try:
            return _Fate(ADMITTED, self._bench.take_in(candidate, window))
        except TwinmatchError as error:
            return _Fate(REFUSED, f"no models of candidate {candidate.name}: {error}")

    def _residuals(self, nominal: str | None, window: Window) -> Residuals:
        if nominal is None:
            return Residuals(float("nan"), float("nan"))
        alarms = self.monitor.alarms
        over = alarms[-1].last if alarms else None  # what a past fault left is not the twin's
        first = max(
            window.first, window.last - self.settings.schedule.stride + 1, 0 if over is None else over + 1
        )
        newest = window.part(min(first, window.last), window.last)
        return residuals(self._bench.members.candidate(nominal).parameters, newest, self.settings.gains)


def _schedule(settings: TwinSettings) -> Schedule:
    """By the set-points of a loop that is known; else by the input."""
    if settings.gains is None:
        return InputSchedule(settings.schedule, settings.period, settings.regime_width)
    return Schedule(settings.schedule, settings.period)
