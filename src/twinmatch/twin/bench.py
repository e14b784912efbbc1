"""All candidates, from matches and from structure fits, with their scores and forecasts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from twinmatch.comparing import DECIDED_FROM, Candidate, SimoModel, Verdict
from twinmatch.dynamics import Parameters, PlantError
from twinmatch.signals import Window
from twinmatch.twin.contenders import Contenders
from twinmatch.twin.entrant import Entrant
from twinmatch.twin.forecaster import Forecaster
from twinmatch.twin.members import Judged, Members
from twinmatch.twin.present import Present
from twinmatch.twin.settings import TwinSettings
from twinmatch.twin.structure_watch import StructureSettings, StructureWatch, watched
from twinmatch.twin.structures import StructureChoice

__all__ = ["Bench"]


class _NewestWindow(NamedTuple):
    """The newest window that was judged, and the model identified on it."""

    window: Window
    plant: SimoModel
    now: Parameters | None
    """Parameters of the plant fitted to the newest samples."""


class Bench:
    """All candidates: the family of matches, the structures beside it, and the forecaster that runs them."""

    def __init__(self, settings: TwinSettings, spoilt: Callable[[int, int], bool]) -> None:
        """Begin without candidates; `spoilt(first, last)` excludes stretches from learning."""
        plant, noise, gains, period = settings.plant, settings.noise, settings.gains, settings.period
        self.members = Members(settings)
        self.forecaster = Forecaster(gains, settings.forecasts, spoilt, period)
        self._structure = StructureWatch(
            StructureSettings(models=watched(plant), noise=noise, gains=gains, decimals=settings.decimals)
        )
        others = tuple(model for model in watched(plant) if model is not settings.start.model)
        self._contenders = Contenders(others, noise, gains, period)
        self._present = Present(watched(plant), noise, gains)
        self._successors: dict[str, str] = {}
        self._newest: _NewestWindow | None = None

    @property
    def choice(self) -> StructureChoice | None:
        """The newest choice among the structures, if there is one yet."""
        return self._structure.choice

    def take_in(self, candidate: Candidate, window: Window) -> str:
        """Admit a match to the family; return a sentence about it.

        Raises:
            TwinmatchError: its twin cannot be run or identified on the window.
        """
        before = self.members.standing_at(candidate.operating_point)
        if before is not None:
            self._successors[candidate.name] = before.name
        return self.members.admit(candidate, window)

    def watch(self, window: Window, *, excited: bool) -> None:
        """Fit all structures to a window of a healthy plant."""
        self._structure.push(window)
        self._contenders.push(window, excited=excited)

    def renew(self, first: int) -> None:
        """Discard structure-fit samples before `first`, where the plant has changed."""
        self._contenders.renew(first)

    def enter(self) -> None:
        """Pass all candidates to the forecaster: the structures, then the matches, newest first."""
        entrants = [Entrant.of(c.candidate, c.states_at) for c in self._contenders.held]
        entrants += [Entrant.of(candidate) for candidate in reversed(self.members.newest)]
        self.forecaster.enter(entrants, self._successors)
        self._successors = {}

    def score(self, verdict: Verdict, window: Window) -> Verdict:
        """Score all candidates on a window; return the updated verdict.

        Raises:
            TwinmatchError: no model can be identified on it.
        """
        plant = self.members.model(window)
        self._newest = _NewestWindow(window, plant, self._present.fitted(self._structure.history))
        return self._scored(verdict, self._newest)

    def expel(self, verdict: Verdict | None, first: int, last: int) -> tuple[Verdict | None, tuple[str, ...]]:
        """Remove the candidates fitted to samples that overlap `first` to `last`.

        Returns the verdict with the remaining candidates, and the names of those removed.
        """
        gone = self.members.expel(first, last) + self._contenders.expel(first, last)
        self._present.forget()
        self.enter()
        if not gone or verdict is None or self._newest is None:
            return verdict, gone
        if not len(self.members):
            nothing = Judged((), None, None, (), (), (), certainty="")
            return replace(verdict, **nothing._asdict()), gone
        plant = self.members.model(self._newest.window)
        return self._scored(verdict, self._newest._replace(plant=plant)), gone

    def with_leader(self, verdict: Verdict) -> Verdict:
        """Score the verdict again if the leader is a structure that is not in it."""
        names = {candidate.name for candidate in verdict.candidates}
        if self._newest is None or not names or self.forecaster.leader in names:
            return verdict
        return self._scored(verdict, self._newest)

    def with_forecasts(self, verdict: Verdict) -> Verdict:
        """Add the scores of the candidates' forecasts to the verdict."""
        forecaster = self.forecaster
        leader, confidence = forecaster.leader, forecaster.confidence
        return replace(
            verdict,
            leader=leader,
            leader_confidence=float("nan") if leader is None else confidence,
            decided=leader is not None and confidence >= DECIDED_FROM,
            certainty="; ".join(part for part in (forecaster.sentence, verdict.certainty) if part),
            horizons=forecaster.settings.horizons,
            forecasts=forecaster.scores,
        )

    def _scored(self, verdict: Verdict, newest: _NewestWindow) -> Verdict:
        beside = self._beside()
        try:
            judged = self.members.judge(*newest, beside)
        except PlantError:
            if not any(candidate.parameters.model.is_elsewhere for candidate in beside):
                raise
            judged = self.members.judge(*newest)
        return replace(verdict, **judged._asdict())

    def _beside(self) -> list[Candidate]:
        """The structure to compare with the matches: the one with the best forecasts."""
        held = {contender.candidate.name: contender.candidate for contender in self._contenders.held}
        best = self.forecaster.best_of(held)
        return [] if best is None else [held[best]]
