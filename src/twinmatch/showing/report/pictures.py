"""The figures of a report, each with its title and a description for readers who cannot see it."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from twinmatch.comparing import REFUSED, number_list
from twinmatch.dynamics import Drive, Output, Plant
from twinmatch.errors import TwinmatchError
from twinmatch.forecasting import Forecast
from twinmatch.offline.backtest import Backtest
from twinmatch.offline.judging import Judgement
from twinmatch.offline.processes import Beside
from twinmatch.offline.summary import shown_twin
from twinmatch.showing.family import Member, chosen_score
from twinmatch.showing.figures.drawing import save, svg
from twinmatch.showing.figures.family import (
    draw_criteria,
    draw_matrix,
    draw_parameters,
    draw_responses,
    draw_uncertainty,
)
from twinmatch.showing.figures.forecasts import draw_backtest, draw_forecasts
from twinmatch.showing.figures.session import draw_estimates, draw_health, draw_session
from twinmatch.showing.forecasts import backtest_words
from twinmatch.showing.quantities import shown_inputs, shown_outputs, signal_names
from twinmatch.showing.series import Fan, fan
from twinmatch.showing.verdicts import admitted, last_verdict
from twinmatch.signals import Window

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_QUEUE: Final = {"leader_forecasts": -2, "forecasts": -1, "responses": 1}
"""Places of the pictures that take longest: each of two processes begins at one end of the queue."""
_SHOWN = 6
"""Forecasts of the leader that fit into one figure."""


@dataclass(frozen=True, eq=False)
class Picture:
    """One figure."""

    name: str
    """Name of its file, without suffix."""
    title: str
    alt: str
    """Description in words."""
    draw: Callable[[], Figure]
    svg: str = ""

    @property
    def uri(self) -> str:
        """The figure as a data URI, so that the HTML file loads nothing else."""
        return "data:image/svg+xml;base64," + base64.b64encode(
            self.svg.encode()
        ).decode("ascii")


def pictures(
    judgement: Judgement,
    members: Sequence[Member],
    tests: Sequence[Backtest],
    work: Beside,
) -> dict[str, Picture]:
    """All figures of a session and its family, by name and in the order of the report.

    `work` draws some of them, if it has a second process.
    """
    planned = [*_of_session(judgement)]
    for k, tested in enumerate(tests):
        planned += _of_forecasts(
            judgement, tested, k, f"_{next(iter(tested.plant.outputs))}" if k else ""
        )
    planned += _of_family(judgement, members)
    queue = sorted(planned, key=lambda picture: _QUEUE.get(picture.name, 0))
    tasks = [(picture.name, work.give(_svg, picture.draw)) for picture in queue]
    # this process begins with the last
    drawn = {name: result() for name, result in reversed(tasks)}
    return {
        picture.name: replace(picture, svg=drawn[picture.name]) for picture in planned
    }


def _svg(draw: Callable[[], Figure]) -> str:
    return svg(draw())


def _of_session(j: Judgement) -> Iterator[Picture]:
    """The figures of the whole session."""
    title = "Plant and leading twin over the whole session"
    draw = partial(draw_session, j.samples, j.verdicts, j.settings, j.stretches)
    yield Picture("session", title, _session_alt(j), draw)
    draw = partial(draw_health, j.samples, j.matches, j.verdicts, j.settings)
    yield Picture("health", "Health over time", _health_alt(j), draw)
    if j.estimates:
        draw = partial(
            draw_estimates, j.estimates, j.settings.period, j.samples[-1].index + 1
        )
        alt = "; ".join(course.line(j.settings.period) for course in j.estimates)
        yield Picture(
            "estimates",
            "What sensors should have read that were not believed",
            alt,
            draw,
        )


def _of_forecasts(
    j: Judgement, tested: Backtest, k: int, ending: str
) -> Iterator[Picture]:
    """The figures of the forecasts of the k-th output; `ending` is added to their names."""
    if not tested.marked:
        return
    alt = (
        "Errors and coverage of every forecaster by horizon, and the leader's forecasts with their "
        f"bands, compared with the measurements. {' '.join(backtest_words(tested))}"
    )
    of_output = (
        "" if j.settings.plant.single else f": {signal_names(tested.plant).output}"
    )
    title = f"Forecasts compared with measurements{of_output}"
    yield Picture(f"forecasts{ending}", title, alt, partial(draw_backtest, tested))
    if fans := fans_of(tested, j, k):
        origins = ", ".join(
            f"{shown.forecast.sample} by {shown.forecast.candidate}" for shown in fans
        )
        alt = (
            "Forecasts with their bands, the measurements before and after, and measured minus forecast "
            f"within the band. Made at samples {origins}."
        )
        draw = partial(draw_forecasts, fans, tested.plant)
        yield Picture(
            f"leader_forecasts{ending}",
            f"Forecasts of the leader{of_output}",
            alt,
            draw,
        )


def _of_family(j: Judgement, members: Sequence[Member]) -> Iterator[Picture]:
    """The figures of the matches and of the family at the end."""
    if j.matches:
        nominal = next((m.match for m in members if m.nominal), None)
        alt = (
            f"Value and 95 % interval of every fitted parameter at each of {len(j.matches)} matches; refused "
            "ones hollow, the nominal one as a diamond."
        )
        draw = partial(
            draw_parameters, j.matches, admitted(j.verdicts), nominal, j.settings.period
        )
        yield Picture("parameters", "Parameters of every match", alt, draw)
    if members:
        names = ", ".join(m.score.name for m in members)
        output = number_list(map(str, shown_outputs(j.settings.plant)))
        model = " and that of its Box–Jenkins model" if j.settings.plant.single else ""
        alt = (
            f"One panel for each candidate ({names}): set-point, measured {output} and control, the response "
            f"of the twin{model}."
        )
        yield Picture(
            "responses",
            "The family on the measured data",
            alt,
            partial(draw_responses, members),
        )
        alt = (
            f"The twins of all candidates ({names}) on the window of the nominal one, and the differences "
            f"from the nominal twin in {output} and control."
        )
        yield Picture(
            "uncertainty",
            "Uncertainty of the twin",
            alt,
            partial(draw_uncertainty, members),
        )
    last = last_verdict(j.verdicts)
    if last is not None and last.modelled:
        chosen = ((c.name, score) for c in last.modelled if (score := chosen_score(c)))
        gains = ", ".join(
            f"{n}: order {o.order}, gain {o.total.gain} characters" for n, o in chosen
        )
        alt = f"Bars for every candidate and order. {gains}."
        yield Picture(
            "criteria", "Criteria of the orders", alt, partial(draw_criteria, last)
        )
    if last is not None:
        sums = ", ".join(f"{c.name} {c.nu_gap_sum:.2f}" for c in last.candidates)
        alt = f"Shaded matrix of the ν-gaps between the plants. Sums: {sums}. Nominal: {last.nominal}."
        yield Picture(
            "nu_gap",
            "ν-gap between the plants of the family",
            alt,
            partial(draw_matrix, last),
        )


def fans_of(tested: Backtest, judgement: Judgement, k: int = 0) -> tuple[Fan, ...]:
    """The leader's forecasts of the k-th output during which a set-point (or an input) moved most, in order of
    time."""
    stretches_of_output = [window.alone(k) for window in judgement.stretches]
    hardest = hardest_forecasts(
        tested.shown, judgement.stretches, judgement.settings.plant
    )
    return tuple(fan(forecast, stretches_of_output) for forecast in hardest)


def hardest_forecasts(
    forecasts: Sequence[Forecast], stretches: Sequence[Window], plant: type[Plant]
) -> list[Forecast]:
    """Those forecasts, as many as fit into a figure, during which a signal that they were given moved most.

    Each of several set-points, or inputs, moves every output, so all of them count, in units of their noise.
    """

    def moved(forecast: Forecast) -> float:
        return _movement_during(forecast, stretches, plant)

    hardest = sorted(forecasts, key=moved, reverse=True)[:_SHOWN]
    return sorted(hardest, key=lambda forecast: forecast.sample)


def _movement_during(
    forecast: Forecast, stretches: Sequence[Window], plant: type[Plant]
) -> float:
    """How far a set-point, or an input that was given, moved during a forecast, in units of its noise."""
    first = forecast.sample + 1
    whole = next(part for part in stretches if part.first <= first <= part.last)
    window = whole.part(first, min(whole.last, forecast.sample + forecast.time.size))
    signals = window.references
    declared: Sequence[Output | Drive] = [*plant.outputs.values()]
    if not forecast.closed:
        signals = window.inputs
        declared = [*plant.drives.values()]
    noise = np.array([signal.noise for signal in declared[: signals.shape[1]]])
    return float((np.ptp(signals, axis=0) / noise).max())


def write_pictures(named: dict[str, Picture], folder: Path, ending: str) -> list[Path]:
    """Write every figure into a folder, which is created if it does not exist.

    Raises:
        TwinmatchError: the folder cannot be created or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        msg = (
            f"{folder}: the folder for the figures cannot be created: {error.strerror}"
        )
        raise TwinmatchError(msg) from error
    paths = {folder / f"{name}.{ending}": picture for name, picture in named.items()}
    for path, picture in paths.items():
        save(picture.draw(), path)
    return list(paths)


def _session_alt(j: Judgement) -> str:
    readings = list(zip(*(s.outputs for s in j.samples), strict=True))
    outputs = shown_outputs(j.settings.plant)
    inputs = shown_inputs(j.settings.plant)
    closed = j.settings.law is not None
    set_point = "set-point, " if closed else ""
    measured = [
        f"{y} ({y.text(min(values), max(values))})"
        for y, values in zip(outputs, readings, strict=True)
    ]
    signals = number_list([*measured, *map(str, inputs)])
    base = f"Time series of {set_point}measured {signals}"
    shown = shown_twin(j.verdicts[-1] if j.verdicts else None)
    if shown is None:
        return f"{base}; there is no twin to compare them with."
    twins = "the driven twin"
    fitted = "driven"
    fit_of_output = j.summary.fits.outputs if j.summary.fits else ()
    fits = [
        f"{y} to {100 * share:.1f}"
        for y, share in zip(outputs, fit_of_output, strict=True)
    ]
    if closed:
        twins = "the closed-loop and the driven twin"
        fitted = "closed-loop"
    return (
        f"{base}, with {twins} of {shown.name}; below, the residuals between plant and twin. "
        f"The {fitted} twin fits the {number_list(fits)} %."
    )


def _health_alt(j: Judgement) -> str:
    stretches = j.summary.stretches
    levels = ", ".join(
        f"{s.level.value} from {s.times(j.settings.period)}" for s in stretches
    )
    n_admitted = len(admitted(j.verdicts))
    refused = sum(v.match == REFUSED for v in j.verdicts)
    return f"Trust over time: {levels or 'no verdict'}. {n_admitted} matches admitted, {refused} refused."
