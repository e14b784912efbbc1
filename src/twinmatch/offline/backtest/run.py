"""Runs a session through the twin, has all forecasters forecast at its origins, and scores the forecasts."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from twinmatch.dynamics import SKIPPED, Law, Parameters, Plant, channels
from twinmatch.forecasting import CONFIDENCE, ArxForecast, Band, Forecast, Outlook
from twinmatch.importing import open_any
from twinmatch.offline.backtest.origins import (
    PAST,
    NamedForecast,
    Origin,
    SettledStretch,
    ask,
    origins,
    scores,
)
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
    samples_within,
)
from twinmatch.offline.judging import Judgement, Terms, Watch, judge, terms_from_files
from twinmatch.offline.processes import Beside, beside, held_interrupts
from twinmatch.sessions import Session
from twinmatch.sessions.files import ProgressCallback, part_of
from twinmatch.signals import FloatArray, Sample, Window, one_of_each
from twinmatch.twin import Outcome, Twin, TwinSettings, response_on
from twinmatch.twin.matcher import one_thread

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
            raise BacktestError(
                "backtest: there is no horizon; give at least one, in seconds"
            )
        unknown = [name for name in self.peers if name not in PEERS]
        if unknown:
            raise BacktestError(
                f"backtest: no peer {unknown[0]!r}; choose from {', '.join(PEERS)}"
            )

    def ahead(self, scored: tuple[float, ...], period: float) -> tuple[float, ...]:
        """The horizons from near to far, s: those chosen, or the twin's `scored` ones as far as they last a
        sample of `period` s."""
        if self.horizons is None:
            return tuple(sorted(max(horizon, period) for horizon in scored))
        for horizon in self.horizons:
            samples_within(horizon, period)
        return tuple(sorted(set(self.horizons)))


def with_constant_band(
    forecast: Forecast, parameters: Parameters, past: Window, law: Law | None
) -> Forecast:
    """The same means with a band of one width at all horizons.

    The band contains its share of the residuals of the closed-loop twin over the past (measured minus twin, for
    output and input), or, without a law, of the driven twin (output only). The twin was matched on part of that
    past, so the band tends to be narrow; such bands are usually made so.
    """
    twin = response_on(parameters, past, law)
    outputs = _around(
        forecast.outputs, past.outputs[SKIPPED:] - twin.outputs, forecast.confidence
    )
    if law is None:
        return replace(forecast, outputs=outputs)
    unlimited = _around(
        forecast.inputs, past.inputs[SKIPPED:] - twin.inputs, forecast.confidence
    )
    drives = parameters.model.plant.drives.values()
    inputs = []
    for band, drive in zip(unlimited, drives, strict=True):
        low = np.clip(band.low, *drive.limits)
        high = np.clip(band.high, *drive.limits)
        inputs.append(Band(band.mean, low, high))
    return replace(forecast, outputs=outputs, inputs=tuple(inputs))


def _around(
    bands: Sequence[Band], residuals: FloatArray, confidence: float
) -> tuple[Band, ...]:
    """The bands' means with the quantiles of the residuals around them, which hold that share."""
    tails = ((1.0 - confidence) / 2.0, (1.0 + confidence) / 2.0)
    around = []
    all_below, all_above = np.quantile(residuals, tails, axis=0)
    for band, below, above in zip(bands, all_below, all_above, strict=True):
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
        settings: TwinSettings,
        choices: Choices,
        work: Beside | None = None,
    ) -> None:
        scored = settings.forecasts
        period = settings.period
        self.horizons = choices.ahead(scored.horizons, period)
        self.common = _Common(session, settings, self.horizons, choices.peers)
        self.work = work or Beside()
        self._pace = samples_within(
            SPARSER * scored.every if choices.every is None else choices.every, period
        )
        """Samples between two forecasts, besides those at every verdict."""
        self._farthest = samples_within(self.horizons[-1], period)
        """Samples within the farthest horizon."""
        self._stretch = self._new_stretch()
        self._waiting: deque[tuple[int, _Outlooks]] = deque()
        """Outlooks, and the samples that they are from, until the samples have come that are forecast."""
        self.graded: dict[int, Callable[[], _Graded] | None] = {}
        """The results of each origin; None where there was no candidate."""
        self.twin: Twin | None = None

    def __call__(self, twin: Twin, sample: Sample, outcome: Outcome) -> None:
        """Take the outcome of one sample."""
        self.twin = twin
        for settled in outcome.settled:
            if settled.usable:
                self._take(settled)
        is_wanted = bool(outcome.verdicts) or self._stretch.is_regular(self._pace)
        if is_wanted and self._stretch.last == sample.index:
            self._waiting.append((sample.index, _outlooks(twin)))

    def _new_stretch(self) -> SettledStretch:
        """A stretch without samples, which keeps what the forecasts that wait need."""
        return SettledStretch(self.common.settings.period, PAST + self._farthest)

    def finish(self) -> None:
        """Give the last forecasts to be graded, by as many samples as have come."""
        while self._waiting:
            self._grade_oldest()

    def _take(self, settled: Sample) -> None:
        """Take a usable sample; forecasts that end here, or with the stretch before, are graded."""
        if not self._stretch.continued_by(settled):
            self.finish()
            self._stretch = self._new_stretch()
        self._stretch.push(settled)
        while self._waiting and self._waiting[0][0] + self._farthest <= settled.index:
            self._grade_oldest()

    def _grade_oldest(self) -> None:
        """Have the oldest forecasts that wait graded, if the nearest horizon has been reached."""
        sample, asked = self._waiting.popleft()
        driven = self.common.settings.law is None
        for origin in origins(
            [self._stretch.window()], [sample], self.horizons, driven=driven
        ):
            task = (
                self.work.give(_grade, self.common, origin, asked)
                if LEADER in asked.who
                else None
            )
            self.graded[sample] = task

    def spoilt(self, first: int, last: int) -> bool:
        """Whether the twin itself does not count forecasts between two samples."""
        return self.twin is not None and self.twin.discriminator.spoilt(first, last)


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
    return _Outlooks(
        {name: forecaster.outlook(name) for name in names}, present, forecaster.arx
    )


def _grade(shared: _Common, origin: Origin, asked: _Outlooks) -> _Graded:
    """Make and score the forecasts of all available forecasters at one origin."""
    plant = shared.settings.plant
    with one_thread():
        forecasts = _forecasts(origin, asked)
        of_constant = _with_constant_bands(shared, origin, asked, forecasts)
        asked_peers = ask(asked.arx, origin)
    of_candidates = [NamedForecast(n, n, forecast) for n, forecast in forecasts.items()]
    of_peers = [
        NamedForecast(PEERS[name], "", asked_peers[name]) for name in shared.peers
    ]
    marked = []
    for k, alone in outputs_alone(plant):
        of_all = scores(
            shared.session,
            shared.horizons,
            origin.alone(k),
            alone,
            k,
            [*of_candidates, *of_constant, *of_peers],
        )
        by_candidate = dict(zip(forecasts, of_all, strict=False))
        of_others = of_all[len(forecasts) :]
        of_roles = [
            replace(mark, who=role)
            for role, name in asked.who.items()
            for mark in by_candidate[name]
        ]
        hindsight = best_in_hindsight(chain.from_iterable(by_candidate.values()))
        constant = of_others[: len(of_constant)]
        peers = of_others[len(of_constant) :]
        marked.append([*of_roles, *chain.from_iterable([*constant, hindsight, *peers])])
    return _Graded(marked, forecasts[asked.who[LEADER]])


def _forecasts(origin: Origin, asked: _Outlooks) -> dict[str, Forecast]:
    """The forecast of each candidate."""
    rows = origin.disturbances
    return {
        name: outlook.forecast(origin.ahead, rows)
        for name, outlook in asked.outlooks.items()
    }


def _with_constant_bands(
    shared: _Common,
    origin: Origin,
    asked: _Outlooks,
    forecasts: Mapping[str, Forecast],
) -> list[NamedForecast]:
    """The nominal candidate's forecast with bands of one width, if there are residuals to make them of."""
    nominal = asked.who.get(NOMINAL)
    if nominal is None or len(origin.past) <= SKIPPED + 1:
        return []
    parameters = asked.outlooks[nominal].parameters
    constant = with_constant_band(
        forecasts[nominal], parameters, origin.past, shared.settings.law
    )
    return [NamedForecast(CONSTANT, nominal, constant)]


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
) -> tuple[Backtest, ...]:
    """Test the twin on a session with these settings: one backtest for each output of the plant."""
    listener = Listener(session.name, terms.settings, choices or Choices(), work)
    judgement = judge(session, terms, watch=part_of(watch, 0, 2), beside=listener)
    return graded_outputs(judgement, listener, watch=part_of(watch, 1, 2))


def backtest_outputs(
    path: Path,
    choices: Choices | None = None,
    *,
    config: Path | None = None,
    candidates: Path | None = None,
    plant: str | None = None,
    watch: Watch | None = None,
    progress: ProgressCallback | None = None,
    second: bool = False,
) -> tuple[Backtest, ...]:
    """Test the twin on a session, an .mcap file or a recording: one backtest for each output of the plant.

    Args:
        path: session, .mcap file or recording.
        choices: horizons, interval and peers.
        config, candidates: files of parameters and initial candidates; without them the defaults and none.
        plant: name or file of the plant, if the session does not name it or it is in a file.
        watch, progress: called with the progress of judging and of reading.
        second: whether a second process may forecast meanwhile; it is a fork of this one.
    """
    with beside(possible=second) as work:
        session = open_any(path, progress=progress, plant=plant)
        terms = terms_from_files(session, config, candidates)
        portable_work = work if portable(terms.settings.plant) else None
        tests = backtest(session, terms, choices, watch=watch, work=portable_work)
        return tuple(
            replace(test, notes=(*session.missing, *test.notes)) for test in tests
        )


def backtest_session(
    path: Path, choices: Choices | None = None, **options: Any
) -> Backtest:
    """Test the twin of a plant with one output on a session; arguments as of `backtest_outputs`.

    Raises:
        SignalError: the plant has several outputs.
    """
    return one_of_each("output", backtest_outputs(path, choices, **options))


def graded(
    judgement: Judgement, listener: Listener, *, watch: Watch | None = None
) -> Backtest:
    """The scores of all forecasts of a plant with one output; see `graded_outputs`."""
    return one_of_each("output", graded_outputs(judgement, listener, watch=watch))


def graded_outputs(
    judgement: Judgement, listener: Listener, *, watch: Watch | None = None
) -> tuple[Backtest, ...]:
    """The scores of all forecasts, output by output.

    Forecasts across a fault of the plant are left out, since faults cannot be forecast, and so are those of
    readings that lie: the twin itself counts neither.
    """
    listener.finish()
    period = judgement.settings.period
    origins = _GradedOrigins()
    total = len(listener.graded)
    with held_interrupts() as check_interrupt:
        for count, (sample, result) in enumerate(reversed(listener.graded.items())):
            unspoilt_horizons = [
                h
                for h in listener.horizons
                if not listener.spoilt(sample, sample + samples_within(h, period))
            ]
            if not unspoilt_horizons:
                origins.spoilt += 1
            elif result is None:
                origins.unasked += 1
            else:
                origins.results.append((result(), unspoilt_horizons))
            if watch is not None:
                watch(count * len(judgement.samples) // total, len(judgement.samples))
            check_interrupt()
    origins.results.reverse()
    return tuple(
        _backtest_of(judgement, listener, origins, k, alone)
        for k, alone in outputs_alone(judgement.settings.plant)
    )


@dataclass
class _GradedOrigins:
    """The samples from which forecasts were made, and what became of these."""

    results: list[tuple[_Graded, list[float]]] = field(default_factory=list)
    """What was scored, in order of time, each with the horizons that no fault touches."""
    spoilt: int = 0
    """Number of those of which a fault touches every horizon."""
    unasked: int = 0
    """Number of those at which no candidate was there."""


def _backtest_of(
    judgement: Judgement,
    listener: Listener,
    origins: _GradedOrigins,
    k: int,
    alone: type[Plant],
) -> Backtest:
    """The scores of output number k; `alone` is the plant with this output only."""
    all_marks: list[Marked] = []
    for graded_origin, unspoilt_horizons in origins.results:
        all_marks += [
            mark
            for mark in graded_origin.marked[k]
            if mark.horizon in unspoilt_horizons
        ]
    marked = common(all_marks)
    judged = {mark.sample for mark in marked}
    pictured = one_after_another(
        result.shown for result, _ in origins.results if result.shown.sample in judged
    )
    is_only_output = alone is judgement.settings.plant
    return Backtest(
        name=judgement.name if is_only_output else named_after(judgement.name, alone),
        plant=alone,
        period=judgement.settings.period,
        horizons=listener.horizons,
        confidence=CONFIDENCE,
        marked=tuple(marked),
        came=tuple(window.alone(k) for window in judgement.stretches),
        shown=tuple(forecast.alone(k) for forecast in pictured),
        notes=tuple(
            _notes(
                len(listener.graded),
                judged,
                all_marks,
                spoilt=origins.spoilt,
                unasked=origins.unasked,
            )
        ),
        last=judgement.verdicts[-1] if judgement.verdicts else None,
        summary=judgement.summary,
    )


def one_after_another(forecasts: Iterable[Forecast]) -> tuple[Forecast, ...]:
    """Select forecasts that begin where the one before ends."""
    shown: list[Forecast] = []
    for forecast in forecasts:
        if not shown or forecast.sample >= shown[-1].sample + shown[-1].time.size:
            shown.append(forecast)
    return tuple(shown)


def _notes(
    asked: int,
    judged: set[int],
    marked: Sequence[Marked],
    *,
    spoilt: int,
    unasked: int,
) -> Iterable[str]:
    """Sentences on what was left out and why."""
    if unasked:
        yield f"{unasked} of {asked} forecasts could not be made: there was no candidate yet"
    if spoilt:
        yield (
            f"{spoilt} of {asked} forecasts are left out: the plant had a fault, a sensor lied, or a law was "
            "on trial"
        )
    answered: dict[int, set[str]] = {}
    for mark in marked:
        answered.setdefault(mark.sample, set()).add(mark.who)
    everybody = {mark.who for mark in marked}
    short = [
        everybody - names for sample, names in answered.items() if sample not in judged
    ]
    if short:
        names = ", ".join(sorted(set().union(*short) - {CONSTANT}))
        yield f"{len(short)} of {asked} forecasts are left out: some forecasters lacked samples ({names})"
