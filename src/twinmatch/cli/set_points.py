"""Which set-points lie ahead of a sample, as the options of `twinmatch forecast` say."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

from twinmatch.cli.forecasting import RECORDED
from twinmatch.errors import TwinmatchError
from twinmatch.forecasting import ForecastError, SetPoints
from twinmatch.sessions import Session
from twinmatch.sessions.files import read_bounded
from twinmatch.signals import FloatArray, Sample, unbroken
from twinmatch.twin import TwinSettings

__all__ = ["Asked", "asked_of", "planned_rows"]


MOST_BYTES = 1 << 20
"""Longest file of set-points: a day of them, one per second."""


class Asked(NamedTuple):
    """Set-points ahead of one sample."""

    ahead: FloatArray
    """From the next sample on, shape (N,)."""
    words: str
    """Which they are."""
    notes: tuple[str, ...] = ()


def planned_rows(path: Path) -> list[str]:
    """The lines of a file of set-points.

    Raises:
        TwinmatchError: it cannot be read, or is no text.
    """
    try:
        return read_bounded(path, MOST_BYTES).decode("utf-8-sig").splitlines()
    except FileNotFoundError:
        msg = f"{path}: does not exist; give a .csv with seconds ahead and set-point, or {RECORDED!r}"
        raise TwinmatchError(msg) from None
    except OSError as error:
        raise TwinmatchError(f"{path}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError:
        raise TwinmatchError(f"{path}: is no text; give a .csv with seconds ahead and set-point") from None


def asked_of(
    session: Session,
    sample: Sample,
    size: int,
    *,
    settings: TwinSettings,
    options: argparse.Namespace,
    rows: list[str] | None,
) -> Asked:
    """The set-points of the `size` samples behind this one, or of as many as were recorded.

    `rows` are the lines of the file that the options name, if they name one.

    Raises:
        TwinmatchError: a set-point that the plant does not take, a profile that cannot be read, or nothing
            that was recorded.
    """
    if options.reference == RECORDED:
        return _recorded(session, sample, size, settings.period)
    output = settings.plant.output
    unit = f" {output.unit}".rstrip()
    if rows is not None:
        try:
            profile = SetPoints.planned(rows, sample.reference, output=output)
        except ForecastError as error:
            raise ForecastError(f"{options.reference}: {error}") from error
        words = f"set-points of {Path(options.reference).name}"
    elif options.hold is not None:
        try:
            profile = SetPoints.held(options.hold, output)
        except ForecastError as error:
            raise ForecastError(f"--hold: {error}") from error
        words = f"{options.hold:g}{unit} held"
    else:
        profile = SetPoints.held(sample.reference)
        words = f"its set-point of {sample.reference:g}{unit} held"
    return Asked(profile.ahead(settings.period, size), words, profile.notes)


def _recorded(session: Session, sample: Sample, size: int, period: float) -> Asked:
    stretch = next(
        part for part in unbroken(session.samples) if part[0].index <= sample.index <= part[-1].index
    )
    reference = [s.reference for s in stretch if sample.index <= s.index <= sample.index + size]
    count = len(reference) - 1
    if not count:
        msg = (
            f"session {session.name}: nothing was recorded right after sample {sample.index}, so that no "
            "set-point ahead is known; take an earlier one, or give --hold"
        )
        raise TwinmatchError(msg)
    notes: tuple[str, ...] = ()
    if count < size:
        why = "a sample is missing" if stretch[-1].index < session.samples[-1].index else "the session ends"
        notes = (f"shortened to {count * period:g} s: {why} there",)
    return Asked(SetPoints.recorded(reference, period).ahead(period, count), "the recorded set-points", notes)
