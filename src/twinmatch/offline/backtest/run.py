"""Runs a session through the twin, asks everybody at its origins, and scores all forecasts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from twinmatch.dynamics import SKIPPED, Parameters, PidGains, Plant
from twinmatch.forecasting import CONFIDENCE, Band, Forecast, ForecastError, Outlook, horizons_for
from twinmatch.offline.backtest.peer import BacktestError, Peer
from twinmatch.offline.backtest.peers import PEERS, peers
from twinmatch.offline.backtest.scoring import (
    CONSTANT,
    LEADER,
    NEWEST,
    NOMINAL,
    Backtest,
    Marked,
    best_in_hindsight,
    common,
    marks,
    samples_within,
)
from twinmatch.offline.interrupts import held_interrupts
from twinmatch.offline.judging import Judgement, Terms, Watch, judge, terms_from_files
from twinmatch.sessions import Session, open_any
from twinmatch.sessions.files import ProgressCallback, part_of
from twinmatch.signals import FloatArray, Sample, Window, unbroken
from twinmatch.twin import Outcome, Twin, response_on
from twinmatch.twin.matcher import one_thread


@dataclass(frozen=True, slots=True, eq=False)
class Origin:
    """A sample at which all forecasters make a forecast."""

    sample: int
    """Index of the newest sample that is known."""
    stretch: Window
    """The stretch without gaps that contains it."""
    count: int
    """Length of the forecast, samples: the longest horizon, or the rest of the stretch."""
    driven: bool = False
    """Whether the loop is not known, so that the actual inputs are given."""

    @property
    def past(self) -> Window:
        """The samples known at the origin."""
        return self.stretch.part(self.stretch.first, self.sample)

    @property
    def came(self) -> Window:
        """The samples that followed, as many as forecast."""
        return self.stretch.part(self.sample + 1, self.sample + self.count)

    @property
    def ahead(self) -> FloatArray:
        """The future values that a forecast may use: the set-points, or the inputs if the loop is not
        known."""
        return self.came.input if self.driven else self.came.reference

    @property
    def disturbances(self) -> FloatArray | None:
        """The actual disturbances from the newest sample on, shape (N + 1, d); None if there are none."""
        held = self.stretch.part(self.sample, self.sample + self.count).disturbances
        return held if held.size else None


def stretches(samples: Sequence[Sample], period: float) -> tuple[Window, ...]:
    """The stretches of a session without gaps, as windows."""
    return tuple(Window.from_samples(stretch, period) for stretch in unbroken(samples))


def regular(held: Sequence[Window], every: float) -> list[int]:
    """The samples at regular intervals, in seconds, within each stretch."""
    found: list[int] = []
    for stretch in held:
        pace = samples_within(every, stretch.period)
        found += range(stretch.first + pace - 1, stretch.last + 1, pace)
    return found


def origins(
    held: Sequence[Window], samples: Iterable[int], horizons: Sequence[float], *, driven: bool = False
) -> list[Origin]:
    """The origins at these samples, if at least the nearest horizon can be scored.

    Args:
        held: the session's stretches.
        samples: indices of the samples.
        horizons: horizons, s, from near to far.
        driven: whether the loop is not known.
    """
    wanted = sorted(set(samples))
    found = []
    for stretch in held:
        nearest, farthest = (samples_within(horizons[k], stretch.period) for k in (0, -1))
        found += [
            Origin(k, stretch, min(farthest, stretch.last - k), driven)
            for k in wanted
            if stretch.first <= k <= stretch.last - nearest
        ]
    return found


def ask(peer: Peer, origin: Origin) -> Forecast | None:
    """A peer's forecast; None if its past is too short."""
    rows = origin.disturbances
    try:
        with one_thread():
            return peer.forecast(origin.past, origin.ahead, None if rows is None else rows[1:])
    except ForecastError:
        return None


def mark(
    session: str,
    who: str,
    forecast: Forecast,
    origin: Origin,
    *,
    horizons: Sequence[float],
    plant: type[Plant],
    candidate: str = "",
) -> list[Marked]:
    """Score a forecast at every horizon for which all samples exist."""
    came = origin.came
    return [
        Marked(session, origin.sample, horizon, who, marks(forecast, came, horizon, plant), candidate)
        for horizon in horizons
        if samples_within(horizon, came.period) <= origin.count
    ]


_EVERY: Final = 60.0
"""Default time between two forecasts, s."""


@dataclass(frozen=True)
class Choices:
    """Horizons, interval and peers of a backtest.

    Raises:
        BacktestError: there is no horizon, or no such peer.
    """

    every: float | None = None
    """Time between two forecasts, s, besides those at every verdict; None: a minute, at least a sample."""
    horizons: tuple[float, ...] | None = None
    """Horizons, s; None: those at which the twin's forecasts are scored."""
    peers: tuple[str, ...] = tuple(PEERS)
    """Names of the peers."""

    def __post_init__(self) -> None:
        if self.horizons == ():
            raise BacktestError("backtest: there is no horizon; give at least one, in seconds")
        unknown = [name for name in self.peers if name not in PEERS]
        if unknown:
            raise BacktestError(f"backtest: no peer {unknown[0]!r}; choose from {', '.join(PEERS)}")

    def pace(self, period: float) -> float:
        """Time between two forecasts, s, for this sample time, s."""
        return max(_EVERY, period) if self.every is None else self.every

    def ahead(self, period: float) -> tuple[float, ...]:
        """The horizons from near to far, for this sample time, s."""
        if self.horizons is None:
            return horizons_for(period)
        for horizon in self.horizons:
            samples_within(horizon, period)
        return tuple(sorted(set(self.horizons)))


def with_constant_band(
    forecast: Forecast, parameters: Parameters, past: Window, gains: PidGains | None
) -> Forecast:
    """The same means with a band of one width at all horizons.

    The band contains its share of the residuals of the closed-loop twin over the whole past (measured minus
    twin, for output and input), or of the driven twin (output only). The twin was matched on part of that
    past, so the band tends to be narrow; such bands are usually made so.

    Args:
        forecast: the twin's forecast.
        parameters: parameters of that twin.
        past: all samples up to the forecast, at least four.
        gains: gains of its controller; None if the loop is not known.
    """
    twin = response_on(parameters, past, gains)
    output = _around(forecast.output.mean, past.output[SKIPPED:] - twin.output, forecast.confidence)
    if gains is None:
        return replace(forecast, output=output)
    low, high = parameters.model.plant.drive.limits
    entry = _around(forecast.input.mean, past.input[SKIPPED:] - twin.input, forecast.confidence)
    return replace(
        forecast,
        output=output,
        input=Band(entry.mean, np.clip(entry.low, low, high), np.clip(entry.high, low, high)),
    )


def _around(mean: FloatArray, residuals: FloatArray, confidence: float) -> Band:
    low, high = np.quantile(residuals, ((1.0 - confidence) / 2.0, (1.0 + confidence) / 2.0))
    return Band(mean, mean + low, mean + high)


class _Outlooks(NamedTuple):
    """The outlooks of all candidates at one sample, and their roles."""

    outlooks: dict[str, Outlook]
    who: dict[str, str]
    """Name of the candidate by role: leader, nominal, newest."""


@dataclass
class Listener:
    """Records the outlooks of the twin's candidates at some samples while a session is judged."""

    wanted: frozenset[int]
    """Samples at which outlooks are recorded, besides those of the verdicts."""
    asked: dict[int, _Outlooks] = field(default_factory=dict)
    twin: Twin | None = None

    @classmethod
    def to(cls, samples: Sequence[Sample], period: float, choices: Choices) -> Listener:
        """A listener for these samples."""
        choices.ahead(period)
        return cls(frozenset(regular(stretches(samples, period), choices.pace(period))))

    def __call__(self, twin: Twin, sample: Sample, outcome: Outcome) -> None:
        """Take the outcome of one sample."""
        self.twin = twin
        if not (outcome.verdicts or sample.index in self.wanted):
            return
        forecaster, nominal = twin.discriminator.forecaster, twin.discriminator.nominal
        names, structures = forecaster.names, twin.settings.plant.structures
        who = {
            LEADER: forecaster.leader,
            NOMINAL: nominal.name if nominal else None,
            NEWEST: next((name for name in names if name not in structures), None),
        }
        parts = {part: name for part, name in who.items() if name in names}
        self.asked[sample.index] = _Outlooks({name: forecaster.outlook(name) for name in names}, parts)

    def spoilt(self, first: int, last: int) -> bool:
        """Whether the monitor found a fault of the plant between two samples."""
        monitor = self.twin.discriminator.monitor if self.twin else None
        return monitor is not None and monitor.fault_between(first, last) is not None


def backtest_session(
    path: Path,
    choices: Choices | None = None,
    *,
    config: Path | None = None,
    candidates: Path | None = None,
    plant: str | None = None,
    watch: Watch | None = None,
    progress: ProgressCallback | None = None,
) -> Backtest:
    """Test the twin on a session, an .mcap file or a recording.

    Args:
        path: session, .mcap file or recording.
        choices: horizons, interval and peers.
        config: file of parameters; without it the defaults.
        candidates: file of initial candidates.
        plant: name or file of the plant, if the session does not name it or it is in a file.
        watch: called with the progress.
        progress: called with the amount of the file read and the total.
    """
    session = open_any(path, progress=progress, plant=plant)
    return backtest(session, terms_from_files(session, config, candidates), choices, watch=watch)


def backtest(
    session: Session, terms: Terms, choices: Choices | None = None, *, watch: Watch | None = None
) -> Backtest:
    """Test the twin on a session with these settings; see `backtest_session`."""
    choices = choices or Choices()
    listener = Listener.to(session.samples, terms.settings.period, choices)
    judgement = judge(session, terms, watch=part_of(watch, 0, 2), beside=listener)
    return graded(judgement, listener, choices, watch=part_of(watch, 1, 2))


def graded(
    judgement: Judgement, listener: Listener, choices: Choices, *, watch: Watch | None = None
) -> Backtest:
    """Score the recorded outlooks and the peers' forecasts.

    Forecasts across a fault of the plant are left out: faults cannot be forecast.
    """
    plant, period, driven = (
        judgement.settings.plant,
        judgement.settings.period,
        judgement.settings.gains is None,
    )
    held = stretches(judgement.samples, period)
    horizons = choices.ahead(period)
    found = origins(held, listener.asked, horizons, driven=driven)
    others, absent = peers(plant, choices.peers, driven=driven)
    grading = _Grading(judgement, listener, horizons)
    with held_interrupts() as check_interrupt:
        for done, origin in enumerate(found):
            grading.at(origin, others)
            if watch is not None:
                watch(done * len(judgement.samples) // len(found), len(judgement.samples))
            check_interrupt()
    marked = common(grading.marked)
    judged = {one.sample for one in marked}
    return Backtest(
        name=judgement.name,
        plant=plant,
        period=period,
        horizons=horizons,
        confidence=CONFIDENCE,
        marked=tuple(marked),
        came=held,
        shown=_one_after_another(f for f in grading.shown if f.sample in judged),
        absent=tuple(absent),
        notes=tuple(_notes(len(found), judged, grading)),
    )


class _Grading:
    """The marks of one session, gathered origin by origin."""

    def __init__(self, judgement: Judgement, listener: Listener, horizons: tuple[float, ...]) -> None:
        self._judgement, self._listener, self._horizons = judgement, listener, horizons
        self.marked: list[Marked] = []
        self.shown: list[Forecast] = []
        self.spoilt = 0
        """Number of origins with a fault within the nearest horizon."""
        self.unasked = 0
        """Number of origins without a candidate."""

    def at(self, origin: Origin, others: Sequence[Peer]) -> None:
        """Make and score the forecasts of all available forecasters."""
        horizons = [h for h in self._horizons if not self._meets_fault(origin, h)]
        if not horizons:
            self.spoilt += 1
            return
        asked = self._listener.asked[origin.sample]
        if LEADER not in asked.who:
            self.unasked += 1
            return

        def add(who: str, forecast: Forecast, candidate: str = "") -> list[Marked]:
            plant = self._judgement.settings.plant
            name = self._judgement.name
            return mark(name, who, forecast, origin, horizons=horizons, plant=plant, candidate=candidate)

        with one_thread():
            rows = origin.disturbances
            forecasts = {n: outlook.forecast(origin.ahead, rows) for n, outlook in asked.outlooks.items()}
            for part, name in asked.who.items():
                self.marked += add(part, forecasts[name], name)
            if NOMINAL in asked.who and len(origin.past) > SKIPPED + 1:
                self.marked += add(
                    CONSTANT, self._constant(asked, forecasts, origin.past), asked.who[NOMINAL]
                )
        self.marked += best_in_hindsight(
            m for name, forecast in forecasts.items() for m in add(name, forecast, name)
        )
        self.shown.append(forecasts[asked.who[LEADER]])
        for peer in others:
            forecast = ask(peer, origin)
            if forecast is not None:
                self.marked += add(peer.name, forecast)

    def _meets_fault(self, origin: Origin, horizon: float) -> bool:
        count = samples_within(horizon, self._judgement.settings.period)
        return self._listener.spoilt(origin.sample, origin.sample + count)

    def _constant(self, asked: _Outlooks, forecasts: dict[str, Forecast], past: Window) -> Forecast:
        name = asked.who[NOMINAL]
        gains = self._judgement.settings.gains
        return with_constant_band(forecasts[name], asked.outlooks[name].parameters, past, gains)


def _one_after_another(forecasts: Iterable[Forecast]) -> tuple[Forecast, ...]:
    """Select forecasts that begin where the one before ends."""
    found: list[Forecast] = []
    for forecast in forecasts:
        if not found or forecast.sample >= found[-1].sample + found[-1].time.size:
            found.append(forecast)
    return tuple(found)


def _notes(asked: int, judged: set[int], grading: _Grading) -> Iterable[str]:
    """Sentences on what was left out and why."""
    if grading.unasked:
        yield f"{grading.unasked} of {asked} forecasts could not be made: there was no candidate yet"
    if grading.spoilt:
        yield f"{grading.spoilt} of {asked} forecasts are left out: the plant had a fault"
    answered: dict[int, set[str]] = {}
    for one in grading.marked:
        answered.setdefault(one.sample, set()).add(one.who)
    everybody = {one.who for one in grading.marked}
    short = [everybody - names for sample, names in answered.items() if sample not in judged]
    if short:
        names = ", ".join(sorted(set().union(*short) - {CONSTANT}))
        yield f"{len(short)} of {asked} forecasts are left out: some forecasters lacked samples ({names})"
