"""The set-points ahead of a sample, according to the options of `twinmatch forecast`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np

from twinmatch.cli.forecasting import RECORDED
from twinmatch.dynamics import Drive, Output
from twinmatch.errors import TwinmatchError
from twinmatch.forecasting import ForecastError, SetPoints
from twinmatch.sessions import Session
from twinmatch.sessions.files import read_bounded
from twinmatch.signals import FloatArray, Sample, unbroken
from twinmatch.twin import TwinSettings

__all__ = ["Asked", "asked_of", "planned_rows"]


MOST_BYTES = 1 << 20
"""Largest file of set-points, bytes: a day of them, one per second."""


class Asked(NamedTuple):
    """Set-points, or inputs where the loop is not known, ahead of one sample."""

    ahead: FloatArray
    """From the next sample on, shape (N,)."""
    words: str
    """Their description."""
    notes: tuple[str, ...] = ()
    disturbances: FloatArray | None = None
    """As recorded from this sample on, shape (N + 1, d); None: held at their last values."""


def planned_rows(path: Path) -> list[str]:
    """The lines of a file of set-points.

    Raises:
        TwinmatchError: it cannot be read, or is not text.
    """
    try:
        return read_bounded(path, MOST_BYTES).decode("utf-8-sig").splitlines()
    except FileNotFoundError:
        msg = f"{path}: does not exist; give a .csv with seconds ahead and set-point, or {RECORDED!r}"
        raise TwinmatchError(msg) from None
    except OSError as error:
        raise TwinmatchError(f"{path}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError:
        raise TwinmatchError(
            f"{path}: not a text file; give a .csv with seconds ahead and set-point"
        ) from None


def asked_of(
    session: Session,
    sample: Sample,
    size: int,
    *,
    settings: TwinSettings,
    options: argparse.Namespace,
    rows: list[str] | None,
) -> Asked:
    """The set-points, or inputs, of the `size` samples after this one, or of as many as were recorded.

    `rows` are the lines of the file that the options name, if they name one.

    Raises:
        TwinmatchError: the plant does not take a set-point or input, a profile cannot be read, or nothing
            was recorded after the sample.
    """
    if options.reference == RECORDED:
        return _recorded(session, sample, size, settings)
    closed = settings.gains is not None
    signal: Output | Drive = settings.plant.output if closed else settings.plant.drive
    kind, standing = ("set-point", sample.reference) if closed else ("input", sample.input)
    unit = f" {signal.unit}".rstrip()
    if rows is not None:
        try:
            profile = SetPoints.planned(rows, standing, signal=signal)
        except ForecastError as error:
            raise ForecastError(f"{options.reference}: {error}") from error
        words = f"{kind}s of {Path(options.reference).name}"
    elif options.hold is not None:
        try:
            profile = SetPoints.constant(options.hold, signal)
        except ForecastError as error:
            raise ForecastError(f"--hold: {error}") from error
        words = f"{options.hold:g}{unit} held"
    else:
        profile = SetPoints.constant(standing)
        words = f"its {kind} of {standing:g}{unit} held"
    return Asked(profile.ahead(settings.period, size), words, profile.notes)


def _recorded(session: Session, sample: Sample, size: int, settings: TwinSettings) -> Asked:
    period, closed = settings.period, settings.gains is not None
    kind = "set-point" if closed else "input"
    stretch = next(
        part for part in unbroken(session.samples) if part[0].index <= sample.index <= part[-1].index
    )
    came = [s for s in stretch if sample.index <= s.index <= sample.index + size]
    levels = [s.reference if closed else s.input for s in came]
    count = len(came) - 1
    if not count:
        msg = (
            f"session {session.name}: nothing was recorded right after sample {sample.index}, so no "
            f"{kind} ahead is known; choose an earlier sample, or give --hold"
        )
        raise TwinmatchError(msg)
    notes: tuple[str, ...] = ()
    if count < size:
        why = "a sample is missing" if stretch[-1].index < session.samples[-1].index else "the session ends"
        notes = (f"shortened to {count * period:g} s: {why} there",)
    rows = np.array([s.disturbances for s in came]) if sample.disturbances else None
    ahead = SetPoints.recorded(levels, period).ahead(period, count)
    return Asked(ahead, f"the recorded {kind}s", notes, rows)
