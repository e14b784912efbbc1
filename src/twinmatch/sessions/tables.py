"""Tables of other programs, with any columns: `.csv` and MATLAB `.mat`.

A **.csv** file has a line of column names, perhaps a line of their units, then a line per row. Columns are
separated by commas, semicolons or tabs, or by what a first line `sep=…` says; lines that begin with `#` are
ignored. Where commas do not separate columns, they may be decimal
separators. `true`, `on` and `yes` are 1, `false`, `off` and `no` 0; an empty cell, `nan` and `null` have no
value.

A **.mat** file (MATLAB version 5, 6 or 7) gives a column for each vector, with the variable's name, and for
each column of a matrix, with the names `name[1]`, `name[2]` and so on.
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
from twinmatch.sessions.files import open_regular
from twinmatch.sessions.table_text import table_text
from twinmatch.signals import FloatArray
from twinmatch.units import measure

__all__ = ["Table", "number", "read_table", "split_title"]

MOST_BYTES = 500_000_000
"""Largest file; anything larger is not a recording of a loop, or should be split before the import."""
_WORDS = {
    **dict.fromkeys(("true", "on", "yes"), 1.0),
    **dict.fromkeys(("false", "off", "no"), 0.0),
    **dict.fromkeys(("", "nan", "na", "n/a", "null", "none", "-"), math.nan),
}
_TITLE = re.compile(r"^(?P<name>.*?)\s*[(\[]\s*(?P<unit>[^()\[\]]*(?:\([^()]*\))?[^()\[\]]*)\s*[)\]]$")


@dataclass(frozen=True)
class Table:
    """Columns of equal length as written in a file."""

    path: Path
    columns: Mapping[str, Sequence[str] | FloatArray]
    """By title: texts of a .csv, numbers of a .mat. Titles are as in the file, stripped of spaces."""
    lines: Sequence[int]
    """Place of each row in the file, from 1."""
    row: str = "line"
    """Word for a row in messages."""
    decimal: str = "."

    def find(self, name: str) -> str:
        """The title of a column; case and a unit in brackets may be omitted in `name`.

        Raises:
            RecordingError: no column matches, or several do.
        """
        wanted = name.strip()
        if wanted in self.columns:
            return wanted
        names = {title: split_title(title)[0] for title in self.columns}
        for lowered, of in (
            (False, names.get),
            (True, str),
            (True, names.get),
        ):  # t and T (°C) are two columns
            found = [title for title in names if _same(str(of(title)), wanted, lowered=lowered)]
            if len(found) == 1:
                return found[0]
            if found:
                msg = f"{self.path}: {name!r} may be {' or '.join(map(repr, found))}; give its full title"
                raise RecordingError(msg)
        titles = ", ".join(repr(title[:40]) for title in list(self.columns)[:30]) or "none"
        msg = f"{self.path}: has no column {name!r}; it has {titles}"
        raise RecordingError(msg)

    def values(self, title: str) -> FloatArray:
        """The numbers of a column, shape (N,); nan for cells without a value.

        Raises:
            RecordingError: a cell has other text.
        """
        column = self.columns[title]
        if isinstance(column, np.ndarray):
            return column
        try:  # a column of plain numbers, as most are
            return np.fromiter(map(float, column), dtype=np.float64, count=len(column))
        except ValueError:
            pass
        values = np.empty(len(column))
        for k, text in enumerate(column):
            value = number(text, self.decimal)
            if value is None:
                msg = f"{self.place(k)}: {title!r} is {text.strip()[:40]!r}, which is not a number"
                if re.fullmatch(r"[-+\d.,'\s]+", text):
                    msg += "; write numbers without separators of thousands"
                raise RecordingError(msg)
            values[k] = value
        return values

    def unit(self, title: str) -> str:
        """The unit in brackets in a column's title; empty for variables of a .mat."""
        return "" if isinstance(self.columns[title], np.ndarray) else split_title(title)[1]

    def place(self, k: int) -> str:
        """Place of the k-th row, for messages."""
        return f"{self.path}, {self.row} {self.lines[k]}"


def _same(one: str, other: str, *, lowered: bool) -> bool:
    return one.lower() == other.lower() if lowered else one == other


def split_title(title: str) -> tuple[str, str]:
    """Name and unit of a column, such as `Temperature 1 (degC)`."""
    match = _TITLE.match(title.strip())
    return (match["name"].strip(), match["unit"].strip()) if match else (title.strip(), "")


def number(text: str, decimal: str = ".") -> float | None:
    """The number in a cell; nan without a value, None for other text."""
    plain = text.strip().lower()
    if plain in _WORDS:
        return _WORDS[plain]
    try:
        return float(plain.replace(",", ".") if decimal == "," else plain)
    except ValueError:
        return None


def read_table(path: Path) -> Table:
    """Read the columns of a file.

    Raises:
        RecordingError: the file does not exist, is not a table, or is damaged.
    """
    suffix = path.suffix.lower()
    try:
        with open_regular(path) as file:
            if os.fstat(file.fileno()).st_size > MOST_BYTES:
                msg = f"{path}: has more than {MOST_BYTES / 1e6:.0f} MB; split it into parts first"
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
    msg = f"{path}: is neither a .csv nor a .mat file; save it as one of these"
    raise RecordingError(msg)


def _read_csv(path: Path) -> Table:
    lines, rows, divider = table_text(path)
    try:
        titles, *cells = csv.reader(rows, delimiter=divider, skipinitialspace=True)
    except csv.Error as error:
        msg = f"{path}: cannot be read as a table ({error})"
        raise RecordingError(msg) from None
    if len(cells) != len(rows) - 1:
        msg = f"{path}: a quoted cell spans several lines; write it without line breaks"
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
        msg = f"{path}, line {lines[0]}: has numbers; the first line must name the columns"
        raise RecordingError(msg)
    titles, skipped = _with_units(titles, cells)
    cells, lines = cells[skipped:], lines[skipped:]
    columns = dict(zip(_distinct(titles), zip(*cells, strict=True), strict=True))
    return Table(path, columns, lines[1:], decimal="." if divider == "," else _decimal(cells))


def _with_units(titles: list[str], cells: list[list[str]]) -> tuple[list[str], int]:
    """Titles with the units of a line below the names, and the number of such lines, 0 or 1.

    Its cells begin with letters or symbols, some are known units, and the next line has numbers there.
    """
    units = [cell.strip() for cell in cells[0]]
    given = [k for k, unit in enumerate(units) if unit.lower() not in _WORDS]
    known = [bool(unit) and measure(unit).known for unit in units]
    texts = all(number(units[k], ",") is None and not units[k][0].isdigit() for k in given)
    if not texts or not any(known) or not any(number(cells[1][k], ",") is not None for k in given):
        return titles, 0
    both = zip(titles, units, known, strict=True)
    return [
        f"{title} ({unit})" if use and not split_title(title)[1] else title for title, unit, use in both
    ], 1


def _decimal(rows: Sequence[Sequence[str]]) -> str:
    """The decimal separator, where commas do not separate columns."""
    return "," if any(re.fullmatch(r"\s*-?\d+,\d+\s*", cell) for row in rows[:50] for cell in row) else "."


def _distinct(titles: Sequence[str]) -> list[str]:
    """Titles with a number appended to duplicates, and for empty ones."""
    distinct: list[str] = []
    for k, title in enumerate(titles, 1):
        plain = title.strip() or f"column {k}"
        distinct.append(f"{plain} #{k}" if plain in distinct else plain)
    return distinct


def _read_mat(path: Path) -> Table:
    from scipy.io import loadmat  # noqa: PLC0415 (takes 0.25 s, not needed for .csv)

    with open_regular(path) as file:
        if file.read(19).startswith(b"MATLAB 7.3"):
            msg = f"{path}: is a MATLAB 7.3 file; save it again with the option -v7"
            raise RecordingError(msg)
    try:
        held: dict[str, Any] = loadmat(path)
    except Exception as error:  # the library raises many kinds for damaged bytes
        msg = f"{path}: is not a MATLAB file of version 5 to 7, or is damaged ({error})"
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
        msg = f"{path}: has no vector or matrix of real numbers; save the signals as arrays"
        raise RecordingError(msg)
    return Table(path, columns, range(1, length + 1), row="row")
