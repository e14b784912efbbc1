"""Runs a session through the twin, has all forecasters forecast at its origins, and scores the forecasts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain
from typing import Final, NamedTuple

import numpy as np

from twinmatch.comparing import BASELINES, Verdict
from twinmatch.dynamics import SKIPPED, Law, Parameters, Plant, channels
from twinmatch.forecasting import CONFIDENCE, ArxForecast, Band, Forecast, Outlook
from twinmatch.offline.backtest.scoring import (
    CONSTANT,
    LEADER,
    NEWEST,
    NOMINAL,
    PEERS,
    Backtest,
    BacktestError,
    Marked,
    best_in_hindsight,
    common,
    marks,
    samples_within,
)
from twinmatch.offline.judging import Judgement, Terms, Watch, judge
from twinmatch.offline.processes import Beside, held_interrupts
from twinmatch.sessions import Session
from twinmatch.sessions.files import part_of
from twinmatch.signals import FloatArray, Sample, Window, one_of_each
from twinmatch.twin import Outcome, Twin, TwinSettings, filled_stretches, response_on
from twinmatch.twin.matcher import one_thread


@dataclass(frozen=True, eq=False)
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

    @cached_property
    def past(self) -> Window:
        """The samples known at the origin."""
        return self.stretch.part(self.stretch.first, self.sample)

    @cached_property
    def came(self) -> Window:
        """The samples that followed, as many as forecast."""
        return self.stretch.part(self.sample + 1, self.sample + self.count)

    def alone(self, k: int) -> Origin:
        """With the k-th output and input only, and of the samples only those that followed."""
        return replace(self, stretch=self.came.alone(k))

    @property
    def ahead(self) -> FloatArray:
        """The future values that a forecast may use: the set-points, or the inputs if the loop is not known;
        shape (N,), or of several (N, r)."""
        signals = self.came.inputs if self.driven else self.came.references
        return signals[:, 0] if signals.shape[1] == 1 else signals

    @property
    def disturbances(self) -> FloatArray | None:
        """The actual disturbances from the newest sample on, shape (N + 1, d); None if there are none."""
        rows = self.stretch.part(self.sample, self.sample + self.count).disturbances
        return rows if rows.size else None


def regular(stretches_of_session: Sequence[Window], interval: float) -> list[int]:
    """The samples at regular intervals, in seconds, within each stretch."""
    samples: list[int] = []
    for stretch in stretches_of_session:
        pace = samples_within(interval, stretch.period)
        samples += range(stretch.first + pace - 1, stretch.last + 1, pace)
    return samples


def origins(
    stretches_of_session: Sequence[Window],
    samples: Iterable[int],
    horizons: Sequence[float],
    *,
    driven: bool = False,
) -> list[Origin]:
    """The origins at these samples of a session's stretches, if at least the nearest of the horizons, s, from
    near to far, can be scored."""
    wanted = sorted(set(samples))
    places = []
    for stretch in stretches_of_session:
        nearest = samples_within(horizons[0], stretch.period)
        farthest = samples_within(horizons[-1], stretch.period)
        places += [
            Origin(k, stretch, min(farthest, stretch.last - k), driven)
            for k in wanted
            if stretch.first <= k <= stretch.last - nearest
        ]
    return places


def ask(arx: ArxForecast, origin: Origin) -> dict[str, Forecast]:
    """The forecasts of the peers, by name: those that the ledger compares with, of means without bands."""
    with one_thread():
        forecasts = arx.referees(origin.ahead, origin.disturbances)
    past = origin.past
    size = origin.count
    outputs = origin.past.outputs.shape[1]
    unknown = np.full(size, np.nan)
    bands = [tuple(Band(mean, unknown, unknown) for mean in means) for means in forecasts]
    return {
        name: Forecast(
            sample=origin.sample,
            candidate=PEERS[name],
            structure="",
            confidence=CONFIDENCE,
            time=np.arange(1, size + 1, dtype=np.float64) * past.period,
            references=np.full(size, np.nan) if origin.driven else origin.ahead,
            outputs=bands_of_peer[:outputs],
            inputs=bands_of_peer[outputs:],
        )
        for name, bands_of_peer in zip(BASELINES, bands, strict=True)
    }


def mark(
    session: str,
    forecaster: str,
    forecast: Forecast,
    origin: Origin,
    *,
    horizons: Sequence[float],
    plant: type[Plant],
    candidate: str = "",
) -> list[Marked]:
    """Score a forecast at every horizon that the session reaches and whose last sample was received."""
    actual = origin.came
    counts = {horizon: samples_within(horizon, actual.period) for horizon in horizons}
    reached = [
        horizon
        for horizon, count in counts.items()
        if count <= origin.count and (actual.seen is None or actual.seen[count - 1])
    ]
    return [
        Marked(session, origin.sample, horizon, forecaster, result, candidate)
        for horizon, result in zip(reached, marks(forecast, actual, reached, plant), strict=True)
    ]


SPARSER: Final = 2.0
"""Default time between two forecasts, in times between two forecasts that the twin scores."""


@dataclass(frozen=True)
class Choices:
    """Horizons, interval and peers of a backtest.

    Raises:
        BacktestError: there is no horizon, or no such peer.
    """

    every: float | None = None
    """Time between two forecasts, s, besides those at every verdict; None: that of every second
    forecast that the twin scores."""
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

    def ahead(self, scored: tuple[float, ...], period: float) -> tuple[float, ...]:
        """The horizons from near to far, s: those chosen, or the twin's `scored` ones as far as they last a
        sample of `period` s."""
        if self.horizons is None:
            return tuple(sorted(max(horizon, period) for horizon in scored))
        for horizon in self.horizons:
            samples_within(horizon, period)
        return tuple(sorted(set(self.horizons)))


def with_constant_band(forecast: Forecast, parameters: Parameters, past: Window, law: Law | None) -> Forecast:
    """The same means with a band of one width at all horizons.

    The band contains its share of the residuals of the closed-loop twin over the whole past (measured minus
    twin, for output and input), or, without a law, of the driven twin (output only). The twin was matched on
    part of that past, so the band tends to be narrow; such bands are usually made so.
    """
    twin = response_on(parameters, past, law)
    outputs = _around(forecast.outputs, past.outputs[SKIPPED:] - twin.outputs, forecast.confidence)
    if law is None:
        return replace(forecast, outputs=outputs)
    unlimited = _around(forecast.inputs, past.inputs[SKIPPED:] - twin.inputs, forecast.confidence)
    drives = parameters.model.plant.drives.values()
    inputs = []
    for band, drive in zip(unlimited, drives, strict=True):
        low = np.clip(band.low, *drive.limits)
        high = np.clip(band.high, *drive.limits)
        inputs.append(Band(band.mean, low, high))
    return replace(forecast, outputs=outputs, inputs=tuple(inputs))


def _around(bands: Sequence[Band], residuals: FloatArray, confidence: float) -> tuple[Band, ...]:
    """The bands' means with the quantiles of the residuals around them, which hold that share."""
    tails = ((1.0 - confidence) / 2.0, (1.0 + confidence) / 2.0)
    around = []
    for band, column in zip(bands, residuals.T, strict=True):
        below, above = np.quantile(column, tails)
        around.append(Band(band.mean, band.mean + below, band.mean + above))
    return tuple(around)


class _Outlooks(NamedTuple):
    """The outlooks of all candidates at one sample, and their roles."""

    outlooks: dict[str, Outlook]
    who: dict[str, str]
    """Name of the candidate by role: leader, nominal, newest."""
    arx: ArxForecast


class _Common(NamedTuple):
    """What the forecasts of all origins of a session are graded with."""

    session: str
    settings: TwinSettings
    horizons: tuple[float, ...]
    peers: tuple[str, ...]


class _Graded(NamedTuple):
    """The forecasts made at one origin, scored."""

    marked: list[list[Marked]]
    """Of each output."""
    shown: Forecast
    """The leader's forecast."""


class Listener:
    """Records the outlooks of the twin's candidates at some samples while a session is judged, and gives the
    forecasts and their scores to a second process, if there is one."""

    def __init__(
        self,
        session: str,
        samples: Sequence[Sample],
        settings: TwinSettings,
        choices: Choices,
        work: Beside | None = None,
    ) -> None:
        scored = settings.forecasts
        period = settings.period
        self.horizons = choices.ahead(scored.horizons, period)
        self.common = _Common(session, settings, self.horizons, choices.peers)
        self.work = work or Beside()
        self._every = SPARSER * scored.every if choices.every is None else choices.every
        self._samples = samples
        self._settings = settings
        self._knows_twin = bool(settings.plant.typical)
        """Whether there is a twin by which readings are judged: a typical one, or the first nominal one."""
        self._lay_out()
        self.graded: dict[int, Callable[[], _Graded] | None] = {}
        """The results of each origin; None where there was no candidate."""
        self.twin: Twin | None = None

    def __call__(self, twin: Twin, sample: Sample, outcome: Outcome) -> None:
        """Take the outcome of one sample."""
        self.twin = twin
        if not self._knows_twin and any(verdict.chosen for verdict in outcome.verdicts):
            self._knows_twin = True
            self._lay_out(outcome.verdicts)
        if not (outcome.verdicts or sample.index in self.wanted):
            return
        for origin in origins(self.held, [sample.index], self.horizons, driven=twin.settings.law is None):
            asked = _outlooks(twin)
            task = self.work.give(_grade, self.common, origin, asked) if LEADER in asked.who else None
            self.graded[sample.index] = task

    def _lay_out(self, verdicts: Sequence[Verdict] = ()) -> None:
        """Settle the samples, with the twin by which readings are judged once these verdicts name it."""
        self.held = filled_stretches(self._samples, self._settings, verdicts)
        """The stretches between gaps that are too long to be filled."""
        self.wanted = frozenset(regular(self.held, self._every))
        """Samples at which outlooks are recorded, besides those of the verdicts."""

    def spoilt(self, first: int, last: int) -> bool:
        """Whether the monitor found a fault of the plant between two samples."""
        monitor = self.twin.discriminator.monitor if self.twin else None
        return monitor is not None and monitor.fault_between(first, last) is not None


def _outlooks(twin: Twin) -> _Outlooks:
    """The outlooks of a twin's candidates at its newest sample."""
    forecaster = twin.discriminator.forecaster
    nominal = twin.discriminator.nominal
    names = forecaster.names
    structures = twin.settings.plant.structures
    candidate_of = {
        LEADER: forecaster.leader,
        NOMINAL: nominal.name if nominal else None,
        NEWEST: next((name for name in names if name not in structures), None),
    }
    present = {role: name for role, name in candidate_of.items() if name in names}
    return _Outlooks({name: forecaster.outlook(name) for name in names}, present, forecaster.arx)


def _grade(shared: _Common, origin: Origin, asked: _Outlooks) -> _Graded:
    """Make and score the forecasts of all available forecasters at one origin."""
    session, settings, horizons, names = shared

    with one_thread():
        rows = origin.disturbances
        forecasts = {n: outlook.forecast(origin.ahead, rows) for n, outlook in asked.outlooks.items()}
    of_constant = []
    if NOMINAL in asked.who and len(origin.past) > SKIPPED + 1:
        nominal = asked.who[NOMINAL]
        with one_thread():
            parameters = asked.outlooks[nominal].parameters
            constant = with_constant_band(forecasts[nominal], parameters, origin.past, settings.law)
        of_constant.append((CONSTANT, nominal, constant))
    asked_peers = ask(asked.arx, origin)
    of_peers = [(PEERS[name], "", asked_peers[name]) for name in names]
    marked = []
    for k, plant in outputs_alone(settings.plant):
        scored = partial(scores, session, horizons, origin.alone(k), plant, k)
        of_candidates = {n: list(scored([(n, n, forecast)])) for n, forecast in forecasts.items()}
        of_roles = [
            replace(mark, who=role) for role, name in asked.who.items() for mark in of_candidates[name]
        ]
        hindsight = best_in_hindsight(chain.from_iterable(of_candidates.values()))
        marked.append([*of_roles, *scored(of_constant), *hindsight, *scored(of_peers)])
    return _Graded(marked, forecasts[asked.who[LEADER]])


def scores(  # noqa: PLR0917 (each settled in its turn by a `partial`)
    session: str,
    horizons: Sequence[float],
    origin: Origin,
    plant: type[Plant],
    k: int,
    forecasts: Iterable[tuple[str, str, Forecast]],
) -> Iterator[Marked]:
    """The scores of the k-th output in forecasts; with each, its forecaster's and its candidate's name."""
    for forecaster, candidate, forecast in forecasts:
        of_output = forecast.alone(k)
        yield from mark(
            session, forecaster, of_output, origin, horizons=horizons, plant=plant, candidate=candidate
        )


def outputs_alone(plant: type[Plant]) -> list[tuple[int, type[Plant]]]:
    """The outputs of a plant, counted from 0, as plants with this output only."""
    return list(zip(range(len(plant.outputs)), channels(plant), strict=False))


def named_after(session: str, alone: type[Plant]) -> str:
    """Name of the backtest of one of several outputs."""
    return f"{session}, {next(iter(alone.outputs))}"


def portable(plant: type[Plant]) -> bool:
    """Whether another process can run all structures of a plant: not FMUs, which answer this one."""
    return not any(structure.external for structure in plant.structures.values())


def backtest(
    session: Session,
    terms: Terms,
    choices: Choices | None = None,
    *,
    watch: Watch | None = None,
    work: Beside | None = None,
) -> Backtest:
    """Test the twin on a session with these settings; see `backtest_outputs`."""
    listener = Listener(session.name, session.samples, terms.settings, choices or Choices(), work)
    judgement = judge(session, terms, watch=part_of(watch, 0, 2), beside=listener)
    return graded(judgement, listener, watch=part_of(watch, 1, 2))


def graded(judgement: Judgement, listener: Listener, *, watch: Watch | None = None) -> Backtest:
    """The scores of all forecasts of a plant with one output; see `graded_outputs`."""
    return one_of_each("output", graded_outputs(judgement, listener, watch=watch))


def graded_outputs(
    judgement: Judgement, listener: Listener, *, watch: Watch | None = None
) -> tuple[Backtest, ...]:
    """The scores of all forecasts, output by output.

    Forecasts across a fault of the plant are left out: faults cannot be forecast.
    """
    plant = judgement.settings.plant
    period = judgement.settings.period
    results: list[tuple[_Graded, list[float]]] = []
    spoilt = unasked = 0
    total = len(listener.graded)
    with held_interrupts() as check_interrupt:
        for count, (sample, result) in enumerate(reversed(listener.graded.items())):
            unspoilt_horizons = [
                h
                for h in listener.horizons
                if not listener.spoilt(sample, sample + samples_within(h, period))
            ]
            if not unspoilt_horizons:
                spoilt += 1
            elif result is None:
                unasked += 1
            else:
                results.append((result(), unspoilt_horizons))
            if watch is not None:
                watch(count * len(judgement.samples) // total, len(judgement.samples))
            check_interrupt()
    results.reverse()
    tests = []
    for k, alone in outputs_alone(plant):
        all_marks = [
            mark
            for result, unspoilt_horizons in results
            for mark in result.marked[k]
            if mark.horizon in unspoilt_horizons
        ]
        marked = common(all_marks)
        judged = {mark.sample for mark in marked}
        pictured = one_after_another(result.shown for result, _ in results if result.shown.sample in judged)
        tests.append(
            Backtest(
                name=judgement.name if alone is plant else named_after(judgement.name, alone),
                plant=alone,
                period=period,
                horizons=listener.horizons,
                confidence=CONFIDENCE,
                marked=tuple(marked),
                came=tuple(window.alone(k) for window in listener.held),
                shown=tuple(forecast.alone(k) for forecast in pictured),
                notes=tuple(_notes(total, judged, all_marks, spoilt, unasked)),
                last=judgement.verdicts[-1] if judgement.verdicts else None,
            )
        )
    return tuple(tests)


def one_after_another(forecasts: Iterable[Forecast]) -> tuple[Forecast, ...]:
    """Select forecasts that begin where the one before ends."""
    shown: list[Forecast] = []
    for forecast in forecasts:
        if not shown or forecast.sample >= shown[-1].sample + shown[-1].time.size:
            shown.append(forecast)
    return tuple(shown)


def _notes(
    asked: int, judged: set[int], marked: Sequence[Marked], spoilt: int, unasked: int
) -> Iterable[str]:
    """Sentences on what was left out and why."""
    if unasked:
        yield f"{unasked} of {asked} forecasts could not be made: there was no candidate yet"
    if spoilt:
        yield f"{spoilt} of {asked} forecasts are left out: the plant had a fault"
    answered: dict[int, set[str]] = {}
    for mark in marked:
        answered.setdefault(mark.sample, set()).add(mark.who)
    everybody = {mark.who for mark in marked}
    short = [everybody - names for sample, names in answered.items() if sample not in judged]
    if short:
        names = ", ".join(sorted(set().union(*short) - {CONSTANT}))
        yield f"{len(short)} of {asked} forecasts are left out: some forecasters lacked samples ({names})"
