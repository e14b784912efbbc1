"""Rows in which each value has its name, such as `T:20.5,duty:40`, as sketches write them for a serial plotter.

They become a line of names and rows of cells. What stands before the first name is a time, if it is one, as serial
monitors put it there: `09:15:00.250 -> T=20.5 duty=40`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final

from twinmatch.importing.dates import clock_seconds, is_date
from twinmatch.importing.heads import FIRST_LINES, Line, line_of

__all__ = ["begins_labelled", "table_of_labels"]

_LABEL: Final = re.compile(
    r"(?P<name>[^\W\d][\w .()°%/-]{0,30}?)\s*[:=]\s*(?P<value>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
    r"(?P<unit>\s?(?:°[CF]|[CFKVAW]|%|mA|mV|Hz|rpm))?(?=[\s,;|]|$)"
)
_PAIR: Final = re.compile(r"[A-Za-z_][\w.-]*=[^\s=,;]+")
"""A name and any value, as in lines of `ts=2026-03-01T10:00:00Z level=info temp=20.5`."""
_BETWEEN: Final = " \t,;|"
_BEFORE: Final = " \t,;|->[]"
"""What may stand between cells, and between a time and the first of them."""
_FEWEST: Final = 2
"""Fewest values of a line."""


def begins_labelled(first_lines: Sequence[Line]) -> bool:
    """Whether each of the first lines gives the names of its values, and all give the same."""
    names = {tuple(_cells(line.text)) for line in first_lines}
    return len(first_lines) == FIRST_LINES and len(names) == 1 and any(names)


def table_of_labels(all_lines: Callable[[], Iterable[Line]]) -> Iterator[Line]:
    """One line of names, then a row for each line that has values; others are as they were.

    `all_lines` gives the lines of the file that are not empty, from the first on.
    """
    lines = iter(all_lines())
    first = next(lines)
    first_cells = _cells(first.text)
    titles = list(first_cells)
    yield line_of(first.place, titles)
    yield line_of(first.place, first_cells.values())
    for line in lines:
        cells = _cells(line.text)
        row = [cells.get(title, "") for title in titles]
        yield line_of(line.place, row) if any(row) else line


def _cells(text: str) -> dict[str, str]:
    """The values of a line by their names; empty if something else stands there, or fewer than two values."""
    words = text.split()
    if len(words) >= _FEWEST and all(_PAIR.fullmatch(word) for word in words):
        return dict(word.split("=", 1) for word in words)
    cells: dict[str, str] = {}
    end = 0
    for match in _LABEL.finditer(text):
        between = text[end : match.start()].strip(_BETWEEN if end else _BEFORE)
        if between and (end or not _is_time(between)):
            return {}
        if between:
            cells["time"] = between
        name = match["name"].strip()
        if name in cells:
            return {}
        cells[name] = match["value"] + (match["unit"] or "")
        end = match.end()
    is_whole = not text[end:].strip(_BETWEEN)
    values = len(cells) - ("time" in cells)
    return cells if is_whole and values >= _FEWEST else {}


def _is_time(text: str) -> bool:
    return is_date(text) or clock_seconds(text) is not None
