"""The head of a table in a text file: what separates its cells, and which line has the column names.

Loggers write remarks above the names, put `#` before the names, write units below them, or no names at all. A
line of numbers and dates has no names: it is a row, and must not get lost as names.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from twinmatch.importing.cells import WORDS, number
from twinmatch.importing.dates import is_date
from twinmatch.sessions.files import RecordingError
from twinmatch.units import measure, quantity_in

__all__ = [
    "FIRST_LINES",
    "Head",
    "Line",
    "head_of",
    "line_of",
    "split_title",
    "with_units",
    "with_whole_quotes",
]

_SEPARATORS: Final = ",;\t"
_SEPARATOR_LINE: Final = re.compile(r"^\s*sep=(.)\s*$", re.IGNORECASE)
"""The line that names the separator for Excel."""
_TITLE: Final = re.compile(
    r"^(?P<name>.*?)[(\[](?P<unit>[^()\[\]]*(?:\([^()]*\)[^()\[\]]*)?)[)\]]$"
)
_UNIT_FIRST: Final = re.compile(r"[(\[](?P<unit>[^()\[\]]+)[)\]]\s*(?P<name>\S.*)")
"""A title with its unit before the name, as in `[°C] Probe 1`."""
_UNIT_THAT_SHOWS: Final = re.compile(r"[°º℃℉]\S{0,8}|%(?:rh)?|deg[cf]", re.IGNORECASE)
"""A unit that no title ends with for another reason, so that it needs no brackets."""
_LABELLED: Final = re.compile(r"[^:]*[^:\d\s][^:]*[:=]\s*[-+]?\d[\d.,]*\s*\S{0,5}")
"""A value behind its name, as in `Temp:20.5`."""
FIRST_LINES: Final = 3
"""Lines at the beginning of a file that show in what form it is written."""
SPACES: Final = " "
"""Separator of tables whose cells have spaces between them, as many as the writer likes."""


class Line(NamedTuple):
    """A line of the file that is not empty."""

    place: int
    """From 1."""
    text: str


def line_of(place: int, cells: Iterable[str]) -> Line:
    """The line of a table with these cells, separated by commas."""
    text = io.StringIO()
    csv.writer(text, lineterminator="").writerow(cells)
    return Line(place, text.getvalue())


class Head(NamedTuple):
    """The beginning of a table."""

    separator: str
    lines: list[Line]
    """From the column names on."""
    notes: list[str]
    """Sentences on lines that are left out, or that are names behind a `#`."""


def with_whole_quotes(lines: Sequence[Line]) -> list[Line]:
    """The first lines of a table, with names that are quoted over several lines in one.

    That is so if the first line leaves a quote open.
    """
    first_lines = list(lines)
    while len(first_lines) > 1 and first_lines[0].text.count('"') % 2:
        names, more, *rows = first_lines
        first_lines = [Line(names.place, f"{names.text} {more.text}"), *rows]
    return first_lines if len(first_lines) > 1 else list(lines)


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
        notes.append(
            f"{above} {lines[first_row - 1].place} stand above the column names and are left out."
        )
        notes[0] = (
            notes[0].replace("stand", "stands").replace("are", "is")
            if first_row == 1
            else notes[0]
        )
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
    rows = [_cells(line.text, separator) for line in lines]
    place = next(k for k, cells in enumerate(rows) if len(cells) >= width)
    first_values = _first_values(rows, width)
    if first_values:
        place = _best_names(rows[:first_values], width, default=place)
    return place if place + 2 < len(lines) else 0


def _first_values(rows: Sequence[Sequence[str]], width: int) -> int:
    """Place of the first of three rows of numbers and dates; 0 if there are none."""
    is_row = [len(cells) >= width and _is_row(cells) for cells in rows]
    return next((k for k in range(len(rows) - 2) if all(is_row[k : k + 3])), 0)


def _best_names(rows: Sequence[Sequence[str]], width: int, *, default: int) -> int:
    """Place of the line above the values that names most columns; of equal ones the first of their width.

    Remarks, units and kinds of columns may stand above and below the names.
    """
    places = [
        k for k, cells in enumerate(rows) if len(cells) >= width and _has_names(cells)
    ]
    named = [k for k in places if not _are_units(rows[k])]
    if not named:
        return default

    def worth(place: int) -> tuple[int, bool, int]:
        texts = {
            cell.strip()
            for cell in rows[place]
            if cell.strip()[:1] not in "+-.0123456789"
        }
        return min(len(texts), width), len(rows[place]) == width, -place

    return max(named, key=worth)


def _are_units(cells: Sequence[str]) -> bool:
    units = [cell.strip().strip("()[]") for cell in cells if cell.strip()]
    return all(unit.lower() in WORDS or measure(unit).known for unit in units)


def _is_row(cells: Sequence[str]) -> bool:
    """Whether most of the cells that are filled are numbers or dates."""
    filled = [cell for cell in cells if cell.strip()]
    values = [cell for cell in filled if number(cell, ",") is not None or is_date(cell)]
    return 2 * len(values) > len(filled)


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
    is_value = [
        number(cell, ",") is not None or quantity_in(cell) is not None
        for cell in filled
    ]
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


def _without_names(
    path: Path, place: int, cells: Sequence[str], separator: str
) -> RecordingError:
    names = ["time", "output", "input"][: len(cells)]
    names += [f"other {k}" for k in range(1, len(cells) - 2)]
    what = (
        "numbers" if all(number(cell, ",") is not None for cell in cells) else "values"
    )
    return RecordingError(
        f"{path}, line {place}: has {what}; the first line must name the columns: write one above it, such "
        f"as {separator.join(names)}"
    )


def split_title(title: str) -> tuple[str, str]:
    """Name and unit of a column, such as `Temperature 1 (degC)` or `Temp, °C (LGR S/N: 20512345)`."""
    match = _TITLE.match(title.strip())
    if match is None:
        return _split_after_unit(title.strip())
    name = match["name"].strip()
    unit = match["unit"].strip()
    before_comma, comma, after_comma = name.rpartition(",")
    if comma and not measure(unit).known and measure(after_comma.strip()).known:
        return before_comma.strip(), after_comma.strip()
    return name, unit


def _split_after_unit(title: str) -> tuple[str, str]:
    """Name and unit of a column whose unit stands first; as `_split_before_unit` if it has another form."""
    match = _UNIT_FIRST.fullmatch(title)
    if match is None or not measure(match["unit"].strip()).known:
        return _split_before_unit(title)
    return match["name"], match["unit"].strip()


def _split_before_unit(title: str) -> tuple[str, str]:
    """Name and unit of a column that ends with a unit without brackets, as `room °C` does; no unit if it has
    another form."""
    name, _, unit = title.replace("_", " ").rpartition(" ")
    has_letters = any(character.isalpha() for character in name)
    if not has_letters or _UNIT_THAT_SHOWS.fullmatch(unit) is None:
        return title, ""
    return (
        (title[: len(name)].rstrip(" _"), unit) if measure(unit).known else (title, "")
    )


def with_units(titles: list[str], cells: list[list[str]]) -> tuple[list[str], int]:
    """Titles with the units of a line below the names, and the number of such lines, 0 or 1.

    `cells` are those of the lines below the titles. The first has units if its cells begin with letters
    or symbols, some are known units, and a further one has numbers there.
    """
    below, *further_lines = cells
    units = [cell.strip().removeprefix("(").removesuffix(")") for cell in below]
    filled = [k for k, unit in enumerate(units) if unit.lower() not in WORDS]
    is_unit = [bool(unit) and measure(unit).known for unit in units]
    if not any(is_unit) or any(_begins_as_number(units[k]) for k in filled):
        return titles, 0
    if not any(
        number(cells[k], ",") is not None for cells in further_lines for k in filled
    ):
        return titles, 0
    titles_with_units = []
    for title, unit, is_known in zip(titles, units, is_unit, strict=True):
        has_unit = bool(split_title(title)[1])
        titles_with_units.append(
            f"{title} ({unit})" if is_known and not has_unit else title
        )
    return titles_with_units, 1


def _begins_as_number(text: str) -> bool:
    """Whether a cell is a number, or begins like one, as a date does."""
    return number(text, ",") is not None or text[0].isdigit()
