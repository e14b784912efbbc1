"""The candidates that forecast beside the plant, and how their forecasts stand.

Both are never changed but replaced, so that what is derived from them is computed once.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from twinmatch.comparing import BASELINES, Candidate, ForecastScore
from twinmatch.dynamics import Foresight, Law
from twinmatch.forecasting import Calibration, Ledger, StateFilter
from twinmatch.forecasting.outlook import deviations, foresight_of
from twinmatch.signals import FloatArray

_SKILLS: Final = tuple(
    f"{name}_skill{end}" for end in ("", "_high") for name in BASELINES
)
"""Fields of `ForecastScore`."""


@dataclass
class Entrant:
    """A candidate with the filter of its states and the calibration of its bands."""

    candidate: Candidate
    state_filter: StateFilter
    calibration: Calibration = field(repr=False)

    def learn(
        self, sizes: FloatArray, variances: FloatArray, before: int, widths: FloatArray
    ) -> None:
        """Have its bands learn from one forecast, at the leads after `before`, samples.

        Args:
            sizes: |error| of the signals at N samples ahead, shape (signals, N); NaN where a sample was lost.
            variances: those that it expected of all of its signals, outputs first.
            before: lead up to which they have learned from this forecast already.
            widths: half widths of its bands when it was made, in standard deviations, shape (signals, L).
        """
        expected = deviations(self.candidate.parameters.model, variances)
        quotients = sizes / expected[: len(sizes)]
        self.calibration.learn(quotients, before, widths)


class Entrants(dict[str, Entrant]):
    """All of them by name, in the order that decides ties; never changed in place."""

    _foresight: Foresight | None = None

    @cached_property
    def external(self) -> tuple[str, ...]:
        """Names of those whose equations run elsewhere."""
        return tuple(
            name
            for name, entrant in self.items()
            if entrant.candidate.parameters.model.is_external
        )

    @cached_property
    def native(self) -> tuple[str, ...]:
        """Names of the others."""
        return tuple(name for name in self if name not in self.external)

    def foresight(self, law: Law | None, period: float) -> Foresight:
        """The joint forecast of the native ones; built once, so law and sample time (s) must not change."""
        if self._foresight is None:
            filters = [self[name].state_filter for name in self.native]
            self._foresight = foresight_of(
                [(f.parameters, f.free) for f in filters], law, period
            )
        return self._foresight


class _Savings(NamedTuple):
    """Characters that a candidate has saved per forecast."""

    total: float
    """At all horizons together; NaN before any forecast could be compared."""
    by_horizon: list[float]
    """NaN where none could be compared yet."""


class Standings:
    """How the forecasts of all candidates stand after some samples."""

    def __init__(
        self,
        entrants: Mapping[str, Entrant] = MappingProxyType({}),
        ledger: Ledger | None = None,
        horizons: Sequence[int] = (),
    ) -> None:
        """Of these candidates, if there is a ledger; `horizons` in samples."""
        self._entrants = entrants
        self._ledger = ledger
        self._horizons = horizons

    def best_of(self, names: Collection[str]) -> str | None:
        """Of the named candidates, the one whose forecasts have saved the most; None if none is present."""
        totals = {
            name: savings.total
            for name, savings in self._saved.items()
            if name in names
        }
        return max(
            totals,
            key=lambda name: -math.inf if math.isnan(totals[name]) else totals[name],
            default=None,
        )

    @cached_property
    def leader(self) -> str | None:
        """The best of all."""
        return self.best_of(self._entrants)

    @property
    def leading(self) -> ForecastScore | None:
        """The leader's score; None without candidates."""
        return next((score for score in self.scores if score.name == self.leader), None)

    def sentence(self, confidence: float) -> str:
        """Who leads and how certain that is; empty without candidates."""
        best = self.leading
        if best is None:
            return ""
        if math.isnan(best.gain):
            return (
                f"{best.name} leads until a forecast can be compared with the samples"
            )
        saved = f"{best.name} forecasts best: it saves {max(best.gain, 0.0):.2f} characters per forecast"
        beside_others = f", and in {100 * confidence:.0f} % of cases no other was more than 3 % better"
        return saved + (beside_others if len(self._entrants) > 1 else "")

    @cached_property
    def scores(self) -> tuple[ForecastScore, ...]:
        """Scores of all candidates, in their order."""
        return self._scores_of(tuple(self._saved))

    @property
    def alone(self) -> dict[str, ForecastScore]:
        """The leader's score in each forecast signal alone, by the signal's name: outputs, then inputs."""
        if self._ledger is None or self.leader is None:
            return {}
        plant = self._entrants[self.leader].candidate.parameters.model.plant
        names = [*plant.outputs, *plant.drives][: self._ledger.noise.size]
        alone = {}
        for signal, name in enumerate(names):
            [alone[name]] = self._scores_of((self.leader,), signal)
        return alone

    def _scores_of(
        self, names: Sequence[str], signal: int | None = None
    ) -> tuple[ForecastScore, ...]:
        """The scores of candidates; their skills and bands in all signals or in one."""
        if self._ledger is None:
            return ()
        skills_and_highs = np.concatenate(self._ledger.skills(names, signal), axis=1)
        forecasts = map(self._ledger.forecasts, names)
        of_each = zip(names, skills_and_highs.tolist(), forecasts, strict=True)
        return tuple(self._score(*of_one, signal) for of_one in of_each)

    def _score(
        self,
        name: str,
        skills: list[list[float]],
        forecasts: float,
        signal: int | None,
    ) -> ForecastScore:
        """The score of a candidate with these values of `_SKILLS`, and so many forecasts."""
        candidate = self._entrants[name].candidate
        calibration = self._entrants[name].calibration
        savings = self._saved[name]
        first, last = candidate.samples
        coverage = []
        independent = []
        for horizon in self._horizons:
            before = max(
                (shorter for shorter in self._horizons if shorter < horizon), default=0
            )
            share_inside, effective = calibration.coverage(before, horizon, signal)
            coverage.append(share_inside)
            independent.append(effective)
        return ForecastScore(
            name=name,
            parameters=candidate.parameters,
            first=first,
            last=last,
            gain=savings.total,
            gains=tuple(savings.by_horizon),
            forecasts=forecasts,
            coverage=tuple(coverage),
            independent=tuple(independent),
            **dict(zip(_SKILLS, map(tuple, skills), strict=True)),
        )

    @cached_property
    def _saved(self) -> dict[str, _Savings]:
        """What each candidate has saved, by name; empty without a ledger."""
        if self._ledger is None:
            return {}
        gains = self._ledger.gains(tuple(self._entrants))
        is_known = ~np.isnan(gains)
        known_sums = np.add.reduce(np.where(is_known, gains, 0.0), axis=1)
        totals = np.where(is_known.any(axis=1), known_sums, np.nan)
        saved = map(_Savings, totals.tolist(), gains.tolist())
        return dict(zip(self._entrants, saved, strict=True))
