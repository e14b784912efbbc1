"""Tables of other programs, with any columns: text and MATLAB `.mat`.

A **text** file (`.csv`, `.txt`, `.log`, `.lvm`, …) has a line of column names, perhaps a line of their
units, then a line per row; or it has a JSON object per row. Columns are separated by commas, semicolons,
tabs or spaces, or by what a first line `sep=…` says; lines that begin with `#` are ignored, unless the
names stand behind the last one. Numbers may have their unit behind them, as in `17.99 °C`. Where commas do
not separate columns, they may be decimal separators. `true`, `on` and `yes` are 1, `false`, `off` and `no`
0; an empty cell, `nan`, `null`, `unavailable` and `unknown` have no value. A row takes 8 bytes per column
of numbers in memory, however it is written.

Lines above the names and lines of text among the rows are left out, and named in the table's notes.

A **.mat** file (MATLAB version 5, 6 or 7) gives a column for each vector, with the variable's name, and for
each column of a matrix, with the names `name[1]`, `name[2]` and so on.
"""

from __future__ import annotations

import csv
import os
import re
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np

from twinmatch.importing.annotated import is_annotation, joined_tables
from twinmatch.importing.boxed_rows import begins_boxed, table_of_boxes
from twinmatch.importing.cells import Cells, number
from twinmatch.importing.heads import (
    FIRST_LINES,
    SPACES,
    Line,
    head_of,
    split_title,
    with_units,
    with_whole_quotes,
)
from twinmatch.importing.json_rows import begins_as_json, table_of_objects
from twinmatch.importing.labelled_rows import begins_labelled, table_of_labels
from twinmatch.importing.matlab import read_matrices
from twinmatch.importing.message_logs import message_log
from twinmatch.importing.remarks import remark_rows
from twinmatch.sessions.files import (
    ProgressCallback,
    RecordingError,
    lines_of,
    open_regular,
)
from twinmatch.signals import FloatArray

__all__ = ["LIMITS", "TEXTS", "Table", "number", "read_table", "split_title"]

_BLOCK: Final = 4096
"""Lines that are read at once."""
_REMARKS_NAMED: Final = 3
"""Lines that are left out and named one by one."""
_LINES_BELOW: Final = 4
"""Lines below the names that are looked at for units: further ones may say what a column is."""
_HEAD_LINES: Final = 53
"""First lines, from which separators, units and decimal separator are found."""
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
TEXTS: Final = frozenset(
    {
        ".csv",
        ".tsv",
        ".txt",
        ".dat",
        ".log",
        ".asc",
        ".prn",
        ".lvm",
        ".json",
        ".jsonl",
        ".ndjson",
    }
)
"""Suffixes of tables that are text, in small letters."""
_POINT: Final = re.compile(r"\s*[-+]?[\d,]*\d\.\d+\s*")
"""A number with a decimal point: commas of the same table separate thousands."""
_ARCHIVE: Final = b"PK\x03\x04"
_WESTERN: Final = "cp1252"
"""What Windows programs write where they do not write UTF-8: `°` and `µ` are single bytes."""
_CONTROL: Final = re.compile(r"[\x00-\x08\x0e-\x1f\x7f\x81\x8d\x8f\x90\x9d]")
"""Characters that no text has; a file with them is binary, or has another encoding."""


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
    cell_units: Mapping[str, str] = field(default_factory=dict)
    """By title, the unit behind the numbers of a column, as in `17.99 °C`, or the unit of a series."""
    notes: tuple[str, ...] = ()
    """Sentences on lines that are left out, for the user."""

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
        raise RecordingError(
            f"{self.path}: has no column {name!r}; it has {self.titles}"
        )

    @property
    def titles(self) -> str:
        """The titles, for messages."""
        return (
            ", ".join(repr(title[:40]) for title in list(self.columns)[:30]) or "none"
        )

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
        """The unit in brackets in a column's title, or behind its numbers; empty without one."""
        in_title = split_title(title)[1] if self.units else ""
        return in_title or self.cell_units.get(title, "")

    def row_name(self, k: int) -> str:
        """What the k-th row is called within the file, such as `line 12`."""
        return f"{self.row} {self.lines[k]}"

    def place(self, k: int) -> str:
        """Place of the k-th row, for messages."""
        return f"{self.path}, {self.row_name(k)}"


def read_table(
    path: Path,
    progress: ProgressCallback | None = None,
    *,
    matrix: tuple[str, int] | None = None,
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
        if suffix in TEXTS:
            return _read_csv(path, first_bytes, progress)
        if suffix == ".mat":
            return _read_mat(path, matrix)
    except FileNotFoundError:
        raise RecordingError(f"{path}: does not exist") from None
    except OSError as error:
        raise RecordingError(
            f"{path}: cannot be read ({error.strerror or error})"
        ) from error
    raise RecordingError(
        f"{path}: has the suffix {path.suffix!r}; a table is text ({', '.join(sorted(TEXTS))}) or .mat"
    )


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


def _read_csv(
    path: Path, first_bytes: bytes, progress: ProgressCallback | None
) -> Table:
    """The table in UTF-8, in UTF-16 with a byte-order mark, or in the encoding of Western Windows."""
    if first_bytes == _ARCHIVE:
        raise RecordingError(
            f"{path}: is a ZIP archive, such as an Excel workbook; save the table as CSV"
        )
    for encoding in (_BYTE_ORDER_MARKS.get(first_bytes[:2], "utf-8-sig"), _WESTERN):
        try:
            remarks: list[Line] = []
            return _parse(path, _lines(path, encoding, progress, remarks), remarks)
        except UnicodeError:
            continue
        except csv.Error as error:
            raise RecordingError(
                f"{path}: cannot be read as a table ({error})"
            ) from None
    raise _not_text(path)


def _not_text(path: Path) -> RecordingError:
    return RecordingError(f"{path}: is not text in a known encoding; save it as UTF-8")


def _lines(
    path: Path, encoding: str, progress: ProgressCallback | None, remarks: list[Line]
) -> Iterator[Line]:
    """The lines that are not empty and not remarks; those before the first of them go into `remarks`."""

    def filled_lines() -> Iterator[Line]:
        for k, text in enumerate(lines_of(path, progress, encoding=encoding), 1):
            if _CONTROL.search(text):
                raise _not_text(path)
            if text.strip(" ,;\t"):
                yield Line(k, text)

    first_lines = list(islice(filled_lines(), FIRST_LINES))
    first_text = first_lines[0].text if first_lines else ""
    if is_annotation(first_text):
        yield from joined_tables(filled_lines)
        return
    if begins_as_json(first_text):
        yield from table_of_objects(path, filled_lines)
        return
    log = message_log(first_lines)
    if log is not None:
        raise RecordingError(f"{path}: is {log.text}; {log.way_out}")
    if begins_boxed(first_lines):
        yield from table_of_boxes(filled_lines())
        return
    if begins_labelled(first_lines):
        yield from table_of_labels(filled_lines)
        return
    is_first = True
    for line in filled_lines():
        if line.text.lstrip()[:1] != "#":
            is_first = False
            yield line
        elif is_first:
            remarks.append(line)
            del remarks[:-_HEAD_LINES]


def _parse(path: Path, lines: Iterator[Line], remarks: Sequence[Line]) -> Table:
    """The table in these lines; `remarks` are filled while the first of them is read."""
    first_lines = with_whole_quotes(list(islice(lines, _HEAD_LINES)))
    head = head_of(path, remarks, first_lines)
    separator = head.separator
    if separator == SPACES:
        separator = "\t"
        lines = _with_tabs(lines)
        head = head._replace(lines=list(_with_tabs(iter(head.lines))))
    (titles_line, titles), *beginning = _rows(path, iter(head.lines), separator)
    _check_titles(path, titles)
    titles, unit_lines = with_units(
        titles, [cells for _, cells in beginning[:_LINES_BELOW]]
    )
    decimal = _decimal([cells for _, cells in beginning], quoted=separator == ",")
    first_rows = beginning[unit_lines:]
    has_point = decimal == "." and any(
        _POINT.fullmatch(cell) for _, row in first_rows for cell in row
    )
    table_cells = Cells(len(titles), separator, decimal, thousands=has_point)
    table_cells.take_rows(first_rows)
    while block := list(islice(lines, _BLOCK)):
        if not table_cells.take_plain(block):
            table_cells.take_rows(
                _rows(path, iter(block), separator, header=(titles_line, len(titles)))
            )
    return _table_of(path, _distinct(titles), table_cells, head.notes)


def _with_tabs(lines: Iterator[Line]) -> Iterator[Line]:
    """Lines with a tab in place of all spaces between two cells."""
    for line in lines:
        yield Line(line.place, "\t".join(line.text.split()))


def _table_of(
    path: Path, titles: Sequence[str], cells: Cells, notes: Sequence[str]
) -> Table:
    """The table of these cells, without the rows that are remarks."""
    columns = cells.columns()
    all_texts = cells.texts
    places = cells.places
    remarks = remark_rows(titles, columns, all_texts)
    if remarks:
        notes = [
            *notes,
            *(_note(places[row], row, all_texts) for row in remarks[:_REMARKS_NAMED]),
        ]
        if len(remarks) > _REMARKS_NAMED:
            notes.append(
                f"{len(remarks) - _REMARKS_NAMED} further lines of text are left out."
            )
        kept = np.setdiff1d(np.arange(len(places)), remarks)
        columns = [column[kept] for column in columns]
        new_rows = dict(zip(kept.tolist(), range(kept.size), strict=True))
        all_texts = [
            {new_rows[row]: text for row, text in texts.items() if row in new_rows}
            for texts in all_texts
        ]
        places = array("q", [places[row] for row in kept])
    texts = {
        title: texts for title, texts in zip(titles, all_texts, strict=True) if texts
    }
    units = {
        title: unit for title, unit in zip(titles, cells.units, strict=True) if unit
    }
    return Table(
        path,
        dict(zip(titles, columns, strict=True)),
        places,
        texts=texts,
        cell_units=units,
        notes=tuple(notes),
    )


def _note(place: int, row: int, all_texts: Sequence[Mapping[int, str]]) -> str:
    """That a line is left out, with its first text."""
    text = next(texts[row].strip() for texts in all_texts if texts.get(row, "").strip())
    return f"Line {place} is not a row and is left out: {text[:60]!r}."


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
    path: Path,
    lines: Iterator[Line],
    separator: str,
    header: tuple[int, int] | None = None,
) -> Iterator[tuple[int, list[str]]]:
    """The cells of each line, as many as the column names, with its place.

    `header` is the number of the line with the column names, and how many they are; without it, they are in
    the first of these lines.
    """
    place = 0
    header_line, width = header or (0, 0)

    def texts() -> Iterator[str]:
        nonlocal place
        for place, line in lines:  # noqa: B007
            yield line

    reader = csv.reader(texts(), delimiter=separator, skipinitialspace=True)
    for count, cells in enumerate(reader, 1):
        if reader.line_num > count:
            raise RecordingError(
                f"{path}: a quoted cell spans several lines; write it without line breaks"
            )
        if count == 1 and header is None:
            header_line = place
            width = len(cells)
        if any(map(str.strip, cells[width:])):
            raise RecordingError(
                f"{path}, line {place}: has {len(cells)} cells, but line {header_line} has {width} "
                "column names; remove lines before the names, or begin them with #"
            )
        yield place, cells[:width] + [""] * (width - len(cells))


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
