"""`twinmatch forecast`: forecasts from chosen samples of a session."""

from __future__ import annotations

import argparse
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from twinmatch.cli.shared import (
    TERMS,
    Progress,
    add_options,
    check_writable,
    open_shown,
    write_json,
)
from twinmatch.dynamics import Plant, channels
from twinmatch.dynamics.pace import time_scale
from twinmatch.errors import TwinmatchError
from twinmatch.forecasting import MAX_SAMPLES, ArrivalQuestion, arrival
from twinmatch.offline.clock_times import seconds_until
from twinmatch.offline.judging import Terms, terms_from_files
from twinmatch.offline.outlooks import (
    LONGEST,
    RECORDED,
    Ahead,
    Prospect,
    check_recorded_ahead,
    forecast_of,
    planned_ahead,
    planned_rows,
    prospects,
    recorded_ahead,
    samples_ahead,
    samples_at,
)
from twinmatch.offline.processes import held_interrupts
from twinmatch.sessions import Session
from twinmatch.showing.forecasts import (
    arrival_document,
    arrival_words,
    comparison_words,
    forecast_document,
    forecast_words,
)
from twinmatch.showing.series import Fan, fan
from twinmatch.twin import TwinSettings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Runs the last windows before the first chosen sample through the twin. At each chosen sample the "
        "leader (the candidate whose forecasts have cost least so far) forecasts what comes next, from the "
        "samples up to that one and the set-points ahead. Without --reference and --hold, the set-point of "
        "that sample is held."
    )
    add_options(parser, "session", metavar="SESSION")
    several: dict[str, Any] = {"nargs": "+", "action": "extend", "metavar": "SAMPLE"}
    at = "indices of the samples to forecast from (with --reach by default the last)"
    parser.add_argument("--at", type=_sample, **several, help=at)
    reach = "when will the output be at this level, and when does it get there if one begins now?"
    parser.add_argument("--reach", type=float, metavar="LEVEL", help=reach)
    by = "with --reach: when must one begin to be there at HH:MM, at a date and time, or in +SECONDS?"
    parser.add_argument("--by", metavar="TIME", help=by)
    ahead = "set-points ahead: a .csv of seconds ahead and set-point, or those recorded in the session"
    parser.add_argument("--reference", metavar="FILE|recorded", help=ahead)
    held = "set-point to hold ahead; give it once for each set-point of the plant, in its order"
    parser.add_argument(
        "--hold", type=float, action="append", metavar="VALUE", help=held
    )
    parser.add_argument(
        "--candidate",
        metavar="NAME",
        help="candidate that forecasts (default: the leader)",
    )
    whole = "give the twin all samples of the session, not only the last windows before the first SAMPLE"
    parser.add_argument("--from-the-beginning", action="store_true", help=whole)
    horizon = "forecast horizon, s (default: 300, at least 60 and at most 600 samples)"
    parser.add_argument("--horizon", type=float, metavar="S", help=horizon)
    add_options(parser, "--json", help="write the forecasts to this file")
    add_options(parser, "--figure", help="draw them (.png, .svg or .pdf)")
    add_options(parser, *TERMS)


def run(options: argparse.Namespace) -> int:
    """Forecast and print; returns the exit code.

    Raises:
        TwinmatchError: an option, the session or a file cannot be used.
    """
    if options.reference is not None and options.hold is not None:
        raise TwinmatchError(
            "forecast: --reference and --hold exclude each other; give only one of them"
        )
    if options.candidate is not None and not options.candidate.strip():
        raise TwinmatchError(
            "forecast: --candidate is empty; give a name, or omit it to use the leader"
        )
    check_writable(options.json, options.figure)
    if options.reach is not None:
        return _arrivals(options)
    if options.by is not None:
        options.parser.error("--by needs --reach LEVEL")
    if not options.at:
        options.parser.error(
            "give --at SAMPLE, or --reach LEVEL to forecast from the last one"
        )
    with held_interrupts():
        settings, requested = _forecasts(options)

    for forecast in requested:
        _print(forecast, settings)
    forecasts = [forecast.fan.forecast for forecast in requested]
    reason = "its forecasts have saved the most characters so far"
    print(f"The leader is the candidate to forecast with: {reason}.")
    write_json(
        options.json,
        lambda: [forecast_document(forecast, settings.plant) for forecast in forecasts],
    )
    if options.figure is not None:
        _draw([forecast.fan for forecast in requested], settings.plant, options.figure)
    return 0


def _draw(fans: Sequence[Fan], plant: type[Plant], figure: Path) -> None:
    """Draw the forecasts of every output, each into a file of its own beside `figure`."""
    from twinmatch.showing.figures.drawing import save  # noqa: PLC0415
    from twinmatch.showing.figures.forecasts import draw_forecasts  # noqa: PLC0415

    for k, alone in enumerate(channels(plant)):
        ending = f"_{next(iter(alone.outputs))}" if k else ""
        save(
            draw_forecasts([fan.alone(k) for fan in fans], alone),
            figure.with_stem(figure.stem + ending),
        )


def _arrivals(options: argparse.Namespace) -> int:
    """When the output is at a level, from each sample, and when to begin; returns the exit code."""
    if (
        options.reference is not None
        or options.horizon is not None
        or options.figure is not None
    ):
        options.parser.error("--reach takes --hold, --by, --at, --candidate and --json")
    if options.hold is not None and len(options.hold) > 1:
        options.parser.error(
            "--reach takes --hold once: it is for a plant with one output"
        )
    hold = None if options.hold is None else options.hold[0]
    documents = []
    with held_interrupts():
        session = open_shown(options.session, options.plant)
        terms = terms_from_files(session, options.config, options.candidates)
        settings = terms.settings
        indices = options.at or [session.samples[-1].index]
        samples = samples_at(session, indices)
        by_sample = _prospects(options, session, terms, samples)
        for index in indices:
            stamp = samples[index].stamp
            by = None if options.by is None else seconds_until(options.by, stamp)
            outlook = by_sample[index].outlook
            longest = (
                samples_ahead(LONGEST * time_scale(settings.period), settings)
                if by
                else MAX_SAMPLES
            )
            answer = arrival(
                outlook, ArrivalQuestion(options.reach, by, hold, longest=longest)
            )
            print(f"From sample {index}, {outlook.candidate}:")
            for line in arrival_words(
                answer, settings.plant, stamp, closed=outlook.closed
            ):
                print(f"  {line}")
            for note in answer.notes:
                print(f"  Note: {note.rstrip('.')}.")
            documents.append(
                {
                    "sample": index,
                    "candidate": outlook.candidate,
                    **arrival_document(answer),
                }
            )
    write_json(options.json, lambda: documents)
    return 0


def _prospects(
    options: argparse.Namespace,
    session: Session,
    terms: Terms,
    indices: Collection[int],
) -> dict[int, Prospect]:
    """What the twin knows at each of these samples, by index; shows how far the judging is."""
    with Progress() as progress:
        return prospects(
            session,
            terms,
            indices,
            candidate=options.candidate,
            whole=options.from_the_beginning,
            watch=progress.advance,
        )


def _sample(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        msg = f"{text!r} is not a sample index; give whole numbers, and the session before --at"
        raise argparse.ArgumentTypeError(msg) from None


class _Requested(NamedTuple):
    """One of the requested forecasts."""

    fan: Fan
    prospect: Prospect
    """The candidate that made it."""
    words: str
    """Description of the set-points, or inputs, ahead."""


def _forecasts(options: argparse.Namespace) -> tuple[TwinSettings, list[_Requested]]:
    """The settings, and the requested forecasts in the order of `--at`."""
    named = options.reference not in {None, RECORDED}
    rows = planned_rows(Path(options.reference)) if named else None
    session = open_shown(options.session, options.plant)
    terms = terms_from_files(session, options.config, options.candidates)
    settings = terms.settings
    period = terms.settings.period
    size = samples_ahead(options.horizon, settings)
    samples = samples_at(session, options.at)
    planned: dict[int, Ahead] = {}
    if options.reference == RECORDED:
        check_recorded_ahead(session, samples.values(), settings)
    else:
        for index, sample in samples.items():
            planned[index] = planned_ahead(
                sample,
                size,
                settings=settings,
                reference=options.reference,
                hold=options.hold or (),
                rows=rows,
            )
    by_sample = _prospects(options, session, terms, samples)
    requested = {}
    for index, sample in samples.items():
        prospect = by_sample[index]
        settled = prospect.stretches
        ahead = planned.get(index) or recorded_ahead(
            session, sample, size, settled, settings
        )
        forecast = forecast_of(prospect, ahead, period)
        forecast = replace(forecast, notes=(*session.missing, *forecast.notes))
        requested[index] = _Requested(fan(forecast, settled), prospect, ahead.words)
    return settings, [requested[index] for index in options.at]


def _print(requested: _Requested, settings: TwinSettings) -> None:
    forecast = requested.fan.forecast
    prospect = requested.prospect
    seconds = f"{forecast.sample * settings.period:g} s"
    print(f"At {seconds} (sample {forecast.sample}), {requested.words}:")
    confidence = f"confidence {prospect.leader_confidence:.2f}"
    leader = (
        f"the leader ({confidence})"
        if prospect.leads
        else f"the leader is {prospect.leader}, {confidence}"
    )
    print(f"  {forecast.candidate} forecasts {forecast.time[-1]:g} s; {leader}")
    for line in forecast_words(forecast, settings) + comparison_words(
        requested.fan, settings.plant
    ):
        print(f"  {line}")
    for note in forecast.notes:
        print(f"  Note: {note.rstrip('.')}.")
