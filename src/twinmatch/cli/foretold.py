"""The work of `twinmatch forecast`: judge as far as needed, forecast, and show the forecasts."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import dataclass, replace
from pathlib import Path

from twinmatch.cli.forecasting import LONGEST, RECORDED
from twinmatch.cli.set_points import Asked, asked_of, planned_rows
from twinmatch.errors import TwinmatchError
from twinmatch.forecasting import horizons_for, time_scale
from twinmatch.offline.interrupt import held_interrupts
from twinmatch.offline.outlooks import Prospect, prospects, samples_at
from twinmatch.offline.progress import Progress
from twinmatch.offline.terms import terms_from_files
from twinmatch.sessions import Session, open_any
from twinmatch.showing.forecasts import comparison_words, forecast_document, forecast_words
from twinmatch.showing.series import Fan, fan
from twinmatch.twin import TwinSettings

__all__ = ["Foretold", "foretold", "show"]


@dataclass(frozen=True, eq=False)
class Foretold:
    """The requested forecasts, in the order of `--at`."""

    settings: TwinSettings
    fans: tuple[Fan, ...]
    prospects: tuple[Prospect, ...]
    """The candidate that made each forecast."""
    words: tuple[str, ...]
    """Description of the set-points, or inputs, ahead of each."""


def foretold(options: argparse.Namespace) -> Foretold:
    """Make the forecasts that the options request.

    Raises:
        TwinmatchError: the session, a file or an option cannot be used.
    """
    rows = None
    if options.reference not in {None, RECORDED}:
        rows = planned_rows(Path(options.reference))
    with held_interrupts():
        with Progress("reading") as progress:
            session = open_any(options.session, progress=progress.advance, plant=options.plant)
        terms = terms_from_files(session, options.config, options.candidates)
        settings = terms.settings
        size = _size(options.horizon, settings.period)
        samples = samples_at(session, options.at)
        asked = {
            k: asked_of(session, sample, size, settings=settings, options=options, rows=rows)
            for k, sample in samples.items()
        }
        with Progress() as progress:
            known = prospects(session, terms, samples, candidate=options.candidate, watch=progress.advance)
        fans = {k: _fan(session, known[k], asked[k], settings.period) for k in samples}
    return Foretold(
        settings,
        tuple(fans[k] for k in options.at),
        tuple(known[k] for k in options.at),
        tuple(asked[k].words for k in options.at),
    )


def show(found: Foretold, options: argparse.Namespace) -> None:
    """Print the forecasts, and write the files that the options name.

    Raises:
        TwinmatchError: a file cannot be written.
    """
    for one, prospect, set_points in zip(found.fans, found.prospects, found.words, strict=True):
        _print(one, prospect, set_points, found.settings)
    print(
        "The leader is the candidate to forecast with: its forecasts have saved the most characters so far."
    )
    if options.json is not None:
        entries = [forecast_document(one.forecast) for one in found.fans]
        text = json.dumps(entries, indent=1, allow_nan=False, ensure_ascii=False)
        try:
            options.json.write_text(text + "\n", encoding="utf-8")
        except OSError as error:
            raise TwinmatchError(f"{options.json}: cannot be written ({error.strerror})") from error
    if options.figure is not None:
        from twinmatch.showing.figures.drawing import save  # noqa: PLC0415 — matplotlib is slow
        from twinmatch.showing.figures.forecasts import draw_forecasts  # noqa: PLC0415

        save(draw_forecasts(found.fans, found.settings.plant), options.figure)


def _size(horizon: float | None, period: float) -> int:
    """Samples within the horizon; without one, within the longest at which forecasts are scored."""
    horizon = horizons_for(period)[-1] if horizon is None else horizon
    longest = LONGEST * time_scale(period)
    if not (math.isfinite(horizon) and 0 < horizon <= longest):
        msg = (
            f"forecast: the horizon is {horizon:g} s; give a positive number of seconds, at most {longest:g}"
        )
        raise TwinmatchError(msg)
    size = int(horizon / period * (1 + 1e-9))
    if size < 1:
        msg = f"forecast: the horizon of {horizon:g} s is shorter than one sample, {period:g} s; give more"
        raise TwinmatchError(msg)
    return size


def _fan(session: Session, prospect: Prospect, asked: Asked, period: float) -> Fan:
    forecast = prospect.outlook.forecast(asked.ahead, asked.disturbances)
    learned = prospect.outlook.leads[-1] * period
    beyond: tuple[str, ...] = ()
    if forecast.time[-1] > learned:
        beyond = (f"the width of the band is learned up to {learned:g} s ahead, and not beyond",)
    noted = replace(forecast, notes=forecast.notes + beyond + asked.notes)
    return fan(noted, session.samples, period)


def _print(one: Fan, prospect: Prospect, set_points: str, settings: TwinSettings) -> None:
    forecast = one.forecast
    seconds = f"{forecast.sample * settings.period:g} s"
    print(f"At {seconds} (sample {forecast.sample}), {set_points}:")
    confidence = f"confidence {prospect.leader_confidence:.2f}"
    who = f"the leader ({confidence})" if prospect.leads else f"the leader is {prospect.leader}, {confidence}"
    print(f"  {forecast.candidate} forecasts {forecast.time[-1]:g} s; {who}")
    for line in forecast_words(forecast, settings.plant) + comparison_words(one, settings.plant):
        print(f"  {line}")
    for note in forecast.notes:
        print(f"  Note: {note.rstrip('.')}.")
