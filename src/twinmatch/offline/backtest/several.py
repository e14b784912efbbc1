"""Backtests of plants with several inputs and outputs, output by output.

Verdicts run one loop, so there is no family to ask. Every structure that the plant file lets run beside the
plant is fitted to the first part of the session, and so is the ARX model; all forecast the rest, driven by
the recorded inputs. The twins are followed by the forecaster that a verdict uses, so their bands continue
learning.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from twinmatch.comparing import Candidate
from twinmatch.dynamics import Plant, PlantError
from twinmatch.dynamics.pace import plant_scale
from twinmatch.fitting import fit_session
from twinmatch.forecasting import ArxForecast, Forecast
from twinmatch.importing import open_any
from twinmatch.offline.backtest.run import (
    SPARSER,
    Choices,
    Origin,
    ask,
    backtest,
    named_after,
    one_after_another,
    origins,
    outputs_alone,
    portable,
    regular,
    scores,
)
from twinmatch.offline.backtest.scoring import (
    LEADER,
    PEERS,
    Backtest,
    BacktestError,
    Marked,
    best_in_hindsight,
    common,
)
from twinmatch.offline.judging import Watch, terms_from_files
from twinmatch.offline.processes import beside
from twinmatch.plants import Peltier, plant_named
from twinmatch.sessions import Session
from twinmatch.sessions.files import ProgressCallback, part_of
from twinmatch.signals import Window, stretches
from twinmatch.twin import Forecaster, ForecastSettings
from twinmatch.twin.matcher import one_thread

FITTED: Final = 0.6
"""Share of a session to which the structures are fitted; the rest is forecast."""


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

    Raises:
        BacktestError: parameters or candidates are given for a plant with several loops, or too little is
            left to forecast.
    """
    with beside(possible=second) as work:
        session = open_any(path, progress=progress, plant=plant)
        choices = choices or Choices()
        kind = plant_named(session.plant) if session.plant else Peltier
        if len(kind.outputs) == 1 and len(kind.drives) == 1:
            terms = terms_from_files(session, config, candidates)
            portable_work = work if portable(terms.settings.plant) else None
            test = backtest(session, terms, choices, watch=watch, work=portable_work)
            return (replace(test, notes=(*session.missing, *test.notes)),)
        if config or candidates:
            raise BacktestError(
                f"backtest: {kind.title} has several loops, and its twin is fitted to the session itself; "
                "leave out --config and --candidates"
            )
        from twinmatch.offline.channels import channel_health  # noqa: PLC0415 — plants with one loop need none

        tests = tuple(
            replace(test, notes=(*session.missing, *test.notes))
            for test in backtest_each(session, kind, choices, watch=part_of(watch, 0, 2))
        )
        try:
            health = channel_health(session, kind, watch=part_of(watch, 1, 2))
        except PlantError as error:
            note = f"the health of the channels is not judged: {error}"
            return tuple(replace(test, notes=(*test.notes, note)) for test in tests)
        return tuple(replace(test, health=health) for test in tests)


def backtest_session(path: Path, choices: Choices | None = None, **options: Any) -> Backtest:
    """Test the twin of a plant with one output on a session; arguments as of `backtest_outputs`.

    Raises:
        BacktestError: the plant has several outputs.
    """
    tests = backtest_outputs(path, choices, **options)
    if len(tests) > 1:
        raise BacktestError(f"backtest: {path} has {len(tests)} outputs; call backtest_outputs")
    return tests[0]


def backtest_each(
    session: Session,
    plant: type[Plant],
    choices: Choices,
    *,
    watch: Watch | None = None,
) -> tuple[Backtest, ...]:
    """The backtests of all outputs of a plant on a session; see `backtest_outputs`."""
    period = session.period
    without_gaps = stretches(session.samples, session.period)
    settings = ForecastSettings.of(plant_scale(plant, period), period)
    horizons = choices.ahead(settings.horizons, period)
    split = session.samples[int(FITTED * len(session.samples))].index
    interval = SPARSER * settings.every if choices.every is None else choices.every
    wanted = [k for k in regular(without_gaps, interval) if k >= split]
    places = {origin.sample: origin for origin in origins(without_gaps, wanted, horizons, driven=True)}
    if not places:
        raise BacktestError(
            f"backtest: the last {100 * (1 - FITTED):.0f} % of {session.name} are shorter than "
            f"{horizons[0]:g} s; record longer, or choose a shorter --horizon"
        )
    forecaster = Forecaster(None, settings, period=period)
    forecaster.enter(
        _fitted(plant, [_before(window, split) for window in without_gaps if window.first < split])
    )
    marked: list[list[Marked]] = [[] for _ in plant.outputs]
    shown: list[Forecast] = []
    arx = None
    for count, sample in enumerate(session.samples):
        forecaster.push(sample)
        if sample.index in places:
            origin = places[sample.index]
            arx = arx or forecaster.arx
            forecasts = _forecasts(forecaster, arx, origin, choices.peers)
            for k, alone in outputs_alone(plant):
                marked[k] += _marked(
                    partial(scores, session.name, horizons, origin.alone(k), alone, k), forecasts
                )
            shown.append(forecasts[LEADER])
            if watch is not None:
                watch(count, len(session.samples))
    fitted = f"fitted to the samples before {split}; forecasts are of those after, under the recorded inputs"
    return tuple(
        Backtest(
            name=named_after(session.name, alone),
            plant=alone,
            period=period,
            horizons=horizons,
            confidence=shown[0].confidence,
            marked=tuple(common(marked[k])),
            came=tuple(window.alone(k) for window in without_gaps),
            shown=tuple(forecast.alone(k) for forecast in one_after_another(shown)),
            notes=(fitted,),
        )
        for k, alone in outputs_alone(plant)
    )


def _before(window: Window, split: int) -> Window:
    """The part of a window before the sample `split`."""
    return window.part(window.first, min(window.last, split - 1))


def _fitted(plant: type[Plant], past: list[Window]) -> list[Candidate]:
    """A candidate for each watched structure."""
    candidates = []
    for name, structure in plant.structures.items():
        if structure.watched and structure.external is None:
            fit = fit_session(plant.model(name), past)
            point = float(past[-1].outputs[-1, 0])
            candidates.append(
                Candidate(name, point, fit.parameters, past[-1], structure.free, fit.covariance)
            )
    return candidates


def _forecasts(
    forecaster: Forecaster, arx: ArxForecast, origin: Origin, peers: tuple[str, ...]
) -> dict[str, Forecast]:
    """Forecasts of all structures, of the leader under that name, and of the peers.

    `arx` is the model at the first origin: its coefficients stay, its past becomes that of this origin.
    """
    past = origin.past
    newest_first = np.hstack([past.outputs, past.inputs, past.disturbances])[: -len(arx.past) - 1 : -1]
    asked = ask(arx._replace(past=np.ascontiguousarray(newest_first)), origin)
    with one_thread():
        of_structures = {
            name: forecaster.outlook(name).forecast(origin.ahead, origin.disturbances)
            for name in forecaster.names
        }
    leader = of_structures[forecaster.leader or forecaster.names[0]]
    return {LEADER: leader, **of_structures, **{PEERS[name]: asked[name] for name in peers}}


def _marked(scored: Callable[..., Iterator[Marked]], forecasts: dict[str, Forecast]) -> list[Marked]:
    """The marks of one output's forecasts, and those of the best of the structures."""
    of_structures = []
    of_others = []
    for forecaster, forecast in forecasts.items():
        if forecast.structure and forecaster != LEADER:
            of_structures.append((forecaster, "", forecast))
        else:
            of_others.append((forecaster, "", forecast))
    return [*scored(of_others), *best_in_hindsight(scored(of_structures))]
