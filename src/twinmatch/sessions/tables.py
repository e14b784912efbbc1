"""Tables of other programs, with whatever columns they have: `.csv` and MATLAB `.mat`.

A **.csv** file has a line of column names, then a line per row. Columns are divided by commas, semicolons or
tabs; lines that begin with `#` are passed over. Where commas do not divide the columns, they may be the
decimal points. `true`, `on` and `yes` are 1, `false`, `off` and `no` 0; an empty cell, `nan` and `null` are
nothing.

A **.mat** file (MATLAB version 5, 6 or 7) has a column for each vector in it, called as the variable, and for
each column of a matrix, called `name[1]`, `name[2]` and so on.
"""

from __future__ import annotations

import csv
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twinmatch.sessions.errors import RecordingError
from twinmatch.sessions.files import lines_of, open_regular
from twinmatch.signals import FloatArray

__all__ = ["Table", "number", "read_table", "split_title"]

MOST_BYTES = 500_000_000
"""Of a file; what is larger is no recording of a loop, or better cut before it is imported."""
_WORDS = {
    **dict.fromkeys(("true", "on", "yes"), 1.0),
    **dict.fromkeys(("false", "off", "no"), 0.0),
    **dict.fromkeys(("", "nan", "na", "n/a", "null", "none", "-"), math.nan),
}
_TITLE = re.compile(r"^(?P<name>.*?)\s*[(\[]\s*(?P<unit>[^()\[\]]*(?:\([^()]*\))?[^()\[\]]*)\s*[)\]]$")


@dataclass(frozen=True)
class Table:
    """Columns of equal length as they were written."""

    path: Path
    columns: Mapping[str, Sequence[str] | FloatArray]
    """By title: texts of a .csv, numbers of a .mat. Titles are as in the file, without blanks around them."""
    lines: Sequence[int]
    """Where each row stands in the file, from 1."""
    row: str = "line"
    """What the file's owner calls a row."""
    decimal: str = "."

    def find(self, name: str) -> str:
        """The title of the column that is meant: case and a unit in brackets need not be written.

        Raises:
            RecordingError: there is none, or there are several.
        """
        wanted = name.strip()
        if wanted in self.columns:
            return wanted
        low = wanted.lower()
        for form in (str.lower, lambda title: split_title(title)[0].lower()):
            found = [title for title in self.columns if form(title) == low]
            if len(found) == 1:
                return found[0]
            if found:
                msg = f"{self.path}: {name!r} may be {' or '.join(map(repr, found))}; write it out"
                raise RecordingError(msg)
        titles = ", ".join(repr(title[:40]) for title in list(self.columns)[:30]) or "none"
        msg = f"{self.path}: has no column {name!r}; it has {titles}"
        raise RecordingError(msg)

    def values(self, title: str) -> FloatArray:
        """The numbers of a column, shape (N,); nan where a cell has none.

        Raises:
            RecordingError: a cell holds something else.
        """
        column = self.columns[title]
        if isinstance(column, np.ndarray):
            return column
        values = np.empty(len(column))
        for k, text in enumerate(column):
            value = number(text, self.decimal)
            if value is None:
                msg = f"{self.place(k)}: {title!r} is {text.strip()[:40]!r}, which is not a number"
                raise RecordingError(msg)
            values[k] = value
        return values

    def unit(self, title: str) -> str:
        """The unit that a column's title has in brackets; variables of a .mat have none."""
        return "" if isinstance(self.columns[title], np.ndarray) else split_title(title)[1]

    def place(self, k: int) -> str:
        """Where the k-th row is, for messages."""
        return f"{self.path}, {self.row} {self.lines[k]}"


def split_title(title: str) -> tuple[str, str]:
    """Name and unit of a column: `Temperature 1 (degC)` has both."""
    match = _TITLE.match(title.strip())
    return (match["name"].strip(), match["unit"].strip()) if match else (title.strip(), "")


def number(text: str, decimal: str = ".") -> float | None:
    """The number in a cell, nan for none; None if it holds something else."""
    plain = text.strip().lower()
    if plain in _WORDS:
        return _WORDS[plain]
    try:
        return float(plain.replace(",", ".") if decimal == "," else plain)
    except ValueError:
        return None


def read_table(path: Path) -> Table:
    """The columns of a file.

    Raises:
        RecordingError: no such file, no table, or a damaged one.
    """
    suffix = path.suffix.lower()
    try:
        with open_regular(path) as file:
            if os.fstat(file.fileno()).st_size > MOST_BYTES:
                msg = f"{path}: has more than {MOST_BYTES / 1e6:.0f} MB; cut it into parts first"
                raise RecordingError(msg)
        if suffix in (".csv", ".txt", ".tsv"):
            return _read_csv(path)
        if suffix == ".mat":
            return _read_mat(path)
    except FileNotFoundError:
        msg = f"{path}: does not exist"
        raise RecordingError(msg) from None
    except OSError as error:
        msg = f"{path}: cannot be read ({error.strerror or error})"
        raise RecordingError(msg) from error
    msg = f"{path}: a table's name ends in .csv or .mat; save it as one of these"
    raise RecordingError(msg)


def _read_csv(path: Path) -> Table:
    try:
        text = list(lines_of(path))
    except UnicodeDecodeError:
        msg = f"{path}: is no text in UTF-8; save it as UTF-8"
        raise RecordingError(msg) from None
    held = [(k, line) for k, line in enumerate(text, 1) if line.strip(" ,;\t") and line.lstrip()[:1] != "#"]
    if len(held) < 3:
        msg = f"{path}: has {len(held)} lines; a table has column names and at least two rows"
        raise RecordingError(msg)
    lines, rows = zip(*held, strict=True)
    divider = max(",;\t", key=rows[0].count)
    try:
        titles, *cells = csv.reader(rows, delimiter=divider, skipinitialspace=True)
    except csv.Error as error:
        msg = f"{path}: is no table ({error})"
        raise RecordingError(msg) from None
    if len(cells) != len(rows) - 1:
        msg = f"{path}: a quoted cell runs over several lines; write it without line breaks"
        raise RecordingError(msg)
    for k, row in enumerate(cells):
        if len(row) > len(titles):
            msg = (
                f"{path}, line {lines[k + 1]}: has {len(row)} cells, but line {lines[0]} has {len(titles)} "
                "column names; remove lines before the names, or begin them with #"
            )
            raise RecordingError(msg)
        row.extend([""] * (len(titles) - len(row)))
    if all(number(title, ".") is not None for title in titles):
        msg = f"{path}, line {lines[0]}: holds numbers; the first line has to name the columns"
        raise RecordingError(msg)
    columns = dict(zip(_distinct(titles), zip(*cells, strict=True), strict=True))
    return Table(path, columns, lines[1:], decimal="." if divider == "," else _decimal(cells))


def _decimal(rows: Sequence[Sequence[str]]) -> str:
    """Which character divides a number from its decimals, where commas do not divide the columns."""
    return "," if any(re.fullmatch(r"\s*-?\d+,\d+\s*", cell) for row in rows[:50] for cell in row) else "."


def _distinct(titles: Sequence[str]) -> list[str]:
    """Titles with a number behind those that stand there twice, and for those that are empty."""
    distinct: list[str] = []
    for k, title in enumerate(titles, 1):
        plain = title.strip() or f"column {k}"
        distinct.append(f"{plain} #{k}" if plain in distinct else plain)
    return distinct


def _read_mat(path: Path) -> Table:
    from scipy.io import loadmat  # noqa: PLC0415 (a quarter of a second that others can do without)

    with open_regular(path) as file:
        if file.read(19).startswith(b"MATLAB 7.3"):
            msg = f"{path}: is a MATLAB 7.3 file; save it again with the option -v7"
            raise RecordingError(msg)
    try:
        held: dict[str, Any] = loadmat(path)
    except Exception as error:  # what the library meets in damaged bytes has many names
        msg = f"{path}: is no MATLAB file of version 5 to 7, or damaged ({error})"
        raise RecordingError(msg) from error
    found: dict[str, FloatArray] = {}
    for name, array in held.items():
        if (
            isinstance(array, np.ndarray)
            and array.ndim == 2
            and array.dtype.kind in "fiub"
            and array.size > 1
        ):
            if 1 in array.shape:
                found[name] = array.ravel().astype(np.float64)
            else:
                found |= {f"{name}[{k}]": c.astype(np.float64) for k, c in enumerate(array.T, 1)}
    length = max((column.size for column in found.values()), default=0)
    columns = {name: column for name, column in found.items() if column.size == length}
    if not columns:
        msg = f"{path}: holds no vector and no matrix of real numbers; save the signals as arrays"
        raise RecordingError(msg)
    return Table(path, columns, range(1, length + 1), row="row")
