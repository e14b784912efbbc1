"""Samples and matches in, verdicts out."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twinmatch.discrimination import (
    Candidate,
    CandidateScore,
    Family,
    OrderScore,
    SimoModel,
    TrustLevel,
    Verdict,
    choose_order,
    common_order,
    identify,
    nominal_of,
    nu_gap_matrix,
    nu_gap_of,
    score,
    twin_response,
)
from twinmatch.errors import TwinmatchError
from twinmatch.identification import ORDERS
from twinmatch.matching import Status
from twinmatch.signals import Sample, Window
from twinmatch.twin.matcher import MatchReport, candidate_name
from twinmatch.twin.residuals import Residuals, residuals
from twinmatch.twin.schedule import Schedule, Trigger
from twinmatch.twin.settings import TrustLimits, TwinSettings
from twinmatch.twin.threads import one_thread

__all__ = ["Discriminator"]


@dataclass(frozen=True, eq=False)
class _Judged:
    """A candidate with the models of its twin and their scores, found once when it is admitted."""

    candidate: Candidate
    window: Window
    models: dict[str, SimoModel]
    orders: tuple[OrderScore, ...]
    chosen: str


class Discriminator:
    """Judges the family at every trigger of the schedule.

    It runs its own schedule on the samples and, at an excited trigger, waits for the match of that
    window. Verdicts come out in the order of the triggers, whenever matches arrive, so that live
    nodes and a replay give the same ones.
    """

    def __init__(self, settings: TwinSettings | None = None, given: Sequence[Candidate] = ()) -> None:
        """Begin with no candidates but those given (their twins are judged on the first excited window)."""
        self.settings = settings or TwinSettings()
        self.schedule = Schedule(self.settings.schedule, self.settings.period)
        self._family = Family(self.settings.most_candidates, self.settings.regime_width)
        self._judged: dict[str, _Judged] = {}
        self._given = list(given)
        self._waiting: deque[Trigger] = deque()
        self._reports: deque[MatchReport] = deque()
        self._standing: Verdict | None = None

    @property
    def waiting_for(self) -> tuple[int, int] | None:
        """First and last sample of the window whose match is awaited, if any."""
        if not self._waiting:
            return None
        window = self._waiting[0].window
        return window.first, window.last

    @property
    def nominal(self) -> Candidate | None:
        """The nominal candidate as it stands."""
        if self._standing is None or self._standing.nominal is None:
            return None
        return self._judged[self._standing.nominal].candidate

    def push_sample(self, sample: Sample) -> list[Verdict]:
        """Take one sample; return the verdicts that became due."""
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
            trigger = self._waiting[0]
            report = None
            if trigger.excited:
                # Matches come in order: one for an earlier window is of a trigger this object never
                # had (it joined late), one for a later window means that ours was lost.
                while self._reports and self._reports[0].sample < trigger.sample:
                    self._reports.popleft()
                if not self._reports:
                    break
                if self._reports[0].sample == trigger.sample:
                    report = self._reports.popleft()
            self._waiting.popleft()
            with one_thread():
                verdicts.append(self._judge(trigger, report))
        return verdicts

    def _judge(self, trigger: Trigger, report: MatchReport | None) -> Verdict:
        if not trigger.excited:
            return self._stand(trigger)
        reason = self._admit(trigger, report)
        if not self._judged:
            return self._stand(trigger, reason)
        order = common_order([self._judged[c.name].chosen for c in self._family.candidates])
        try:
            plant = _plant_model(trigger.window, order)
        except TwinmatchError as error:
            return self._stand(trigger, f"nothing could be identified: {error}")
        candidates, matrix = self._score_family(trigger.window, plant)
        nominal = nominal_of(candidates)
        found = self._residuals(nominal, trigger.window)
        faulty = report is not None and report.match.status is Status.PLANT_FAULT_SUSPECTED
        level = TrustLevel.FAULT if faulty else trust_level(found, self.settings.limits)
        self._standing = Verdict(
            sample=trigger.sample,
            first=trigger.window.first,
            last=trigger.window.last,
            level=level,
            stands=False,
            nominal=nominal,
            reason=reason,
            decimals=self.settings.decimals,
            candidates=candidates,
            order=order,
            nu_gap=matrix,
            residual_y=found.y,
            residual_u=found.u,
        )
        return self._standing

    def _stand(self, trigger: Trigger, reason: str = "the set-point did not move") -> Verdict:
        """The verdict before, marked as standing; only the residuals and the level are new."""
        nominal = self._standing.nominal if self._standing else None
        found = self._residuals(nominal, trigger.window)
        level = trust_level(found, self.settings.limits)
        base = self._standing or Verdict(
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
        return replace(
            base,
            sample=trigger.sample,
            first=trigger.window.first,
            last=trigger.window.last,
            level=level,
            stands=True,
            reason=reason,
            residual_y=found.y,
            residual_u=found.u,
        )

    def _admit(self, trigger: Trigger, report: MatchReport | None) -> str:
        if report is None:
            return "no match of this window arrived"
        for given in self._given:
            self._take_in(given, trigger.window)
        self._given.clear()
        if report.match.status is not Status.ACCEPTED:
            return f"match refused: {report.match.reason}"
        name = candidate_name(report.operating_point)
        candidate = Candidate(name, report.operating_point, report.match.parameters, trigger.window)
        return self._take_in(candidate, trigger.window)

    def _take_in(self, candidate: Candidate, window: Window) -> str:
        settings = self.settings
        response = twin_response(
            candidate.parameters, window, settings.gains, settings.camera, settings.seed + window.first
        )
        try:
            models = {m.order: m for m in identify(response)}
        except TwinmatchError as error:
            return f"no models of candidate {candidate.name}: {error}"
        measured = window.part(response.first, response.last)
        orders = tuple(score(m, measured, settings.decimals) for m in models.values())
        leaving = self._family.admit(candidate)
        if leaving is not None:
            del self._judged[leaving.name]
        self._judged[candidate.name] = _Judged(candidate, window, models, orders, choose_order(orders))
        return f"candidate {candidate.name} matched on samples {window.first} to {window.last}"

    def _score_family(
        self, newest: Window, plant: SimoModel
    ) -> tuple[tuple[CandidateScore, ...], tuple[tuple[float, ...], ...]]:
        family = [self._judged[c.name] for c in self._family.candidates]
        models = [j.models[plant.order] for j in family]
        matrix = nu_gap_matrix([m.symbol for m in models])
        scores = tuple(
            CandidateScore(
                name=judged.candidate.name,
                operating_point=judged.candidate.operating_point,
                parameters=judged.candidate.parameters,
                first=judged.window.first,
                last=judged.window.last if judged.candidate.window else judged.window.first - 1,
                orders=judged.orders,
                chosen_order=judged.chosen,
                nu_gap_sum=float(total),
                newest=score(model, newest, self.settings.decimals).total,
                nu_gap_to_plant=nu_gap_of(model.symbol, plant.symbol),
            )
            for judged, model, total in zip(family, models, matrix.sum(axis=0), strict=True)
        )
        return scores, tuple(tuple(float(v) for v in row) for row in matrix)

    def _residuals(self, nominal: str | None, window: Window) -> Residuals:
        if nominal is None:
            return Residuals(float("nan"), float("nan"))
        newest = window.part(max(window.first, window.last - self.settings.schedule.stride + 1), window.last)
        return residuals(self._judged[nominal].candidate.parameters, newest, self.settings.gains)


def _plant_model(window: Window, order: str) -> SimoModel:
    """The measured window's model of one order, climbed to from the lower ones as every other was."""
    return identify(window, ORDERS[: ORDERS.index(order) + 1])[-1]


def trust_level(found: Residuals, limits: TrustLimits) -> TrustLevel:
    """How far residuals of this size leave the nominal twin to be trusted."""
    if np.isnan(found.y):
        return TrustLevel.UNKNOWN
    if found.y >= limits.fault_y or found.u >= limits.fault_u:
        return TrustLevel.FAULT
    if found.y >= limits.doubtful_y or found.u >= limits.doubtful_u:
        return TrustLevel.DOUBTFUL
    return TrustLevel.TRUSTED
