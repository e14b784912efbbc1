"""Every candidate foretells; what came is held against it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from twinmatch.discrimination import ForecastScore
from twinmatch.dynamics import Pid, PidGains, PidState, PlantError
from twinmatch.forecasting import (
    PERSISTENCE,
    Calibration,
    Follower,
    Ledger,
    Outlook,
    leads_of,
)
from twinmatch.signals import FloatArray, Sample
from twinmatch.twin.entrant import Entrant, ForecastSettings
from twinmatch.twin.hindsight import Hindsight
from twinmatch.twin.promises import Promise, promise_of
from twinmatch.twin.snapshot import Snapshot, candidate_called

__all__ = ["Forecaster"]

_RUN_IN_S: Final = (60.0, 300.0)
"""Newest stretch on which a new candidate follows the plant, s: where its states are known, and where the
hidden ones have to be found."""
_SELDOM: Final = 3
"""Only every third time do bands of those who do not lead learn."""


@dataclass
class _Twin:
    """A candidate on its way."""

    entrant: Entrant
    follower: Follower
    calibration: Calibration = field(repr=False)


class Forecaster:
    """Follows every candidate and holds its forecasts against what came.

    At every sample each twin's states are corrected by the reading. Every `every` seconds all of them are put
    down as they are; when the longest horizon has come, they foretell from there, under the set-points that
    came meanwhile, and ledger and bands learn from the errors; twins whose loop is not known foretell the
    output under the inputs that came. All depends on samples and entrants alone.
    """

    def __init__(
        self,
        gains: PidGains | None,
        settings: ForecastSettings | None = None,
        spoilt: Callable[[int, int], bool] = lambda _first, _last: False,
        period: float = 1.0,
    ) -> None:
        """Begin without candidates.

        Args:
            gains: of the running controller; None for a loop that is not known.
            settings: horizons and pace.
            spoilt: whether something is known to have been wrong with the plant between two samples; nothing
                is learned from such a stretch.
            period: sample time of a plant whose loop is not known, s; a loop has its controller's.
        """
        self.settings = settings or ForecastSettings()
        self._gains, self._spoilt = gains, spoilt
        self._signals = 1 if gains is None else 2
        self.period = period = gains.period if gains is not None else period
        self.horizons = tuple(max(round(h / period), 1) for h in self.settings.horizons)
        self._longest = max(self.horizons)
        self._stride = max(round(self.settings.every / period), 1)
        self._kept = float(np.exp(-self.settings.every / self.settings.memory))
        self._leads = leads_of(period, self._longest)
        self._twins: dict[str, _Twin] = {}
        self._order: tuple[str, ...] = ()
        self._ledger: Ledger | None = None
        self._hindsight = Hindsight(self._kept)
        self._departures: dict[int, Snapshot] = {}
        self._run_in = tuple(round(stretch / period) for stretch in _RUN_IN_S)
        self._recent: deque[Sample] = deque(maxlen=max(self._longest, *self._run_in) + 1)
        self._visited = (np.inf, -np.inf)
        self._pid = None if gains is None else Pid(gains)
        self.notes: tuple[str, ...] = ()
        """What forecasts cannot promise now, for those who ask."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the candidates, in the order in which ties are decided."""
        return self._order

    @property
    def leader(self) -> str | None:
        """Whose forecasts have saved most; None without candidates."""
        return self.best_of(self._order)

    def best_of(self, names: Collection[str]) -> str | None:
        """Of some candidates the one whose forecasts have saved most; None if none of them is here."""
        scores = [score for score in self.scores if score.name in names]
        gains = [-np.inf if np.isnan(score.gain) else score.gain for score in scores]
        return scores[int(np.argmax(gains))].name if scores else None

    @property
    def confidence(self) -> float:
        """How probable it is that the leader is within 3 % of the best in hindsight, as it was before."""
        return self._hindsight.share

    @property
    def scores(self) -> tuple[ForecastScore, ...]:
        """Of all candidates, in their order."""
        ledger = self._ledger
        if ledger is None:
            return ()
        found = []
        for name, gains in zip(self._order, ledger.gains(self._order), strict=True):
            entrant = self._twins[name].entrant
            first, last = entrant.samples
            found.append(
                ForecastScore(
                    name=name,
                    parameters=entrant.parameters,
                    first=first,
                    last=last,
                    gain=float(np.nansum(gains)) if np.isfinite(gains).any() else float("nan"),
                    gains=tuple(gains.tolist()),
                    forecasts=ledger.forecasts(name),
                )
            )
        return tuple(found)

    @property
    def sentence(self) -> str:
        """Who leads and how sure that is, in plain words; empty without candidates."""
        leader = self.leader
        if leader is None:
            return ""
        best = next(score for score in self.scores if score.name == leader)
        if np.isnan(best.gain):
            return f"{leader} leads as long as no forecast has come true"
        saved = f"{leader} foretells best: it saves {best.gain:.2f} characters a forecast"
        return f"{saved}, and in {100 * self.confidence:.0f} % of cases no other was better by more than 3 %"

    def forecasts_of(self, name: str) -> float:
        """How many forecasts of a candidate could be held against what came, old ones counting less."""
        return 0.0 if self._ledger is None else self._ledger.forecasts(name)

    def push(self, sample: Sample) -> None:
        """Take one sample: follow with every twin, and learn from forecasts whose time has come."""
        if self._recent and sample.index != self._recent[-1].index + 1:
            self._break()
        self._recent.append(sample)
        self._visited = min(self._visited[0], sample.output), max(self._visited[1], sample.output)
        if self._pid is not None:
            self._pid.follow(sample.reference, sample.output, sample.input)
        for name, twin in list(self._twins.items()):
            with self._sparing(name):
                twin.follower.push(sample)
        if self._twins and sample.index % self._stride == 0:
            leader = self.leader
            outlooks = {name: self._outlook(name, banded=name == leader) for name in self._order}
            self._departures[sample.index] = Snapshot(leader, outlooks)
        for place, ahead in enumerate(self.horizons):
            departure = self._departures.get(sample.index - ahead)
            if departure is not None:
                self._learn(departure, sample.index - ahead, place)
        self._departures.pop(sample.index - self._longest, None)

    def enter(self, entrants: Sequence[Entrant], successors: Mapping[str, str] | None = None) -> None:
        """Set who the candidates are; those that are there with the same parameters just go on.

        Args:
            entrants: all candidates; of two that have saved as much, the one named first leads.
            successors: by the name of a new candidate, whose account it goes on with.
        """
        if self._ledger is None and entrants:
            plant = entrants[0].parameters.model.plant
            noise = np.array([plant.output.noise, plant.drive.noise])[: self._signals]
            self._ledger = Ledger(len(self.horizons), noise, self._kept)
        twins = {}
        for entrant in entrants:
            held = self._twins.get(entrant.name)
            if held is None or held.entrant.parameters != entrant.parameters:
                earlier = held or self._twins.get((successors or {}).get(entrant.name, ""))
                try:
                    held = self._begun(entrant, earlier)
                except PlantError:
                    if not entrant.parameters.model.is_elsewhere:
                        raise
                    continue
            twins[entrant.name] = held
        if self._ledger is not None:
            for name, before in (successors or {}).items():
                if name not in self._twins:
                    self._ledger.inherit(name, before)
            self._ledger.keep(twins)
        self._twins, self._order = twins, tuple(twins)

    def snapshot(self) -> Snapshot:
        """What all candidates know at the newest sample."""
        if not self._recent:
            return Snapshot()
        return Snapshot(self.leader, {name: self._outlook(name) for name in self._order})

    def outlook(self, name: str | None = None) -> Outlook:
        """What a candidate, or the leader, knows at the newest sample.

        Raises:
            ForecastError: there is no candidate yet, or none of that name.
        """
        name = candidate_called(self.leader if name is None else name, self._twins if self._recent else {})
        return self._outlook(name)

    def _outlook(self, name: str, *, banded: bool = True) -> Outlook:
        """What a candidate knows; without bands it is made for its mean."""
        twin = self._twins[name]
        return Outlook(
            sample=self._recent[-1],
            candidate=name,
            parameters=twin.entrant.parameters,
            states=twin.follower.states,
            covariance=twin.follower.joint,
            unsure=twin.follower.free,
            controller=PidState() if self._pid is None else self._pid.state,
            gains=self._gains,
            period=self.period,
            leads=self._leads,
            widths=twin.calibration.widths if banded else np.full((self._signals, len(self._leads)), np.nan),
            visited=self._visited,
            notes=self.notes,
        )

    def promise(self, samples: int) -> Promise | None:
        """How the newest readings lie in the bands that were given before them; None where none was.

        The forecast is that of the leader of its time, from the newest sample before these from which all
        foretold, under the set-points (or inputs) and the disturbances that came.
        """
        if not self._recent:
            return None
        newest = self._recent[-1].index
        made = [sample for sample in self._departures if sample <= newest - samples]
        if not made:
            return None
        came = list(self._recent)[made[-1] - newest - 1 :]
        outlook = self._departures[made[-1]].outlook()
        try:
            forecast = outlook.forecast(self._asked(came[1:]), _rows(came))
        except PlantError:
            if not outlook.parameters.model.is_elsewhere:
                raise
            return None
        newest_of = came[-samples:]
        output, input_ = (np.array([getattr(s, name) for s in newest_of]) for name in ("output", "input"))
        return promise_of(forecast, output, None if self._gains is None else input_)

    @contextmanager
    def _sparing(self, name: str) -> Iterator[None]:
        """Let a candidate go whose equations are elsewhere and fail there; all others stay and go on."""
        try:
            yield
        except PlantError:
            if not self._twins[name].entrant.parameters.model.is_elsewhere:
                raise
            del self._twins[name]
            self._order = tuple(self._twins)
            if self._ledger is not None:
                self._ledger.keep(self._twins)

    def _asked(self, came: Sequence[Sample]) -> FloatArray:
        """What a forecast is made under: the set-points that came, or the inputs."""
        return np.array([s.input if self._gains is None else s.reference for s in came])

    def _break(self) -> None:
        """The next sample does not follow: start again from readings; what was learned stays."""
        self._recent.clear()
        self._departures.clear()
        self._pid = None if self._gains is None else Pid(self._gains)
        for twin in self._twins.values():
            twin.follower.restart()

    def _begun(self, entrant: Entrant, before: _Twin | None) -> _Twin:
        """A twin that has followed the newest samples, as far back as they were kept."""
        calibration = (
            before.calibration.copy() if before else Calibration(self._leads, self._kept, self._signals)
        )
        for stretch in self._run_in:
            recent = list(self._recent)[-stretch:]
            states = entrant.states_at(recent[0].index) if recent else None
            if states is not None:
                break
        follower = Follower(
            entrant.parameters,
            self.period,
            states=states,
            free=entrant.free,
            covariance=entrant.covariance,
        )
        for sample in recent:
            follower.push(sample)
        return _Twin(entrant, follower, calibration)

    def _learn(self, departure: Snapshot, sample: int, place: int) -> None:
        """Hold the forecasts made at one sample against what came until one of their horizons."""
        ahead, ledger = self.horizons[place], self._ledger
        if ledger is None or self._spoilt(sample, sample + ahead):
            return
        past = list(self._recent)[-ahead - 1 :]
        asked, rows, signals = self._asked(past[1:]), _rows(past), self._signals
        measured = np.array([[s.output for s in past[1:]], [s.input for s in past[1:]]])[:signals]
        before = max((h for h in self.horizons if h < ahead), default=0)
        held = np.array([[past[0].output], [past[0].input]])[:signals]
        errors, paths = {PERSISTENCE: (measured - held)[:, before:]}, {}
        seldom = sample // self._stride % _SELDOM
        for name, outlook in departure.outlooks.items():
            if name not in self._twins:
                continue
            with self._sparing(name):
                if seldom and name != departure.leader:
                    off = measured - outlook.mean(asked, rows)[:signals]
                else:
                    foretold = outlook.foretold(asked, rows)
                    off = measured - np.stack([foretold.output, foretold.input])[:signals]
                    quotients = np.abs(off) / outlook.deviations(foretold)[:signals]
                    self._twins[name].calibration.learn(quotients, before)
                errors[name] = off[:, before:]
                paths[name] = float(np.sqrt(np.mean(np.square(off / ledger.noise[:, None]))))
        ledger.add(errors, place)
        if ahead == self._longest and departure.leader in paths:
            self._hindsight.add(paths[departure.leader], min(paths.values()))


def _rows(samples: Sequence[Sample]) -> FloatArray | None:
    """Their disturbances, shape (N, d), if there are any."""
    return np.array([s.disturbances for s in samples]) if samples[0].disturbances else None
