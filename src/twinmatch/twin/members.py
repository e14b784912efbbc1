"""The judged family: every candidate with the models of its twin and their scores."""

from __future__ import annotations

from dataclasses import dataclass

from twinmatch.discrimination import (
    Candidate,
    CandidateScore,
    Family,
    OrderScore,
    SimoModel,
    choose_order,
    common_order,
    identify,
    nu_gap_matrix,
    nu_gap_of,
    score,
    twin_response,
)
from twinmatch.identification import ORDERS
from twinmatch.signals import Window
from twinmatch.twin.settings import TwinSettings

__all__ = ["Members", "plant_model"]

Matrix = tuple[tuple[float, ...], ...]


@dataclass(frozen=True, eq=False)
class _Judged:
    """A candidate with the models of its twin and their scores, found once when it is admitted."""

    candidate: Candidate
    window: Window
    models: dict[str, SimoModel]
    orders: tuple[OrderScore, ...]
    chosen: str


class Members:
    """Takes candidates in, lets them leave, and scores those that stand."""

    def __init__(self, settings: TwinSettings) -> None:
        """Begin with nobody."""
        self._settings = settings
        self._family = Family(settings.most_candidates, settings.regime_width)
        self._judged: dict[str, _Judged] = {}

    def __len__(self) -> int:
        return len(self._judged)

    def candidate(self, name: str) -> Candidate:
        """The candidate of this name.

        Raises:
            KeyError: there is none.
        """
        return self._judged[name].candidate

    @property
    def order(self) -> str:
        """The order most members chose, at which all of them are compared."""
        return common_order([self._judged[c.name].chosen for c in self._family.candidates])

    def admit(self, candidate: Candidate, window: Window) -> str:
        """Identify the candidate's twin on a window and take it in; return a sentence saying so.

        Raises:
            TwinmatchError: its twin cannot be run or identified there.
        """
        settings = self._settings
        response = twin_response(
            candidate.parameters, window, settings.gains, settings.camera, settings.seed + window.first
        )
        models = {m.order: m for m in identify(response)}
        measured = window.part(response.first, response.last)
        orders = tuple(score(m, measured, settings.decimals) for m in models.values())
        leaving = self._family.admit(candidate)
        if leaving is not None:
            del self._judged[leaving.name]
        self._judged[candidate.name] = _Judged(candidate, window, models, orders, choose_order(orders))
        return f"candidate {candidate.name} matched on samples {window.first} to {window.last}"

    def expel(self, first: int, last: int) -> tuple[str, ...]:
        """Let everyone go who was matched on samples that touch `first` to `last`; return their names."""
        gone = tuple(
            name
            for name, judged in self._judged.items()
            if judged.candidate.window is not None
            and judged.window.first <= last
            and judged.window.last >= first
        )
        for name in gone:
            self._family.dismiss(name)
            del self._judged[name]
        return gone

    def scores(self, newest: Window, plant: SimoModel) -> tuple[tuple[CandidateScore, ...], Matrix]:
        """Score everyone against a measured window and the plant's model identified on it."""
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
                newest=score(model, newest, self._settings.decimals).total,
                nu_gap_to_plant=nu_gap_of(model.symbol, plant.symbol),
            )
            for judged, model, total in zip(family, models, matrix.sum(axis=0), strict=True)
        )
        return scores, tuple(tuple(float(v) for v in row) for row in matrix)


def plant_model(window: Window, order: str) -> SimoModel:
    """The measured window's model of one order, climbed to from the lower ones as every other was.

    Raises:
        IdentificationError: the set-point does not move, or there are too few samples.
    """
    return identify(window, ORDERS[: ORDERS.index(order) + 1])[-1]
