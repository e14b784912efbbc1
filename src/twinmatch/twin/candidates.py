"""The pool of candidates: matches and fitted structures, with their scores and forecasts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Final, NamedTuple

import numpy as np

from twinmatch.comparing import (
    Candidate,
    CandidateScore,
    Family,
    LoopConditions,
    OrderScore,
    SimoModel,
    choose_order,
    common_order,
    identify,
    judge_uncertainty,
    nominal_of,
    nu_gap,
    nu_gap_matrix,
    plant_gap,
    plant_gaps,
    score,
    score_orders,
    spans_of,
    twin_response,
)
from twinmatch.dynamics import Parameters, Plant, PlantError
from twinmatch.fitting import ORDERS
from twinmatch.signals import FloatArray, OperatingPoint, Window, point_of, point_values
from twinmatch.twin.forecaster import Forecaster
from twinmatch.twin.settings import TwinSettings
from twinmatch.twin.structure_fits import StructureFits, watched


class FamilyScores(NamedTuple):
    """The scores of all candidates; the fields are those of a verdict."""

    candidates: tuple[CandidateScore, ...]
    nominal: str | None
    order: str | None
    nu_gap: tuple[tuple[float, ...], ...]
    nu_gap_points: tuple[float, ...]
    identified_gap: tuple[tuple[float, ...], ...]
    certainty: str


_NO_ORDERS: Final = "orders and code lengths are for plants with one loop"
UNSCORED: Final = FamilyScores((), None, None, (), (), (), "")


@dataclass(frozen=True, eq=False)
class _Member:
    """A match of the family with the models of its twin and their scores, computed once on admission."""

    candidate: Candidate
    window: Window
    models: dict[str, SimoModel]
    orders: tuple[OrderScore, ...]
    chosen_order: str


FamilyModels = Mapping[tuple[str, int, int], tuple[SimoModel, ...]]
"""Box–Jenkins models of the twins of a family, one per order, by name of the candidate and by first and last
sample of its score."""


class _NewestWindow(NamedTuple):
    """The newest window that was scored, and the model identified on it."""

    window: Window
    model: SimoModel | None
    """None: the plant has several loops."""
    plant_now: Parameters | None
    """Parameters of the plant fitted to the newest samples, if that was possible."""


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
        self._single = plant.single
        widths = point_of([settings.regime_width * unit for unit in settings.units])
        self._family = Family(settings.most_candidates, widths)
        self._members: dict[str, _Member] = {}
        self._successors: dict[str, str] = {}
        """By name of a match that was admitted since `enter` the one whose regime it took over."""
        self._newest: _NewestWindow | None = None
        self._reached: tuple[FloatArray, FloatArray] | None = None
        """Lowest and highest levels of all scored windows; see `_points`."""
        self._loop = LoopConditions(
            law, spans_of(plant), settings.schedule.span, period
        )
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
                key = (name, *_samples_of(member))
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
        member = self._member(candidate, window)
        leaving = self._family.admit(candidate)
        if leaving is not None:
            self._members.pop(leaving.name)
        self._members[candidate.name] = member
        return f"candidate {candidate.name} matched on samples {window.first} to {window.last}"

    def _member(self, candidate: Candidate, window: Window) -> _Member:
        """A match with its twin's models; a plant of several loops has none."""
        settings = self._settings
        if not self._single:
            return _Member(candidate, window, {}, (), "")
        seed = settings.seed + window.first
        response = twin_response(
            candidate.parameters, window, settings.law, settings.sensor, seed
        )
        models = {
            m.order: m
            for m in identify(
                response, scale=settings.model_scale, lead=settings.schedule.lead
            )
        }
        measured = window.part(response.first, response.last)
        absolute = settings.plant.output.absolute
        orders = score_orders(
            list(models.values()), measured, settings.decimals, absolute=absolute
        )
        return _Member(candidate, window, models, orders, choose_order(orders))

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
                model = self._model(self._newest.window)
                self.scores = self._score_all(self._newest._replace(model=model))
        return gone

    def score(self, window: Window) -> None:
        """Score all candidates on a window.

        Raises:
            TwinmatchError: no model can be identified on it.
        """
        plant_now = self.structures.plant_now()
        self._newest = _NewestWindow(window, self._model(window), plant_now)
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

    def _model(self, window: Window) -> SimoModel | None:
        """Model of a measured window, of the order chosen by most members, in which all are compared.

        It is reached through the lower orders like all others.

        Raises:
            FittingError: set-point or input does not move, or there are too few samples.
        """
        if not self._single:
            return None
        order = common_order(
            [self._members[c.name].chosen_order for c in self._family.candidates]
        )
        orders = ORDERS[: ORDERS.index(order) + 1]
        settings = self._settings
        return identify(
            window, orders, scale=settings.model_scale, lead=settings.schedule.lead
        )[-1]

    def _score_all(self, newest: _NewestWindow) -> FamilyScores:
        """The scores of the family, and beside it of the structure with the best forecasts."""
        fitted = {c.name: c for c in (*self.structures.candidates, *self._remembered)}
        best = self.forecaster.standings.best_of(fitted)
        beside = [] if best is None else [fitted[best]]
        try:
            return self._compare(newest, beside)
        except PlantError:
            if not any(candidate.parameters.model.is_external for candidate in beside):
                raise
            return self._compare(newest, [])

    def _compare(
        self, newest: _NewestWindow, beside: Sequence[Candidate]
    ) -> FamilyScores:
        """Compare all candidates with one another and with the plant, and choose the nominal one.

        Structures beside the family (the paper's) have no Box–Jenkins models.
        """
        window, plant, plant_now = newest
        family = [self._members[c.name] for c in self._family.candidates]
        candidates = [*self._family.candidates, *beside]
        points = self._points(window)
        loop = self._loop
        count = len(family)
        gaps = plant_gaps([c.parameters for c in candidates], points, loop)
        gaps_to_plant = [
            None
            if plant_now is None
            else plant_gap(c.parameters, plant_now, points, loop)
            for c in candidates
        ]
        distances = gaps.matrix[:, :count].sum(axis=1).tolist()
        bare_scores = [
            _bare_score(*arguments)
            for arguments in zip(candidates, distances, gaps_to_plant, strict=True)
        ]
        scores = tuple(
            _with_orders(bare_score, member)
            for bare_score, member in zip(bare_scores[:count], family, strict=True)
        )
        identified = np.zeros((0, 0))
        if plant is not None:
            scores, identified = self._with_models(scores, family, window, plant)
        nominal = nominal_of(scores)
        all_scores = (*scores, *bare_scores[count:])
        twins = candidates[:count]
        certainty = judge_uncertainty(
            all_scores,
            twins,
            gaps.of(count),
            nominal,
            loop,
            plant=plant_now,
            seed=self._settings.seed,
        )
        return FamilyScores(
            candidates=certainty.candidates,
            nominal=nominal,
            order=plant.order if plant else None,
            nu_gap=_rows(gaps.matrix),
            nu_gap_points=tuple(chain.from_iterable(map(point_values, gaps.points))),
            identified_gap=_rows(identified),
            certainty=certainty.certainty
            if plant
            else f"{certainty.certainty}; {_NO_ORDERS}",
        )

    def _with_models(
        self,
        scores: Sequence[CandidateScore],
        family: Sequence[_Member],
        window: Window,
        plant: SimoModel,
    ) -> tuple[tuple[CandidateScore, ...], FloatArray]:
        """The scores with what the twins' models of the plant's order say, and the ν-gaps between these."""
        decimals = self._settings.decimals
        absolute = self._settings.plant.output.absolute
        models = [member.models[plant.order] for member in family]
        gaps = nu_gap_matrix([m.symbol for m in models])
        modelled = tuple(
            replace(
                bare_score,
                newest=score(model, window, decimals, absolute=absolute).total,
                identified_gap_sum=float(row.sum()),
                identified_gap_to_plant=nu_gap(model.symbol, plant.symbol),
            )
            for bare_score, model, row in zip(scores, models, gaps, strict=True)
        )
        return modelled, gaps

    def _points(self, newest: Window) -> tuple[OperatingPoint, ...]:
        """Operating points at which plants are compared: the family's, and the lowest and the highest
        set-points of all scored windows; where the loop is not known, the lowest and the highest outputs at
        the end of a window."""
        levels = newest.references
        if self._settings.law is None:
            settled = newest.outputs[-self._settings.schedule.min_span :].T
            levels = np.array([[y.mean() for y in settled]])
        if self._reached is not None:
            levels = np.vstack([levels, *self._reached])
        lowest = levels.min(axis=0)
        highest = levels.max(axis=0)
        self._reached = lowest, highest
        points = {candidate.operating_point for candidate in self._family.candidates}
        return tuple(
            sorted(points | {point_of(lowest), point_of(highest)}, key=point_values)
        )


def _samples_of(member: _Member) -> tuple[int, int]:
    """First and last sample to which a member of the family was fitted; of a given one the last is before the
    first, where its window begins."""
    window = member.window
    last = window.last if member.candidate.window else window.first - 1
    return window.first, last


def _with_orders(score: CandidateScore, member: _Member) -> CandidateScore:
    """The score of a member of the family, with its samples and what its orders have."""
    first, last = _samples_of(member)
    return replace(
        score,
        first=first,
        last=last,
        orders=member.orders,
        chosen_order=member.chosen_order,
    )


def _bare_score(
    candidate: Candidate, distance: float, gap_to_plant: float | None
) -> CandidateScore:
    """The scores of a candidate of any structure, without those for which its twin needs a model."""
    first, last = candidate.samples
    return CandidateScore(
        name=candidate.name,
        operating_point=candidate.operating_point,
        parameters=candidate.parameters,
        first=first,
        last=last,
        orders=(),
        chosen_order="",
        nu_gap_sum=distance,
        newest=None,
        nu_gap_to_plant=gap_to_plant,
    )


def _rows(matrix: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in matrix.tolist())
