"""The head of a table in a text file: what separates its cells, and which line has the column names.

Loggers write remarks above the names, put `#` before the names, write units below them, or no names at all. A
line of numbers and dates has no names: it is a row, and must not get lost as names.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from twinmatch.importing.cells import WORDS, number
from twinmatch.importing.dates import is_date
from twinmatch.sessions.files import RecordingError
from twinmatch.units import measure, quantity_in

__all__ = ["Head", "Line", "head_of", "split_title", "with_units"]

_SEPARATORS: Final = ",;\t"
_SEPARATOR_LINE: Final = re.compile(r"^\s*sep=(.)\s*$", re.IGNORECASE)
"""The line that names the separator for Excel."""
_TITLE: Final = re.compile(r"^(?P<name>.*?)[(\[](?P<unit>[^()\[\]]*(?:\([^()]*\)[^()\[\]]*)?)[)\]]$")
_LABELLED: Final = re.compile(r"[^:]*[^:\d\s][^:]*[:=]\s*[-+]?\d[\d.,]*\s*\S{0,5}")
"""A value behind its name, as in `Temp:20.5`."""
SPACES: Final = " "
"""Separator of tables whose cells have spaces between them, as many as the writer likes."""


class Line(NamedTuple):
    """A line of the file that is not empty."""

    place: int
    """From 1."""
    text: str


class Head(NamedTuple):
    """The beginning of a table."""

    separator: str
    lines: list[Line]
    """From the column names on."""
    notes: list[str]
    """Sentences on lines that are left out, or that are names behind a `#`."""


def head_of(path: Path, remarks: Sequence[Line], lines: Sequence[Line]) -> Head:
    """The head of a table.

    Args:
        path: the file.
        remarks: the lines before the first of `lines` that begin with `#`.
        lines: the first lines of the file that are neither empty nor remarks.

    Raises:
        RecordingError: no line has names.
    """
    named_separator = _SEPARATOR_LINE.match(lines[0].text) if lines else None
    if named_separator:
        lines = lines[1:]
    if len(lines) + bool(remarks) < 3:
        msg = f"{path}: give column names and at least two rows; the file has {len(lines)} lines of a table"
        raise RecordingError(msg)
    separator = named_separator[1] if named_separator else _separator_of(lines)
    first_row = _first_full_line(lines, separator)
    notes = []
    if first_row:
        above = f"Lines {lines[0].place} to" if first_row > 1 else "Line"
        notes.append(f"{above} {lines[first_row - 1].place} stand above the column names and are left out.")
        notes[0] = notes[0].replace("stand", "stands").replace("are", "is") if first_row == 1 else notes[0]
    table_lines = list(lines[first_row:])
    first_cells = _cells(table_lines[0].text, separator)
    if _has_names(first_cells):
        return Head(separator, table_lines, notes)
    names = [] if first_row else _commented_names(remarks, len(first_cells), separator)
    if not names:
        raise _without_names(path, table_lines[0].place, first_cells, separator)
    notes.append(f"The column names are those behind the # in line {names[0].place}.")
    return Head(separator, [*names, *table_lines], notes)


def _separator_of(lines: Sequence[Line]) -> str:
    """What separates cells: what is most frequent in the first line, or else what makes lines alike."""
    first = max(_SEPARATORS, key=lines[0].text.count)
    if _first_full_line(lines, first) == 0 and first in lines[0].text:
        return first
    alike = max(_SEPARATORS, key=lambda separator: _usual_width(lines, separator)[1])
    if _usual_width(lines, alike)[1]:
        return alike
    widths = {len(line.text.split()) for line in lines}
    return SPACES if len(widths) == 1 and min(widths) > 1 else first


def _usual_width(lines: Sequence[Line], separator: str) -> tuple[int, int]:
    """The most frequent number of cells, and how many lines have it; both 0 if it is one cell."""
    widths = Counter(len(_cells(line.text, separator)) for line in lines)
    width, count = widths.most_common(1)[0]
    return (width, count) if width > 1 else (0, 0)


def _first_full_line(lines: Sequence[Line], separator: str) -> int:
    """Place of the first line that is no narrower than most are, if only remarks may stand before it."""
    width, count = _usual_width(lines, separator)
    if 2 * count < len(lines):
        return 0
    widths = [len(_cells(line.text, separator)) for line in lines]
    place = next(k for k, other_width in enumerate(widths) if other_width >= width)
    return place if place + 2 < len(lines) else 0


def _cells(text: str, separator: str) -> list[str]:
    if separator == SPACES:
        return text.split()
    return next(csv.reader([text], delimiter=separator, skipinitialspace=True), [])


def _has_names(cells: Sequence[str]) -> bool:
    """Whether cells may be column names: none is a date, and not all are numbers."""
    filled = [cell for cell in cells if cell.strip()]
    if any(is_date(cell) for cell in filled):
        return False
    if filled and all(_LABELLED.fullmatch(cell.strip()) for cell in filled):
        return False
    is_value = [number(cell, ",") is not None or quantity_in(cell) is not None for cell in filled]
    if not is_value or all(is_value):
        return False
    return not (is_value[0] and 2 * sum(is_value) > len(is_value))


def _commented_names(remarks: Sequence[Line], width: int, separator: str) -> list[Line]:
    """The last remarks as lines of the table, if they have names for so many columns."""
    candidates: list[Line] = []
    for remark in reversed(remarks):
        text = remark.text.lstrip().lstrip("#").strip()
        if len(_cells(text, separator)) != width:
            break
        candidates.insert(0, Line(remark.place, text))
    while candidates and not _has_names(_cells(candidates[0].text, separator)):
        candidates.pop(0)
    return candidates[:2]


def _without_names(path: Path, place: int, cells: Sequence[str], separator: str) -> RecordingError:
    names = ["time", "output", "input"][: len(cells)]
    names += [f"other {k}" for k in range(1, len(cells) - 2)]
    what = "numbers" if all(number(cell, ",") is not None for cell in cells) else "values"
    return RecordingError(
        f"{path}, line {place}: has {what}; the first line must name the columns: write one above it, such "
        f"as {separator.join(names)}"
    )


def split_title(title: str) -> tuple[str, str]:
    """Name and unit of a column, such as `Temperature 1 (degC)`."""
    match = _TITLE.match(title.strip())
    return (match["name"].strip(), match["unit"].strip()) if match else (title.strip(), "")


def with_units(titles: list[str], cells: list[list[str]]) -> tuple[list[str], int]:
    """Titles with the units of a line below the names, and the number of such lines, 0 or 1.

    `cells` are those of the two lines below the titles. The first has units if its cells begin with letters
    or symbols, some are known units, and the second has numbers there.
    """
    below, next_line = cells
    units = [cell.strip().removeprefix("(").removesuffix(")") for cell in below]
    filled = [k for k, unit in enumerate(units) if unit.lower() not in WORDS]
    is_unit = [bool(unit) and measure(unit).known for unit in units]
    if not any(is_unit) or any(_begins_as_number(units[k]) for k in filled):
        return titles, 0
    if all(number(next_line[k], ",") is None for k in filled):
        return titles, 0
    titles_with_units = []
    for title, unit, is_known in zip(titles, units, is_unit, strict=True):
        has_unit = bool(split_title(title)[1])
        titles_with_units.append(f"{title} ({unit})" if is_known and not has_unit else title)
    return titles_with_units, 1


def _begins_as_number(text: str) -> bool:
    """Whether a cell is a number, or begins like one, as a date does."""
    return number(text, ",") is not None or text[0].isdigit()
