"""Every candidate foretells; what came is held against it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np

from twinmatch.discrimination import ForecastScore
from twinmatch.dynamics import Parameters, Pid, PidGains
from twinmatch.forecasting import (
    HORIZONS,
    PERSISTENCE,
    Calibration,
    Follower,
    ForecastError,
    Ledger,
    Outlook,
    leads_of,
)
from twinmatch.signals import FloatArray, Sample
from twinmatch.twin.promises import Promise, promise_of
from twinmatch.twin.snapshot import Snapshot, candidate_called

__all__ = ["Entrant", "ForecastSettings", "Forecaster"]

_NEAR: Final = 1.03
"""A leader whose error is no larger than this times the least in hindsight counts as right."""
_RUN_IN_S: Final = 300.0
"""Newest stretch on which a new candidate's hidden states are found, s."""


@dataclass(frozen=True)
class ForecastSettings:
    """How far and how often the candidates are held to their forecasts.

    Raises:
        ForecastError: a value is not positive.
    """

    horizons: tuple[float, ...] = HORIZONS
    """s"""
    every: float = 30.0
    """s between two samples from which all candidates foretell."""
    memory: float = 1800.0
    """s after which a forecast counts for a share of 1/e."""

    def __post_init__(self) -> None:
        for name, value in (("horizons", min(self.horizons)), ("every", self.every), ("memory", self.memory)):
            if not value > 0:
                raise ForecastError(f"forecasts: {name} is {value} s; it must be positive")


class Entrant(NamedTuple):
    """A candidate as the forecaster takes it."""

    name: str
    parameters: Parameters
    samples: tuple[int, int]
    """First and last sample it was fitted to."""
    free: tuple[str, ...] = ()
    covariance: FloatArray | None = None
    """Of the free parameters."""
    states_at: Callable[[int], FloatArray | None] = lambda _: None
    """Its states at a sample, where they are known."""


@dataclass
class _Departure:
    """What was known at one sample from which all foretold."""

    sample: int
    snapshot: Snapshot


@dataclass
class _Trust:
    """How often the leader was right, discounted."""

    hits: float = 0.5
    misses: float = 0.5
    kept: float = 1.0

    def add(self, hit: bool) -> None:
        self.hits = self.kept * self.hits + hit
        self.misses = self.kept * self.misses + (not hit)

    @property
    def share(self) -> float:
        return self.hits / (self.hits + self.misses)


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
    came meanwhile, and ledger and bands learn from the errors. All depends on samples and entrants alone.
    """

    def __init__(
        self,
        gains: PidGains,
        settings: ForecastSettings | None = None,
        spoilt: Callable[[int, int], bool] = lambda _first, _last: False,
    ) -> None:
        """Begin without candidates.

        Args:
            gains: of the running controller.
            settings: horizons and pace.
            spoilt: whether something is known to have been wrong with the plant between two samples; nothing
                is learned from such a stretch.
        """
        self.settings = settings or ForecastSettings()
        self._gains, self._spoilt = gains, spoilt
        period = gains.period
        self.horizons = tuple(max(round(h / period), 1) for h in self.settings.horizons)
        self._longest = max(self.horizons)
        self._stride = max(round(self.settings.every / period), 1)
        self._kept = float(np.exp(-self.settings.every / self.settings.memory))
        self._leads = leads_of(period, self._longest)
        self._twins: dict[str, _Twin] = {}
        self._order: tuple[str, ...] = ()
        self._ledger: Ledger | None = None
        self._trust = _Trust(kept=self._kept)
        self._departures: deque[_Departure] = deque()
        run_in = round(_RUN_IN_S / period)
        self._recent: deque[Sample] = deque(maxlen=max(self._longest, run_in) + 1)
        self._run_in = run_in
        self._visited = (np.inf, -np.inf)
        self._pid = Pid(gains)
        self.notes: tuple[str, ...] = ()
        """What forecasts cannot promise now, for those who ask."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the candidates, in the order in which ties are decided."""
        return self._order

    @property
    def leader(self) -> str | None:
        """Whose forecasts have saved most; None without candidates."""
        if not self._order:
            return None
        return self._order[int(np.argmax([-np.inf if np.isnan(s.gain) else s.gain for s in self.scores]))]

    @property
    def confidence(self) -> float:
        """How probable it is that the leader is within 3 % of the best in hindsight, as it was before."""
        return self._trust.share

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

    def push(self, sample: Sample) -> None:
        """Take one sample: follow with every twin, and learn from forecasts whose time has come."""
        if self._recent and sample.index != self._recent[-1].index + 1:
            self._break()
        self._recent.append(sample)
        self._visited = min(self._visited[0], sample.output), max(self._visited[1], sample.output)
        self._pid.follow(sample.reference, sample.output, sample.input)
        for twin in self._twins.values():
            twin.follower.push(sample)
        if self._twins and sample.index % self._stride == 0:
            self._departures.append(_Departure(sample.index, self.snapshot()))
        for departure in self._departures:
            self._learn(departure)
        while self._departures and self._departures[0].sample + self._longest <= sample.index:
            self._departures.popleft()

    def enter(self, entrants: Sequence[Entrant], successors: Mapping[str, str] | None = None) -> None:
        """Set who the candidates are; those that are there with the same parameters just go on.

        Args:
            entrants: all candidates; of two that have saved as much, the one named first leads.
            successors: by the name of a new candidate, whose account it goes on with.
        """
        if self._ledger is None and entrants:
            plant = entrants[0].parameters.model.plant
            noise = np.array([plant.output.noise, plant.drive.noise])
            self._ledger = Ledger(len(self.horizons), noise, self._kept)
        twins = {}
        for entrant in entrants:
            held = self._twins.get(entrant.name)
            if held is None or held.entrant.parameters != entrant.parameters:
                held = self._begun(entrant, held or self._twins.get((successors or {}).get(entrant.name, "")))
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
        return Snapshot(self.leader, {name: self.outlook(name) for name in self._order})

    def outlook(self, name: str | None = None) -> Outlook:
        """What a candidate, or the leader, knows at the newest sample.

        Raises:
            ForecastError: there is no candidate yet, or none of that name.
        """
        name = candidate_called(self.leader if name is None else name, self._twins if self._recent else {})
        twin = self._twins[name]
        return Outlook(
            sample=self._recent[-1],
            candidate=name,
            parameters=twin.entrant.parameters,
            states=twin.follower.states,
            covariance=twin.follower.joint,
            unsure=twin.follower.free,
            controller=self._pid.state,
            gains=self._gains,
            leads=self._leads,
            widths=twin.calibration.widths,
            visited=self._visited,
            notes=self.notes,
        )

    def promise(self, samples: int) -> Promise | None:
        """How the newest readings lie in the bands that were given before them; None where none was.

        The forecast is that of the leader of its time, from the newest sample before these from which all
        foretold, under the set-points that came.
        """
        if not self._recent:
            return None
        newest = self._recent[-1].index
        made = [d for d in self._departures if d.sample <= newest - samples and d.snapshot.leader is not None]
        if not made:
            return None
        departure = made[-1]
        came = list(self._recent)[departure.sample - newest :]
        forecast = departure.snapshot.outlook().forecast(np.array([s.reference for s in came]))
        newest_of = came[-samples:]
        return promise_of(
            forecast, np.array([s.output for s in newest_of]), np.array([s.input for s in newest_of])
        )

    def _break(self) -> None:
        """The next sample does not follow: start again from readings; what was learned stays."""
        self._recent.clear()
        self._departures.clear()
        self._pid = Pid(self._gains)
        for twin in self._twins.values():
            twin.follower.restart()

    def _begun(self, entrant: Entrant, before: _Twin | None) -> _Twin:
        """A twin that has followed the newest samples, as far back as they were kept."""
        calibration = before.calibration if before else Calibration(self._leads, self._kept)
        recent = list(self._recent)[-self._run_in :]
        states = entrant.states_at(recent[0].index) if recent else None
        follower = Follower(
            entrant.parameters,
            self._gains.period,
            states=states,
            free=entrant.free,
            covariance=entrant.covariance,
        )
        for sample in recent:
            follower.push(sample)
        return _Twin(entrant, follower, calibration)

    def _learn(self, departure: _Departure) -> None:
        """Hold the forecasts of one sample against what came, if one of their horizons is just over."""
        ahead = self._recent[-1].index - departure.sample
        if ahead not in self.horizons or self._ledger is None:
            return
        if self._spoilt(departure.sample, departure.sample + ahead):
            return
        place = self.horizons.index(ahead)
        past = list(self._recent)[-ahead - 1 :]
        came, reference = past[1:], np.array([s.reference for s in past[1:]])
        rows = np.array([s.disturbances for s in past]) if past[0].disturbances else None
        measured = np.array([[s.output for s in came], [s.input for s in came]])
        before = max((h for h in self.horizons if h < ahead), default=0)
        leads = [i for i, lead in enumerate(self._leads) if before < lead <= ahead]
        errors = {PERSISTENCE: (measured - [[past[0].output], [past[0].input]])[:, before:]}
        paths = {}
        for name, outlook in departure.snapshot.outlooks.items():
            if name not in self._twins:
                continue
            foretold = outlook.foretold(reference, rows)
            off = measured - np.stack([foretold.output, foretold.input])
            errors[name] = off[:, before:]
            paths[name] = float(np.sqrt(np.mean(np.square(off / self._ledger.noise[:, None]))))
            quotients = np.abs(off) / outlook.deviations(foretold)
            for lead in leads:
                self._twins[name].calibration.add(lead, quotients[:, self._leads[lead] - 1])
        self._ledger.add(errors, place)
        leader = departure.snapshot.leader
        if ahead == self._longest and leader in paths:
            self._trust.add(paths[leader] <= _NEAR * min(paths.values()))
