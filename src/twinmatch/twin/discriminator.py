"""Samples and matches in, verdicts out."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from twinmatch.discrimination import Candidate, SimoModel, TrustLevel, Verdict
from twinmatch.errors import TwinmatchError
from twinmatch.health import Alarm, Fault, Health, Monitor, State
from twinmatch.matching import Status
from twinmatch.signals import Sample, Window
from twinmatch.twin.matcher import MatchReport, candidate_name
from twinmatch.twin.members import Judged, Members, plant_model
from twinmatch.twin.residuals import Residuals, residuals
from twinmatch.twin.schedule import Schedule, Trigger
from twinmatch.twin.settings import TrustLimits, TwinSettings
from twinmatch.twin.structure_watch import StructureSettings, StructureWatch, watched
from twinmatch.twin.threads import one_thread

__all__ = ["Discriminator", "trust_level"]

UNEXPLAINED = "unexplained"
"""What a fault is called that the residuals show and the monitor has no name for."""


class _Looked(NamedTuple):
    """The newest window that was judged, and the plant's model of it."""

    window: Window
    plant: SimoModel


class Discriminator:
    """Judges the family at every trigger of the schedule, and the plant's health at every sample.

    It runs its own schedule on the samples and, at an excited trigger, waits for the match of that
    window; samples that come meanwhile wait behind it. So verdicts come out in one order, whenever
    matches arrive, and live nodes and a replay give the same ones. A fault of the plant is told at
    once, with a verdict between the triggers.
    """

    def __init__(self, settings: TwinSettings | None = None, given: Sequence[Candidate] = ()) -> None:
        """Begin with no candidates but those given (their twins are judged on the first excited window)."""
        self.settings = settings or TwinSettings()
        self.schedule = Schedule(self.settings.schedule, self.settings.period)
        self.monitor = Monitor(replace(self.settings.health, period=self.settings.period))
        self._members = Members(self.settings)
        self._structure = StructureWatch(
            StructureSettings(
                models=watched(self.settings.plant),
                noise=self.settings.noise, gains=self.settings.gains, decimals=self.settings.decimals
            )
        )
        self._given = list(given)
        self._waiting: deque[Sample | Trigger] = deque()
        self._reports: deque[MatchReport] = deque()
        self._recent: deque[Sample] = deque(maxlen=self.settings.schedule.stride)
        self._health: Health | None = None
        self._looked: _Looked | None = None
        self._standing: Verdict | None = None

    @property
    def waiting_for(self) -> tuple[int, int] | None:
        """First and last sample of the window whose match is awaited, if any."""
        if not self._waiting or isinstance(self._waiting[0], Sample):
            return None
        window = self._waiting[0].window
        return window.first, window.last

    @property
    def nominal(self) -> Candidate | None:
        """The nominal candidate as it stands."""
        if self._standing is None or self._standing.nominal is None:
            return None
        return self._members.candidate(self._standing.nominal)

    def push_sample(self, sample: Sample) -> list[Verdict]:
        """Take one sample; return the verdicts that became due."""
        self._waiting.append(sample)
        trigger = self.schedule.push(sample)
        if trigger is not None:
            self._waiting.append(trigger)
        return self._settle()

    def push_match(self, report: MatchReport) -> list[Verdict]:
        """Take one match; return the verdicts that became due."""
        self._reports.append(report)
        return self._settle()

    def _settle(self) -> list[Verdict]:
        verdicts = []
        while self._waiting:
            item = self._waiting[0]
            if isinstance(item, Sample):
                self._waiting.popleft()
                verdicts += self._watch(item)
                continue
            report = None
            if item.excited:
                # Matches come in order: one for an earlier window is of a trigger this object never
                # had (it joined late), one for a later window means that ours was lost.
                while self._reports and self._reports[0].sample < item.sample:
                    self._reports.popleft()
                if not self._reports:
                    break
                if self._reports[0].sample == item.sample:
                    report = self._reports.popleft()
            self._waiting.popleft()
            with one_thread():
                verdicts.append(self._judge(item, report))
        return verdicts

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
            return [self._stand(sample.index, window, f"{news.fault.value} is over: the plate obeys again")]
        with one_thread():
            self._let_go(news)
        return [self._stand(sample.index, window, news.reason)]

    def _let_go(self, alarm: Alarm) -> None:
        """Dismiss the candidates that were matched while the fault was already there."""
        gone = () if alarm.fault is Fault.DRIFT else self._members.expel(alarm.first, alarm.flagged)
        if not gone or self._standing is None or self._looked is None:
            return
        if not len(self._members):
            nobody = Judged((), None, None, (), decided=False, certainty="")
            self._standing = replace(self._standing, **nobody._asdict())
            return
        order = self._members.order
        plant = plant_model(self._looked.window, order)
        self._standing = self._scored(self._standing, self._looked._replace(plant=plant))

    def _judge(self, trigger: Trigger, report: MatchReport | None) -> Verdict:
        window = trigger.window
        self._watch_structure(window)
        if not trigger.excited:
            return self._stand(trigger.sample, window, "the set-point did not move")
        reason = self._admit(trigger, report)
        if not len(self._members):
            return self._stand(trigger.sample, window, reason)
        try:
            self._looked = _Looked(window, plant_model(window, self._members.order))
        except TwinmatchError as error:
            return self._stand(trigger.sample, window, f"nothing could be identified: {error}")
        fresh = replace(self._standing or self._nothing(), stands=False, reason=reason)
        self._standing = self._scored(fresh, self._looked)
        doubtful = report is not None and report.match.status is Status.NOT_EXPLAINED
        self._standing = self._at(self._standing, trigger.sample, window, doubtful=doubtful)
        return self._standing

    def _watch_structure(self, window: Window) -> None:
        """Ask now and then, of samples without a fault, which plant structure they pay for."""
        alarm = self.monitor.alarms[-1] if self.monitor.alarms else None
        if alarm is not None and alarm.overlaps(window.first, window.last):
            return
        self._structure.push(window)

    def _scored(self, verdict: Verdict, looked: _Looked) -> Verdict:
        return replace(verdict, **self._members.judge(looked.window, looked.plant)._asdict())

    def _stand(self, sample: int, window: Window, reason: str) -> Verdict:
        """The verdict before, marked as standing; only health, residuals and level are new."""
        base = replace(self._standing or self._nothing(), stands=True, reason=reason)
        return self._at(base, sample, window)

    def _at(self, verdict: Verdict, sample: int, window: Window, *, doubtful: bool = False) -> Verdict:
        """The verdict with what holds at this sample: window, residuals of the nominal, fault, level."""
        found, choice = self._residuals(verdict.nominal, window), self._structure.choice
        level, fault, since = trust_level(found, self.settings.limits), "", None
        if doubtful and level is TrustLevel.TRUSTED:
            level = TrustLevel.DOUBTFUL
        health = self._health
        if health is not None and health.state is State.FAULT and health.fault is not None:
            fault, since = health.fault.value, health.since
            # A plant that drifts still obeys: its next matches bring the twin up to it.
            drifts = health.fault is Fault.DRIFT and level is not TrustLevel.FAULT
            level = TrustLevel.DOUBTFUL if drifts else TrustLevel.FAULT
        elif level is TrustLevel.FAULT:
            fault, since = UNEXPLAINED, max(window.first, window.last - self.settings.schedule.stride + 1)
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
            residual_y=found.y,
            residual_u=found.u,
        )

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
            residual_y=float("nan"),
            residual_u=float("nan"),
        )

    def _admit(self, trigger: Trigger, report: MatchReport | None) -> str:
        if report is None:
            return "no match of this window arrived"
        window, match = trigger.window, report.match
        while self._given:
            self._take_in(self._given.pop(0), window)
        if match.status is not Status.ACCEPTED:
            return f"match refused: {match.reason}"
        alarm = self.monitor.fault_between(window.first, window.last)
        if alarm is not None:
            return f"match refused: {alarm.fault.value} since sample {alarm.first}: {alarm.reason}"
        name = candidate_name(report.operating_point)
        return self._take_in(Candidate(name, report.operating_point, match.parameters, window), window)

    def _take_in(self, candidate: Candidate, window: Window) -> str:
        try:
            return self._members.admit(candidate, window)
        except TwinmatchError as error:
            return f"no models of candidate {candidate.name}: {error}"

    def _residuals(self, nominal: str | None, window: Window) -> Residuals:
        if nominal is None:
            return Residuals(float("nan"), float("nan"))
        alarms = self.monitor.alarms
        over = alarms[-1].last if alarms else None  # what a past fault left is not the twin's
        first = max(
            window.first, window.last - self.settings.schedule.stride + 1, 0 if over is None else over + 1
        )
        newest = window.part(min(first, window.last), window.last)
        return residuals(self._members.candidate(nominal).parameters, newest, self.settings.gains)


def trust_level(found: Residuals, limits: TrustLimits) -> TrustLevel:
    """How far residuals of this size leave the nominal twin to be trusted."""
    if np.isnan(found.y):
        return TrustLevel.UNKNOWN
    if found.y >= limits.fault_y or found.u >= limits.fault_u:
        return TrustLevel.FAULT
    if found.y >= limits.doubtful_y or found.u >= limits.doubtful_u:
        return TrustLevel.DOUBTFUL
    return TrustLevel.TRUSTED
