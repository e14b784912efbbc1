"""Who stands, and what they are worth: matches and structures, their scores, and what they foretell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from twinmatch.discrimination import DECIDED_FROM, Candidate, SimoModel, Verdict
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


class _Looked(NamedTuple):
    """The newest window that was judged, and the plant's model of it."""

    window: Window
    plant: SimoModel
    now: Parameters | None
    """The plant as the newest samples show it."""


class Bench:
    """All candidates: the family of matches, the structures beside it, and the forecaster that hears them."""

    def __init__(self, settings: TwinSettings, spoilt: Callable[[int, int], bool]) -> None:
        """Begin with nobody; of stretches that are `spoilt` nothing is learned."""
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
        self._looked: _Looked | None = None

    @property
    def choice(self) -> StructureChoice | None:
        """The newest choice among the structures, if there is one yet."""
        return self._structure.choice

    def take_in(self, candidate: Candidate, window: Window) -> str:
        """Admit a match to the family; return a sentence saying so.

        Raises:
            TwinmatchError: its twin cannot be run or identified on the window.
        """
        before = self.members.standing_at(candidate.operating_point)
        if before is not None:
            self._successors[candidate.name] = before.name
        return self.members.admit(candidate, window)

    def watch(self, window: Window, *, excited: bool) -> None:
        """Look at a window of a healthy plant with all structures."""
        self._structure.push(window)
        self._contenders.push(window, excited=excited)

    def renew(self, first: int) -> None:
        """Fit structures to samples from `first` on only: the plant has changed there."""
        self._contenders.renew(first)

    def enter(self) -> None:
        """Let all candidates foretell: the structures, then the matches, the newest first."""
        entrants = [Entrant.of(c.candidate, c.states_at) for c in self._contenders.held]
        entrants += [Entrant.of(candidate) for candidate in reversed(self.members.newest)]
        self.forecaster.enter(entrants, self._successors)
        self._successors = {}

    def score(self, verdict: Verdict, window: Window) -> Verdict:
        """The verdict with everyone scored against a window.

        Raises:
            TwinmatchError: no model can be identified on it.
        """
        plant = self.members.model(window)
        self._looked = _Looked(window, plant, self._present.look(self._structure.history))
        return self._scored(verdict, self._looked)

    def expel(self, verdict: Verdict | None, first: int, last: int) -> tuple[Verdict | None, tuple[str, ...]]:
        """Let everyone go who was fitted to samples that touch `first` to `last`.

        Returns the verdict with those that are left, and the names of those who went.
        """
        gone = self.members.expel(first, last) + self._contenders.expel(first, last)
        self._present.forget()
        self.enter()
        if not gone or verdict is None or self._looked is None:
            return verdict, gone
        if not len(self.members):
            nobody = Judged((), None, None, (), (), (), certainty="")
            return replace(verdict, **nobody._asdict()), gone
        plant = self.members.model(self._looked.window)
        return self._scored(verdict, self._looked._replace(plant=plant)), gone

    def let_lead(self, verdict: Verdict) -> Verdict:
        """The verdict scored again if another structure has come to lead, so that it stands in the family."""
        names = {candidate.name for candidate in verdict.candidates}
        if self._looked is None or not names or self.forecaster.leader in names:
            return verdict
        return self._scored(verdict, self._looked)

    def with_forecasts(self, verdict: Verdict) -> Verdict:
        """The verdict with what the candidates' forecasts are worth."""
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

    def _scored(self, verdict: Verdict, looked: _Looked) -> Verdict:
        beside = self._beside()
        try:
            judged = self.members.judge(*looked, beside)
        except PlantError:
            if not any(candidate.parameters.model.is_elsewhere for candidate in beside):
                raise
            judged = self.members.judge(*looked)
        return replace(verdict, **judged._asdict())

    def _beside(self) -> list[Candidate]:
        """The structure that stands beside the matches: of all the one that foretells best."""
        held = {contender.candidate.name: contender.candidate for contender in self._contenders.held}
        best = self.forecaster.best_of(held)
        return [] if best is None else [held[best]]
