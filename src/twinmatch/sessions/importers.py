"""Reads recordings of the rig made by other programs: MATLAB `.mat` and `.csv`.

A **.mat** file (MATLAB version 5, 6 or 7) holds the matrix `simout` with one row per sample and four
columns: PWM command (−255 to 255), temperature (°C), time (s), set-point (°C).

A **.csv** file has one line of column names, then one line per sample; columns are separated by commas,
semicolons or tabs; the decimal separator is the point. The four columns may be in any order, with others
between them; case and a unit in brackets do not matter in the names:

    time          t, seconds                     s
    reference     r, setpoint, set_point         °C
    temperature   y, temp                        °C
    pwm           u, command                     −255 to 255

A unit in brackets is checked: `temperature (K)` is refused, not converted.
"""

from __future__ import annotations

import csv
import re
from array import array
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np

from twinmatch.sessions.errors import RecordingError
from twinmatch.sessions.files import ProgressCallback, lines_of
from twinmatch.sessions.matlab import MAT_BEGINNING, read_matrix
from twinmatch.sessions.recordings import Columns, gather
from twinmatch.signals import Window

__all__ = ["MAT_BEGINNING", "RECORDING_SUFFIXES", "read_recording"]

RECORDING_SUFFIXES = (".mat", ".csv")
MATRIX = "simout"
MOST_ROWS = 10_000_000
"""Most samples of one recording, a day at 100 Hz: in memory they take 2.5 GB."""

_NAMES = {
    "time": ("time", "t", "seconds"),
    "reference": ("reference", "r", "setpoint", "set_point"),
    "temperature": ("temperature", "y", "temp"),
    "pwm": ("pwm", "u", "command"),
}
_UNITS = {"time": ("s",), "reference": ("°c", "degc", "c"), "temperature": ("°c", "degc", "c"), "pwm": ()}
_NAME = re.compile(r"^\s*(?P<name>[^(\[]*?)\s*(?:[(\[]\s*(?P<unit>[^)\]]*?)\s*[)\]])?\s*$")


def read_recording(path: Path | str, progress: ProgressCallback | None = None) -> Window:
    """Read a recording as one window; its samples are counted from 0.

    Args:
        path: a `.mat` or `.csv` file as this module describes them.
        progress: called with the amount read and the total.

    Raises:
        RecordingError: the file does not exist, is not a recording, lacks columns, or has values or times
            that cannot be used.
    """
    path = Path(path)
    try:
        if path.is_dir():
            msg = f"recording {path}: is a folder; give the file in it"
            raise RecordingError(msg)
        path.stat()
        suffix = path.suffix.lower()
        if suffix not in RECORDING_SUFFIXES:
            endings = " or ".join(RECORDING_SUFFIXES)
            msg = f"recording {path}: has the suffix {suffix!r}; a recording has {endings}"
            raise RecordingError(msg)
        return _read_mat(path) if suffix == ".mat" else _read_csv(path, progress)
    except FileNotFoundError:
        msg = f"recording {path}: does not exist"
        raise RecordingError(msg) from None
    except OSError as error:
        msg = f"recording {path}: cannot be read ({error.strerror or error})"
        raise RecordingError(msg) from error


def _read_mat(path: Path) -> Window:
    matrix = read_matrix(path, MATRIX, len(Columns._fields), MOST_ROWS)
    if not (isinstance(matrix, np.ndarray) and matrix.dtype.kind in "fiu"):
        msg = f"recording {path}: {MATRIX} is not a matrix of real numbers; log it as an array"
        raise RecordingError(msg)
    pwm, temperature, time, reference = np.asarray(matrix, dtype=np.float64).T
    return gather(Columns(time, reference, temperature, pwm), path.name, lambda i: f"row {i + 1}")


def _read_csv(path: Path, progress: ProgressCallback | None) -> Window:
    lines = lines_of(path, progress)
    try:
        first = next(lines, None)
        if first is None:
            msg = f"recording {path}: is empty"
            raise RecordingError(msg)
        divider = max(",;\t", key=first.count)
        rows = csv.reader(chain([first], lines), delimiter=divider)
        places = _places(next(rows), path)
        numbers, values = _values(rows, places, path)
    except UnicodeDecodeError:
        msg = f"recording {path}: is not UTF-8 text; save it as UTF-8"
        raise RecordingError(msg) from None
    except csv.Error as error:
        msg = f"recording {path}: cannot be read as a table ({error})"
        raise RecordingError(msg) from None
    table = np.frombuffer(values, dtype=np.float64).reshape(-1, len(places))
    return gather(Columns(*table.T), path.name, lambda i: f"line {numbers[i]}")


def _places(header: list[str], path: Path) -> list[int]:
    """Positions of the columns in the order of `Columns`."""
    found: dict[str, int] = {}
    for place, title in enumerate(header):
        match = _NAME.match(title.lower())
        column = next((c for c, names in _NAMES.items() if match and match["name"] in names), None)
        if column is None or match is None:
            continue
        if match["unit"] and match["unit"] not in _UNITS[column]:
            unit = {"time": "s", "pwm": "steps of −255 to 255, without unit"}.get(column, "°C")
            msg = f"recording {path}: column {title.strip()!r}: give {column} in {unit}"
            raise RecordingError(msg)
        if column in found:
            msg = (
                f"recording {path}: columns {header[found[column]]!r} and {title!r} are both {column}; "
                "rename or remove one"
            )
            raise RecordingError(msg)
        found[column] = place
    missing = [column for column in Columns._fields if column not in found]
    if missing:
        titles = ", ".join(repr(title.strip()[:40]) for title in header[:20])
        msg = (
            f"recording {path}: has no column {' and no column '.join(missing)}; its first line has {titles}"
        )
        raise RecordingError(msg)
    return [found[column] for column in Columns._fields]


def _values(rows: Iterator[list[str]], places: list[int], path: Path) -> tuple[array[int], array[float]]:
    """Line numbers of the non-blank rows, and their values, row by row."""
    numbers, values = array("q"), array("d")
    for number, row in enumerate(rows, start=2):
        if not "".join(row).strip():
            continue
        if len(numbers) == MOST_ROWS:
            msg = f"recording {path}: has more than {MOST_ROWS} rows; split it into parts"
            raise RecordingError(msg)
        numbers.append(number)
        for column, place in zip(Columns._fields, places, strict=True):
            text = row[place] if place < len(row) else ""
            try:
                values.append(float(text))
            except ValueError:
                msg = f"recording {path}: {column} in line {number} is {text[:40]!r}, which is not a number"
                raise RecordingError(msg) from None
    return numbers, values
