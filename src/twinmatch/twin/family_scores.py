"""The scores of a family: how near its members are to one another and to the plant, and which is nominal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Final, NamedTuple

import numpy as np

from twinmatch.comparing import (
    Candidate,
    CandidateScore,
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
from twinmatch.dynamics import Parameters
from twinmatch.fitting import ORDERS
from twinmatch.signals import FloatArray, OperatingPoint, Window, point_of, point_values
from twinmatch.twin.settings import TwinSettings

_NO_ORDERS: Final = "orders and code lengths are for plants with one loop"


class FamilyScores(NamedTuple):
    """The scores of all candidates; the fields are those of a verdict."""

    candidates: tuple[CandidateScore, ...]
    nominal: str | None
    order: str | None
    nu_gap: tuple[tuple[float, ...], ...]
    nu_gap_points: tuple[float, ...]
    identified_gap: tuple[tuple[float, ...], ...]
    certainty: str


UNSCORED: Final = FamilyScores((), None, None, (), (), (), "")


@dataclass(frozen=True, eq=False)
class FamilyMember:
    """A match of the family with the models of its twin and their scores, computed once on admission."""

    candidate: Candidate
    window: Window
    models: dict[str, SimoModel]
    orders: tuple[OrderScore, ...]
    chosen_order: str

    @property
    def samples(self) -> tuple[int, int]:
        """First and last sample to which it was fitted; of a given one the last is before the first, where its
        window begins."""
        last = self.window.last if self.candidate.window else self.window.first - 1
        return self.window.first, last


class NewestWindow(NamedTuple):
    """The newest window that was scored, and the model identified on it."""

    window: Window
    model: SimoModel | None
    """None: the plant has several loops."""
    plant_now: Parameters | None
    """Parameters of the plant fitted to the newest samples, if that was possible."""


class FamilyComparison:
    """Compares the members of a family with one another, with structures beside it, and with the plant."""

    def __init__(self, settings: TwinSettings) -> None:
        """Begin without windows."""
        self._settings = settings
        self._single = settings.plant.single
        self._loop = LoopConditions(
            settings.law,
            spans_of(settings.plant),
            settings.schedule.span,
            settings.period,
        )
        self._reached: tuple[FloatArray, FloatArray] | None = None
        """Lowest and highest levels of all windows; see `_points`."""

    def member(self, candidate: Candidate, window: Window) -> FamilyMember:
        """A match with its twin's models on a window; a plant of several loops has none.

        Raises:
            TwinmatchError: the twin cannot be run or identified there.
        """
        settings = self._settings
        if not self._single:
            return FamilyMember(candidate, window, {}, (), "")
        seed = settings.seed + window.first
        response = twin_response(
            candidate.parameters, window, settings.law, settings.sensor, seed
        )
        identified = identify(
            response, scale=settings.model_scale, lead=settings.schedule.lead
        )
        models = {model.order: model for model in identified}
        measured = window.part(response.first, response.last)
        absolute = settings.plant.output.absolute
        orders = score_orders(
            list(models.values()), measured, settings.decimals, absolute=absolute
        )
        return FamilyMember(candidate, window, models, orders, choose_order(orders))

    def model_of(
        self, window: Window, family: Sequence[FamilyMember]
    ) -> SimoModel | None:
        """Model of a measured window, of the order chosen by most members, in which all are compared.

        It is reached through the lower orders like all others.

        Raises:
            FittingError: set-point or input does not move, or there are too few samples.
        """
        if not self._single:
            return None
        order = common_order([member.chosen_order for member in family])
        orders = ORDERS[: ORDERS.index(order) + 1]
        settings = self._settings
        return identify(
            window, orders, scale=settings.model_scale, lead=settings.schedule.lead
        )[-1]

    def compare(
        self,
        newest: NewestWindow,
        family: Sequence[FamilyMember],
        beside: Sequence[Candidate],
    ) -> FamilyScores:
        """Compare all candidates with one another and with the plant, and choose the nominal one.

        Structures beside the family (the paper's) have no Box–Jenkins models.
        """
        twins = [member.candidate for member in family]
        candidates = [*twins, *beside]
        points = self._points(newest.window, twins)
        gaps = plant_gaps([c.parameters for c in candidates], points, self._loop)
        gaps_to_plant = self._gaps_to_plant(candidates, newest.plant_now, points)
        distances = gaps.matrix[:, : len(family)].sum(axis=1).tolist()
        bare_scores = [
            _bare_score(candidate, distance, gap_to_plant)
            for candidate, distance, gap_to_plant in zip(
                candidates, distances, gaps_to_plant, strict=True
            )
        ]
        scores = tuple(
            _with_orders(bare_score, member)
            for bare_score, member in zip(bare_scores, family, strict=False)
        )
        identified = np.zeros((0, 0))
        if newest.model is not None:
            scores, identified = self._with_models(
                scores, family, newest.window, newest.model
            )
        nominal = nominal_of(scores)
        certainty = judge_uncertainty(
            (*scores, *bare_scores[len(family) :]),
            twins,
            gaps.of(len(family)),
            nominal,
            self._loop,
            plant=newest.plant_now,
            seed=self._settings.seed,
        )
        sentences = [certainty.certainty]
        if newest.model is None:
            sentences.append(_NO_ORDERS)
        return FamilyScores(
            candidates=certainty.candidates,
            nominal=nominal,
            order=None if newest.model is None else newest.model.order,
            nu_gap=_rows(gaps.matrix),
            nu_gap_points=tuple(chain.from_iterable(map(point_values, gaps.points))),
            identified_gap=_rows(identified),
            certainty="; ".join(sentences),
        )

    def _gaps_to_plant(
        self,
        candidates: Sequence[Candidate],
        plant_now: Parameters | None,
        points: Sequence[OperatingPoint],
    ) -> list[float | None]:
        """ν-gap of each candidate's plant to the one fitted to the newest samples; None if that is not known."""
        if plant_now is None:
            return [None] * len(candidates)
        return [
            plant_gap(candidate.parameters, plant_now, points, self._loop)
            for candidate in candidates
        ]

    def _with_models(
        self,
        scores: Sequence[CandidateScore],
        family: Sequence[FamilyMember],
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

    def _points(
        self, newest: Window, family: Sequence[Candidate]
    ) -> tuple[OperatingPoint, ...]:
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
        points = {candidate.operating_point for candidate in family}
        return tuple(
            sorted(points | {point_of(lowest), point_of(highest)}, key=point_values)
        )


def _with_orders(score: CandidateScore, member: FamilyMember) -> CandidateScore:
    """The score of a member of the family, with its samples and what its orders have."""
    first, last = member.samples
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
