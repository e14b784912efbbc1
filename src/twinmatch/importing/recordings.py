"""Reads recordings of the Peltier rig that other programs made.

A **.mat** recording (MATLAB version 5, 6 or 7) holds the matrix `simout` with one row per sample and four
columns: PWM command (−255 to 255), temperature (°C), time (s), set-point (°C).

A **.csv** recording is a table as `tables` reads it, with these four columns; case and a unit in brackets do
not matter in the names:

    time          t, seconds                     s
    reference     r, setpoint, set_point         °C
    output        temperature, y, temp           °C
    input         pwm, u, command                −255 to 255

A unit in brackets is checked: `temperature (K)` is refused, not converted. Each row is a tick of the loop,
and is used as it is; tables of other rigs, and irregular rows, are imported with a map of their columns.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Final

from twinmatch.importing.clocks import require_agreement
from twinmatch.importing.mapped import PlantSignal, check_range
from twinmatch.importing.resampling import period_of_ticks
from twinmatch.importing.tables import Table, read_table, split_title
from twinmatch.importing.times import Times
from twinmatch.plants import Peltier
from twinmatch.sampling.sources import INPUT, OUTPUT, REFERENCE, TIME
from twinmatch.sessions.cdr import plant_messages
from twinmatch.sessions.files import (
    ProgressCallback,
    RecordingError,
    SessionError,
)
from twinmatch.sessions.messages import SAMPLE, topics_of
from twinmatch.sessions.reader import Session, named
from twinmatch.sessions.recording import samples_of
from twinmatch.signals import KELVIN, Sample, Window

_SUFFIXES: Final = (".mat", ".csv")
_MAT_BEGINNING: Final = b"MATLAB 5.0 MAT-file"
_MATRIX: Final = "simout"
_MATRIX_SIGNALS: Final = (INPUT, OUTPUT, TIME, REFERENCE)
"""The signals of the matrix, column by column."""
_NAMES: Final = {
    TIME: ("time", "t", "seconds"),
    REFERENCE: ("reference", "r", "setpoint", "set_point"),
    OUTPUT: ("temperature", "y", "temp"),
    INPUT: ("pwm", "u", "command"),
}
_UNITS: Final = {TIME: ("s",), INPUT: ()}
_CELSIUS: Final = ("°c", "degc", "c")
_TEMPERATURE: Final = PlantSignal("set", "°C", low=-KELVIN)
_DRIVE: Final = PlantSignal("held", Peltier.drive.unit, *Peltier.drive.limits)


def read_recording(
    path: Path | str, progress: ProgressCallback | None = None
) -> Window:
    """Read a recording of the rig, as this module describes them, as one window counted from 0.

    `progress` is called with the bytes read and the total.

    Raises:
        RecordingError: the file does not exist, is not a recording, lacks columns, or has values or times
            that cannot be used.
    """
    path = Path(path)
    if path.suffix.lower() not in _SUFFIXES and path.exists():
        problem = (
            "is a folder; give the file in it"
            if path.is_dir()
            else f"has the suffix {path.suffix!r}"
        )
        raise RecordingError(
            f"{path}: {problem}; a recording has {' or '.join(_SUFFIXES)}"
        )
    table = read_table(path, progress, matrix=(_MATRIX, len(_MATRIX_SIGNALS)))
    titles = (
        _titles(table)
        if table.units
        else dict(zip(_MATRIX_SIGNALS, table.columns, strict=True))
    )
    columns = {signal: table.values(title) for signal, title in titles.items()}
    if table.units:
        require_agreement(table, titles[TIME], Times(columns[TIME], None))
    period = period_of_ticks(
        columns[TIME],
        {signal: column for signal, column in columns.items() if signal != TIME},
        place=str(path),
        row=table.row_name,
    )
    for signal, bounds in (
        (INPUT, _DRIVE),
        (OUTPUT, _TEMPERATURE),
        (REFERENCE, _TEMPERATURE),
    ):
        check_range(table, signal, bounds, columns[signal])
    return Window(columns[REFERENCE], columns[OUTPUT], columns[INPUT], period=period)


def _titles(table: Table) -> dict[str, str]:
    """The titles of the four columns, by signal.

    Raises:
        RecordingError: a column is missing, there twice, or in another unit.
    """
    titles: dict[str, str] = {}
    for title in table.columns:
        # which tells two equal titles apart
        without_number = re.sub(r" #\d+$", "", title.lower())
        name, unit = split_title(without_number)
        signal = next(
            (signal for signal, names in _NAMES.items() if name in names), None
        )
        if signal is None:
            continue
        if unit and unit not in _UNITS.get(signal, _CELSIUS):
            wanted = {TIME: "s", INPUT: "steps of −255 to 255, without unit"}.get(
                signal, "°C"
            )
            raise RecordingError(
                f"{table.path}: column {title!r}: give {signal} in {wanted}"
            )
        if signal in titles:
            both = f"columns {titles[signal]!r} and {title!r} are both {signal}"
            raise RecordingError(f"{table.path}: {both}; rename or remove one")
        titles[signal] = title
    missing = [
        f"{signal} ({', '.join(names)})"
        for signal, names in _NAMES.items()
        if signal not in titles
    ]
    if missing:
        raise RecordingError(
            f"{table.path}: has no column of {' and none of '.join(missing)}; it has {table.titles}"
        )
    return titles


def open_recording(
    path: Path, beginning: bytes, progress: ProgressCallback | None = None
) -> Session:
    """A recording of the rig as a session, with the messages that its import would have.

    `beginning` are the first bytes of the file.

    Raises:
        SessionError: it is not a recording.
        RecordingError: as of `read_recording`.
    """
    if path.suffix.lower() in _SUFFIXES:
        samples = samples_of(read_recording(path, progress))
        return session_of(path, samples, plant=Peltier.name)
    hint = (
        "; a MATLAB file needs the suffix .mat"
        if beginning.startswith(_MAT_BEGINNING)
        else ""
    )
    raise SessionError(
        f"{path}: is neither a session (folder or .mcap) nor a recording (.mat, .csv){hint}"
    )


def session_of(
    path: Path, samples: list[Sample], *, plant: str, has_reference: bool = True
) -> Session:
    """The samples (at least one) of a file as a session, equal to their import.

    `has_reference`: whether their set-points are meaningful.
    """
    topics = topics_of(samples)
    counts = Counter(message.topic.name for message in plant_messages(samples, topics))
    return Session(
        name=named(path.stem),
        path=path,
        topic=SAMPLE.name,
        samples=samples,
        topics=list(topics),
        counts={topic.name: counts[topic.name] for topic in topics},
        start=samples[0].stamp,
        end=samples[-1].stamp,
        notes=[],
        source=lambda: plant_messages(samples, topics),
        plant=plant,
        has_reference=has_reference,
    )
