"""Tables of other programs, with any columns: `.csv` and MATLAB `.mat`.

A **.csv** file has a line of column names, perhaps a line of their units, then a line per row. Columns are
separated by commas, semicolons or tabs, or by what a first line `sep=…` says; lines that begin with `#` are
ignored. Where commas do not separate columns, they may be decimal separators. `true`, `on` and `yes` are 1,
`false`, `off` and `no` 0; an empty cell, `nan` and `null` have no value. A row takes 8 bytes per column of
numbers in memory, however it is written.

A **.mat** file (MATLAB version 5, 6 or 7) gives a column for each vector, with the variable's name, and for
each column of a matrix, with the names `name[1]`, `name[2]` and so on.
"""

from __future__ import annotations

import csv
import math
import os
import re
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np

from twinmatch.importing.matlab import read_matrices
from twinmatch.sessions.files import ProgressCallback, RecordingError, lines_of, open_regular
from twinmatch.signals import FloatArray
from twinmatch.units import measure

_BLOCK: Final = 4096
"""Lines that are read at once."""
_HEAD_LINES: Final = 53
"""First lines, from which separators, units and decimal separator are found."""
_WORDS: Final = {
    **dict.fromkeys(("true", "on", "yes"), 1.0),
    **dict.fromkeys(("false", "off", "no"), 0.0),
    **dict.fromkeys(("", "nan", "na", "n/a", "null", "none", "-"), math.nan),
}
_TITLE: Final = re.compile(r"^(?P<name>.*?)[(\[](?P<unit>[^()\[\]]*(?:\([^()]*\)[^()\[\]]*)?)[)\]]$")
_BYTE_ORDER_MARKS: Final = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
"""Byte-order marks of encodings other than UTF-8."""


@dataclass(frozen=True)
class TableLimits:
    """How large a table may be; anything larger is not a recording of a loop."""

    size: int = 500_000_000
    """Of the file, bytes; a longer recording is to be split before the import."""
    columns: int = 2000
    """A file with more has its samples in columns."""
    title: int = 500
    """Longest title of a column, characters."""


LIMITS: Final = TableLimits()
_ARCHIVE: Final = b"PK\x03\x04"
_WESTERN: Final = "cp1252"
"""What Windows programs write where they do not write UTF-8: `°` and `µ` are single bytes."""
_CONTROL: Final = re.compile(r"[\x00-\x08\x0e-\x1f\x7f\x81\x8d\x8f\x90\x9d]")
"""Characters that no text has; a file with them is binary, or has another encoding."""
_SEPARATOR: Final = re.compile(r"^\s*sep=(.)\s*$", re.IGNORECASE)
"""The line that names the separator for Excel."""


@dataclass(frozen=True)
class Table:
    """Columns of equal length."""

    path: Path
    columns: Mapping[str, FloatArray]
    """Numbers by title, each of shape (N,); nan without a value. Titles are as in the file, stripped."""
    lines: Sequence[int]
    """Place of each row in the file, from 1."""
    row: str = "line"
    """Word for a row in messages."""
    texts: Mapping[str, Mapping[int, str]] = field(default_factory=dict)
    """By title, the cells that are not numbers by their row (from 0); they are nan among the numbers."""
    units: bool = True
    """Whether titles may end with a unit in brackets."""

    def find(self, name: str) -> str:
        """The title of a column; case and a unit in brackets may be omitted in `name`.

        Raises:
            RecordingError: no column matches, or several do.
        """
        wanted = name.strip()
        if wanted in self.columns:
            return wanted
        names = {title: split_title(title)[0] for title in self.columns}
        lower = wanted.lower()
        for titles in (  # from strict to lenient, since t and T (°C) may be two columns
            [title for title, short in names.items() if short == wanted],
            [title for title in names if title.lower() == lower],
            [title for title, short in names.items() if short.lower() == lower],
        ):
            if len(titles) == 1:
                return titles[0]
            if titles:
                msg = f"{self.path}: {name!r} may be {' or '.join(map(repr, titles))}; give its full title"
                raise RecordingError(msg)
        raise RecordingError(f"{self.path}: has no column {name!r}; it has {self.titles}")

    @property
    def titles(self) -> str:
        """The titles, for messages."""
        return ", ".join(repr(title[:40]) for title in list(self.columns)[:30]) or "none"

    def values(self, title: str) -> FloatArray:
        """The numbers of a column, shape (N,); nan for cells without a value.

        Raises:
            RecordingError: a cell has other text.
        """
        for k, text in self.texts.get(title, {}).items():
            msg = f"{self.place(k)}: {title!r} is {text.strip()[:40]!r}, which is not a number"
            if re.fullmatch(r"[-+\d.,'\s]+", text):
                msg += "; write numbers without separators of thousands"
            raise RecordingError(msg)
        return self.columns[title]

    def unit(self, title: str) -> str:
        """The unit in brackets in a column's title; empty for variables of a .mat."""
        return split_title(title)[1] if self.units else ""

    def row_name(self, k: int) -> str:
        """What the k-th row is called within the file, such as `line 12`."""
        return f"{self.row} {self.lines[k]}"

    def place(self, k: int) -> str:
        """Place of the k-th row, for messages."""
        return f"{self.path}, {self.row_name(k)}"


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


def read_table(
    path: Path, progress: ProgressCallback | None = None, *, matrix: tuple[str, int] | None = None
) -> Table:
    """Read the columns of a file.

    `progress` is called with the bytes of a .csv read so far and the total. `matrix` is the name and the
    number of columns of the only matrix wanted from a .mat.

    Raises:
        RecordingError: the file does not exist, is not a table, or is damaged.
    """
    suffix = path.suffix.lower()
    try:
        with open_regular(path) as file:
            first_bytes = file.read(4)
            if os.fstat(file.fileno()).st_size > LIMITS.size:
                msg = f"{path}: has more than {LIMITS.size / 1e6:.0f} MB; split it into parts first"
                raise RecordingError(msg)
        if suffix in (".csv", ".txt", ".tsv"):
            return _read_csv(path, first_bytes, progress)
        if suffix == ".mat":
            return _read_mat(path, matrix)
    except FileNotFoundError:
        raise RecordingError(f"{path}: does not exist") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror or error})") from error
    raise RecordingError(f"{path}: is neither a .csv nor a .mat file; save it as one of these")


def _read_mat(path: Path, matrix: tuple[str, int] | None) -> Table:
    columns: dict[str, FloatArray] = {}
    for name, array_ in read_matrices(path, *(matrix or ())).items():
        if matrix is None and 1 in array_.shape:
            columns[name] = array_.ravel()
        else:
            columns |= {f"{name}[{k}]": column for k, column in enumerate(array_.T, 1)}
    _check_titles(path, list(columns))
    length = max(column.size for column in columns.values())
    return Table(path, columns, range(1, length + 1), row="row", units=False)


def _read_csv(path: Path, first_bytes: bytes, progress: ProgressCallback | None) -> Table:
    """The table in UTF-8, in UTF-16 with a byte-order mark, or in the encoding of Western Windows."""
    if first_bytes == _ARCHIVE:
        raise RecordingError(f"{path}: is a ZIP archive, such as an Excel workbook; save the table as CSV")
    for encoding in (_BYTE_ORDER_MARKS.get(first_bytes[:2], "utf-8-sig"), _WESTERN):
        try:
            return _parse(path, _lines(path, encoding, progress))
        except UnicodeError:
            continue
        except csv.Error as error:
            raise RecordingError(f"{path}: cannot be read as a table ({error})") from None
    raise _not_text(path)


def _not_text(path: Path) -> RecordingError:
    return RecordingError(f"{path}: is not text in a known encoding; save it as UTF-8")


def _lines(path: Path, encoding: str, progress: ProgressCallback | None) -> Iterator[tuple[int, str]]:
    """The lines that are not empty and not comments, each with its number in the file, from 1."""
    for k, line in enumerate(lines_of(path, progress, encoding=encoding), 1):
        if _CONTROL.search(line):
            raise _not_text(path)
        if line.strip(" ,;\t") and line.lstrip()[:1] != "#":
            yield k, line


def _parse(path: Path, lines: Iterator[tuple[int, str]]) -> Table:
    """The table in these lines, each with its number in the file."""
    head = list(islice(lines, _HEAD_LINES))
    separator_line = _SEPARATOR.match(head[0][1]) if head else None
    if separator_line:
        head = head[1:]
    if len(head) < 3:
        msg = f"{path}: give column names and at least two rows; the file has {len(head)} lines of a table"
        raise RecordingError(msg)
    separator = separator_line[1] if separator_line else max(",;\t", key=head[0][1].count)
    (titles_line, titles), *beginning = _rows(path, iter(head), separator)
    _require_names(path, titles_line, titles, separator)
    _check_titles(path, titles)
    titles, unit_lines = _with_units(titles, [cells for _, cells in beginning[:2]])
    decimal = _decimal([cells for _, cells in beginning], quoted=separator == ",")
    table_cells = _Cells(len(titles), separator, decimal)
    table_cells.take_rows(beginning[unit_lines:])
    while block := list(islice(lines, _BLOCK)):
        if not table_cells.take_plain(block):
            table_cells.take_rows(_rows(path, iter(block), separator, header=(titles_line, len(titles))))
    distinct = _distinct(titles)
    columns = dict(zip(distinct, table_cells.columns(), strict=True))
    texts = {title: cells for title, cells in zip(distinct, table_cells.texts, strict=True) if cells}
    return Table(path, columns, table_cells.places, texts=texts)


def _require_names(path: Path, place: int, titles: Sequence[str], separator: str) -> None:
    """Refuse a first line of numbers only: the table has no column names."""
    if any(number(title) is None for title in titles):
        return
    names = ("time", "output", "input", *(f"other {k}" for k in range(1, 4)))[: len(titles)]
    raise RecordingError(
        f"{path}, line {place}: has numbers; the first line must name the columns: write "
        f"one above it, such as {separator.join(names)}"
    )


class _Cells:
    """The cells of a table, taken in row by row, or many plain rows at once."""

    def __init__(self, width: int, separator: str, decimal: str) -> None:
        """Begin without rows."""
        self.places = array("q")
        """The line of each row in the file."""
        self.texts: list[dict[int, str]] = [{} for _ in range(width)]
        """Of each column, the cells that are not numbers, by row."""
        self._numbers = [array("d") for _ in range(width)]
        self._separator = separator
        self._decimal = decimal
        self._empty = re.compile(rf"(^|{re.escape(separator)})(?={re.escape(separator)}|$)")

    def take_rows(self, rows: Iterable[tuple[int, list[str]]]) -> None:
        """Take rows of any cells, each with its place."""
        for place, cells in rows:
            for column, texts, text in zip(self._numbers, self.texts, cells, strict=True):
                try:
                    column.append(float(text))
                except ValueError:
                    value = number(text, self._decimal)
                    if value is None:
                        texts[len(self.places)] = text
                    column.append(math.nan if value is None else value)
            self.places.append(place)

    def take_plain(self, lines: Sequence[tuple[int, str]]) -> bool:
        """Take lines if all their cells are numbers or empty; return whether they are. If not, take none.

        NumPy reads them: much faster than `take_rows`, and digits become the same numbers as in Python.
        """
        texts = [line for _, line in lines]
        if self._decimal == "," and self._separator != ",":
            texts = [text.replace(",", ".") for text in texts]
        values = self._loaded(texts)
        if values is None:
            values = self._loaded([self._empty.sub(r"\1nan", text) for text in texts])
        if values is None:
            return False
        if values.shape != (len(lines), len(self._numbers)):
            return False
        for column, numbers in zip(self._numbers, values.T, strict=True):
            column.frombytes(numbers.tobytes())
        self.places.extend(place for place, _ in lines)
        return True

    def _loaded(self, texts: list[str]) -> FloatArray | None:
        """The numbers of plain lines, shape (lines, columns); None if a cell is not a number."""
        try:
            return np.loadtxt(texts, delimiter=self._separator, comments=None, ndmin=2)
        except ValueError:
            return None

    def columns(self) -> list[FloatArray]:
        """The numbers of each column; nan without one."""
        return [np.frombuffer(column) for column in self._numbers]


def _check_titles(path: Path, titles: Sequence[str]) -> None:
    if len(titles) > LIMITS.columns:
        raise RecordingError(
            f"{path}: has {len(titles)} columns, more than {LIMITS.columns}; give each sample its own row, "
            "or only the columns of one plant"
        )
    if (longest := max(map(len, titles), default=0)) > LIMITS.title:
        raise RecordingError(
            f"{path}: has a column title of {longest} characters; give at most {LIMITS.title}"
        )


def _rows(
    path: Path, lines: Iterator[tuple[int, str]], separator: str, header: tuple[int, int] | None = None
) -> Iterator[tuple[int, list[str]]]:
    """The cells of each line, as many as the column names, with its place.

    `header` is the number of the line with the column names, and how many they are; without it, they are in
    the first of these lines.
    """
    place = 0
    header_line, width = header or (0, 0)

    def texts() -> Iterator[str]:
        nonlocal place
        for place, line in lines:  # noqa: B007 - read below
            yield line

    reader = csv.reader(texts(), delimiter=separator, skipinitialspace=True)
    for count, cells in enumerate(reader, 1):
        if reader.line_num > count:
            raise RecordingError(f"{path}: a quoted cell spans several lines; write it without line breaks")
        if count == 1 and header is None:
            header_line = place
            width = len(cells)
        if any(map(str.strip, cells[width:])):
            raise RecordingError(
                f"{path}, line {place}: has {len(cells)} cells, but line {header_line} has {width} "
                "column names; remove lines before the names, or begin them with #"
            )
        yield place, cells[:width] + [""] * (width - len(cells))


def _with_units(titles: list[str], cells: list[list[str]]) -> tuple[list[str], int]:
    """Titles with the units of a line below the names, and the number of such lines, 0 or 1.

    `cells` are those of the two lines below the titles. The first has units if its cells begin with letters
    or symbols, some are known units, and the second has numbers there.
    """
    below, next_line = cells
    units = [cell.strip() for cell in below]
    filled = [k for k, unit in enumerate(units) if unit.lower() not in _WORDS]
    is_unit = [bool(unit) and measure(unit).known for unit in units]
    if not any(is_unit) or any(_begins_as_number(units[k]) for k in filled):
        return titles, 0
    if all(number(next_line[k], ",") is None for k in filled):
        return titles, 0
    with_units = []
    for title, unit, is_known in zip(titles, units, is_unit, strict=True):
        has_unit = bool(split_title(title)[1])
        with_units.append(f"{title} ({unit})" if is_known and not has_unit else title)
    return with_units, 1


def _begins_as_number(text: str) -> bool:
    """Whether a cell is a number, or begins like one, as a date does."""
    return number(text, ",") is not None or text[0].isdigit()


def _decimal(rows: Sequence[Sequence[str]], *, quoted: bool) -> str:
    """The decimal separator. A comma in a cell of a table that commas separate is `quoted`; if three digits
    follow it, it may separate thousands."""
    form = r"\s*-?\d+,(\d{1,2}|\d{4,})\s*" if quoted else r"\s*-?\d+,\d+\s*"
    return "," if any(re.fullmatch(form, cell) for row in rows for cell in row) else "."


def _distinct(titles: Sequence[str]) -> list[str]:
    """Titles with a number appended to duplicates, and for empty ones."""
    distinct: list[str] = []
    for k, title in enumerate(titles, 1):
        plain = title.strip() or f"column {k}"
        distinct.append(f"{plain} #{k}" if plain in distinct else plain)
    return distinct
