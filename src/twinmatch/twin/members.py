"""The members of the family: every candidate with the models of its twin and their scores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from twinmatch.comparing import (
    Candidate,
    CandidateScore,
    Family,
    LoopConditions,
    OrderScore,
    SimoModel,
    Uncertain,
    choose_order,
    common_order,
    identify,
    judge_uncertainty,
    nominal_of,
    nu_gap_matrix,
    nu_gap_of,
    plant_gap,
    plant_gaps,
    score,
    score_orders,
    spans_of,
    twin_response,
    with_margins,
)
from twinmatch.dynamics import Parameters
from twinmatch.fitting import ORDERS
from twinmatch.signals import FloatArray, Window
from twinmatch.twin.settings import TwinSettings

__all__ = ["Judged", "Members"]


@dataclass(frozen=True, eq=False)
class _Member:
    """A candidate with the models of its twin and their scores, computed once on admission."""

    candidate: Candidate
    window: Window
    models: dict[str, SimoModel]
    orders: tuple[OrderScore, ...]
    chosen: str


class Judged(NamedTuple):
    """The judgement of the family; the fields are those of a verdict."""

    candidates: tuple[CandidateScore, ...]
    nominal: str | None
    order: str | None
    nu_gap: tuple[tuple[float, ...], ...]
    nu_gap_points: tuple[float, ...]
    identified_gap: tuple[tuple[float, ...], ...]
    certainty: str


class Members:
    """Admits candidates, removes them, and scores the current ones."""

    def __init__(self, settings: TwinSettings) -> None:
        """Begin without candidates."""
        self._settings = settings
        self._family = Family(settings.most_candidates, settings.regime_width)
        self._members: dict[str, _Member] = {}
        self._reached: tuple[float, float] | None = None
        scales, span = spans_of(settings.plant), settings.schedule.span
        self._loop = LoopConditions(settings.gains, scales, span, settings.period)

    def __len__(self) -> int:
        return len(self._members)

    def candidate(self, name: str) -> Candidate:
        """The candidate of this name.

        Raises:
            KeyError: there is none.
        """
        return self._members[name].candidate

    def standing_at(self, operating_point: float) -> Candidate | None:
        """The candidate whose regime contains this set-point, if any."""
        return self._family.standing_at(operating_point)

    @property
    def newest(self) -> tuple[Candidate, ...]:
        """The candidates in the order in which they were admitted."""
        return tuple(member.candidate for member in self._members.values())

    @property
    def order(self) -> str:
        """The order chosen by most members, in which all of them are compared."""
        return common_order([self._members[c.name].chosen for c in self._family.candidates])

    def model(self, window: Window) -> SimoModel:
        """Model of the members' order for a measured window, reached through the lower orders like all
        others.

        Raises:
            IdentificationError: set-point or input does not move, or there are too few samples.
        """
        return identify(window, ORDERS[: ORDERS.index(self.order) + 1], scale=self._settings.model_scale)[-1]

    def admit(self, candidate: Candidate, window: Window) -> str:
        """Identify the candidate's twin on a window and admit it; return a sentence about it.

        Raises:
            TwinmatchError: its twin cannot be run or identified there.
        """
        settings = self._settings
        response = twin_response(
            candidate.parameters, window, settings.gains, settings.sensor, settings.seed + window.first
        )
        models = {m.order: m for m in identify(response, scale=settings.model_scale)}
        measured = window.part(response.first, response.last)
        absolute = settings.plant.output.absolute
        orders = score_orders(list(models.values()), measured, settings.decimals, absolute=absolute)
        leaving = self._family.admit(candidate)
        if leaving is not None:
            self._members.pop(leaving.name)
        self._members[candidate.name] = _Member(candidate, window, models, orders, choose_order(orders))
        return f"candidate {candidate.name} matched on samples {window.first} to {window.last}"

    def expel(self, first: int, last: int) -> tuple[str, ...]:
        """Remove candidates matched on samples that overlap `first` to `last`; return their names."""
        gone = tuple(
            name
            for name, member in self._members.items()
            if member.candidate.window is not None
            and member.window.first <= last
            and member.window.last >= first
        )
        for name in gone:
            self._family.dismiss(name)
            del self._members[name]
        return gone

    def judge(
        self, newest: Window, plant: SimoModel, now: Parameters | None, structures: Sequence[Candidate] = ()
    ) -> Judged:
        """Score all candidates on a measured window, and choose the nominal one.

        Args:
            newest: the window.
            plant: the model identified on it.
            now: the plant fitted to the newest samples, if that was possible.
            structures: candidates of other structures, to be compared with the family (the paper's); they
                have no Box–Jenkins models.
        """
        family = [self._members[c.name] for c in self._family.candidates]
        models = [j.models[plant.order] for j in family]
        identified = nu_gap_matrix([m.symbol for m in models])
        all_candidates = [*self._family.candidates, *structures]
        twins = [Uncertain(c.parameters, c.free, c.covariance) for c in all_candidates]
        points, terms, count = self._points(newest), self._loop, len(family)
        gaps = plant_gaps([t.parameters for t in twins], points, terms)
        to_now = [None if now is None else plant_gap(t.parameters, now, points, terms) for t in twins]
        distances = gaps.matrix[:, :count].sum(axis=1)
        decimals, absolute = self._settings.decimals, self._settings.plant.output.absolute
        bare = [_bare_score(*of) for of in zip(all_candidates, distances.tolist(), to_now, strict=True)]
        scores = tuple(
            replace(
                bare[k],
                first=member.window.first,
                last=member.window.last if member.candidate.window else member.window.first - 1,
                orders=member.orders,
                chosen_order=member.chosen,
                newest=score(model, newest, decimals, absolute=absolute).total,
                identified_gap_sum=float(identified[k].sum()),
                identified_gap_to_plant=nu_gap_of(model.symbol, plant.symbol),
            )
            for k, (member, model) in enumerate(zip(family, models, strict=True))
        )
        nominal = nominal_of(scores)
        certainty = judge_uncertainty(
            scores, twins[:count], gaps.of(count), nominal, terms, plant=now, seed=self._settings.seed
        )
        others = tuple(bare[count:])
        if nominal is not None:
            centre = next(c for c in certainty.candidates if c.name == nominal)
            others = with_margins((centre, *others), 0, self._settings.gains)[1:]
        return Judged(
            candidates=(*certainty.candidates, *others),
            nominal=nominal,
            order=plant.order,
            nu_gap=_rows(gaps.matrix),
            nu_gap_points=gaps.points,
            identified_gap=_rows(identified),
            certainty=certainty.certainty,
        )

    def _points(self, newest: Window) -> tuple[float, ...]:
        """Operating points at which plants are compared: the family's, and the lowest and the highest
        set-point of all judged windows; where the loop is not known, the lowest and the highest output at
        the end of a window."""
        levels = newest.reference
        if self._settings.gains is None:
            levels = np.array([newest.output[-self._settings.schedule.min_span :].mean()])
        seen = [float(levels.min()), float(levels.max()), *(self._reached or ())]
        self._reached = min(seen), max(seen)
        return tuple(sorted({*self._reached, *(c.operating_point for c in self._family.candidates)}))


def _bare_score(candidate: Candidate, distance: float, to_now: float | None) -> CandidateScore:
    """The scores of a candidate of any structure that need no models of its twin."""
    window = candidate.window
    return CandidateScore(
        name=candidate.name,
        operating_point=candidate.operating_point,
        parameters=candidate.parameters,
        first=window.first if window is not None else 0,
        last=window.last if window is not None else -1,
        orders=(),
        chosen_order="",
        nu_gap_sum=distance,
        newest=None,
        nu_gap_to_plant=to_now,
    )


def _rows(matrix: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in matrix.tolist())
