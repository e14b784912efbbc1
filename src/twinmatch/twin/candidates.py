"""The pool of candidates: matches and fitted structures, with their scores and forecasts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from twinmatch.comparing import Candidate, Family, SimoModel
from twinmatch.dynamics import Plant, PlantError
from twinmatch.signals import OperatingPoint, Window, point_of, point_values
from twinmatch.twin.family_scores import (
    UNSCORED,
    FamilyComparison,
    FamilyMember,
    FamilyScores,
    NewestWindow,
)
from twinmatch.twin.forecaster import Forecaster
from twinmatch.twin.settings import TwinSettings
from twinmatch.twin.structure_fits import StructureFits, watched

FamilyModels = Mapping[tuple[str, int, int], tuple[SimoModel, ...]]
"""Box–Jenkins models of the twins of a family, one per order, by name of the candidate and by first and last
sample of its score."""


def name_at(point: OperatingPoint, plant: type[Plant]) -> str:
    """What a match at an operating point is called; of several outputs as precisely as they are shown."""
    values = point_values(point)
    outputs = [*plant.outputs.values()]
    if len(outputs) > 1:
        shown = [
            round(value, output.decimals)
            for value, output in zip(values, outputs, strict=True)
        ]
        values = tuple(value + 0.0 for value in shown)  # which makes minus zero zero
    return ", ".join(
        f"{value:g} {output.unit}".rstrip()
        for value, output in zip(values, outputs, strict=True)
    )


class CandidatePool:
    """All candidates: the family of matches, the structures beside it, and the forecaster that runs them."""

    def __init__(
        self,
        settings: TwinSettings,
        spoilt: Callable[[int, int], bool],
        remembered: Sequence[Candidate] = (),
    ) -> None:
        """Begin with twins of earlier sessions; `spoilt(first, last)` excludes stretches from learning."""
        plant = settings.plant
        law = settings.law
        period = settings.period
        self._settings = settings
        self.forecaster = Forecaster(law, settings.forecasts, spoilt, period)
        self.structures = StructureFits(
            watched(plant),
            settings.noise,
            law,
            period,
            matched=settings.start.model,
            scale=settings.forecasts.scale,
            prior=settings.prior,
        )
        self.scores: FamilyScores | None = None
        """The newest scores; None before the first."""
        widths = point_of([settings.regime_width * unit for unit in settings.units])
        self._family = Family(settings.most_candidates, widths)
        self._comparison = FamilyComparison(settings)
        self._members: dict[str, FamilyMember] = {}
        self._successors: dict[str, str] = {}
        """By name of a match that was admitted since `enter` the one whose regime it took over."""
        self._newest: NewestWindow | None = None
        self._remembered = tuple(remembered)
        self.estranged = ""
        """Why the memory of earlier sessions was left; empty if it was not."""
        self.forecaster.enter(self._remembered)

    @property
    def empty(self) -> bool:
        """Whether the family has no match."""
        return not self._members

    @property
    def nominal(self) -> Candidate | None:
        """The nominal match of the newest scores."""
        name = None if self.scores is None else self.scores.nominal
        return None if name is None else self._members[name].candidate

    @property
    def models(self) -> FamilyModels:
        """Box–Jenkins models of the twins of the family."""
        models = {}
        for name, member in self._members.items():
            if member.models:
                key = (name, *member.samples)
                models[key] = tuple(member.models.values())
        return models

    def incumbent_at(self, operating_point: OperatingPoint) -> Candidate | None:
        """The match whose regime contains this operating point, if any."""
        return self._family.standing_at(operating_point)

    def admit(self, candidate: Candidate, window: Window) -> str:
        """Identify a match's twin on a window and admit it to the family; return a sentence about it.

        Raises:
            TwinmatchError: its twin cannot be run or identified there.
        """
        before = self._family.standing_at(candidate.operating_point)
        if before is not None:
            self._successors[candidate.name] = before.name
        member = self._comparison.member(candidate, window)
        leaving = self._family.admit(candidate)
        if leaving is not None:
            self._members.pop(leaving.name)
        self._members[candidate.name] = member
        return f"candidate {candidate.name} matched on samples {window.first} to {window.last}"

    def enter(self) -> None:
        """Pass all candidates to the forecaster: the structures, the matches, newest first, and the
        remembered twins."""
        matches = [member.candidate for member in reversed(self._members.values())]
        self.structures.watch(
            [match.parameters.model for match in matches if match.window is not None]
        )
        self.forecaster.enter(
            [*self.structures.candidates, *matches, *self._remembered], self._successors
        )
        self._successors = {}

    def rests_on_memory(self, name: str | None) -> bool:
        """Whether a candidate is a remembered twin."""
        return any(candidate.name == name for candidate in self._remembered)

    def leave_memory(self) -> tuple[str, ...]:
        """If the plant is not the remembered one, remove the remembered twins and the matches that had their
        values as prior; return the names of these."""
        estranged = self.structures.estranged
        if self.estranged or not estranged:
            return ()
        self.estranged = estranged
        self._remembered = ()
        prior = self._settings.prior
        # This closes their accounts: fits of these structures without the prior enter later with new ones.
        self.forecaster.enter(
            [c for c in self.structures.candidates if c.name not in prior]
        )
        self.structures.forget()
        informed = []
        for name, member in self._members.items():
            if member.candidate.parameters.model.structure_name in prior:
                informed.append(name)
        return self._remove(informed)

    def expel(self, first: int, last: int) -> tuple[str, ...]:
        """Remove the candidates fitted to samples that overlap `first` to `last`; return their names."""
        matches = []
        for name, member in self._members.items():
            first_fitted, last_fitted = member.candidate.samples
            if first_fitted <= last and last_fitted >= first:
                matches.append(name)
        return self._remove(matches, self.structures.expel(first, last))

    def _remove(
        self, matches: Sequence[str], structures: tuple[str, ...] = ()
    ) -> tuple[str, ...]:
        """Remove matches, and compare what is left; `structures` are removed already. Returns all names."""
        for name in matches:
            self._family.dismiss(name)
            del self._members[name]
        gone = (*matches, *structures)
        self.enter()
        if gone and self.scores is not None and self._newest is not None:
            if self.empty:
                self.scores = UNSCORED
            else:
                model = self._comparison.model_of(self._newest.window, self._in_order)
                self.scores = self._score_all(self._newest._replace(model=model))
        return gone

    def score(self, window: Window) -> None:
        """Score all candidates on a window.

        Raises:
            TwinmatchError: no model can be identified on it.
        """
        plant_now = self.structures.plant_now()
        model = self._comparison.model_of(window, self._in_order)
        self._newest = NewestWindow(window, model, plant_now)
        self.scores = self._score_all(self._newest)

    def score_leader(self) -> None:
        """Score all candidates again if the leader is a structure without scores."""
        names = (
            {candidate.name for candidate in self.scores.candidates}
            if self.scores
            else set()
        )
        if self._newest is not None and names and self.forecaster.leader not in names:
            self.scores = self._score_all(self._newest)

    @property
    def _in_order(self) -> list[FamilyMember]:
        """The members of the family, in its order."""
        return [self._members[c.name] for c in self._family.candidates]

    def _score_all(self, newest: NewestWindow) -> FamilyScores:
        """The scores of the family, and beside it of the structure with the best forecasts."""
        fitted = {c.name: c for c in (*self.structures.candidates, *self._remembered)}
        best = self.forecaster.standings.best_of(fitted)
        beside = [] if best is None else [fitted[best]]
        try:
            return self._comparison.compare(newest, self._in_order, beside)
        except PlantError:
            if not any(candidate.parameters.model.is_external for candidate in beside):
                raise
            return self._comparison.compare(newest, self._in_order, [])
