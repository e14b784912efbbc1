"""Annotated CSV, as InfluxDB exports it: tables one below the other, each with annotations and own names.

The annotations are lines that begin with `#datatype`, `#group` and `#default`; the line after them has the
names. The tables become one, with the columns of all.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final

from twinmatch.importing.heads import Line, line_of

__all__ = ["is_annotation", "joined_tables"]

_ANNOTATIONS: Final = ("#datatype", "#group", "#default", "#constant", "#timezone")


def is_annotation(text: str) -> bool:
    """Whether a line is an annotation."""
    return text.lstrip().lower().startswith(_ANNOTATIONS)


def joined_tables(all_lines: Callable[[], Iterable[Line]]) -> Iterator[Line]:
    """One line of names, then the rows of all tables.

    `all_lines` gives the lines of the file that are not empty, from the first on; it is called twice.
    """
    titles: dict[str, None] = {}
    first_place = 0
    for line, _ in _with_names(all_lines()):
        if not first_place:
            first_place = line.place
        titles.update(dict.fromkeys(_cells(line.text)))
    yield line_of(first_place, titles)
    for names_line, rows in _with_names(all_lines()):
        yield from _rearranged(_cells(names_line.text), list(titles), rows)


def _with_names(lines: Iterable[Line]) -> Iterator[tuple[Line, Iterator[Line]]]:
    """The line of names of each table, with its rows."""
    remaining = iter(lines)
    names = _next_names(remaining)
    while names is not None:
        ended: list[Line] = []

        def rows(ended: list[Line] = ended) -> Iterator[Line]:
            for line in remaining:
                if is_annotation(line.text):
                    ended.append(line)
                    return
                if line.text.lstrip()[:1] != "#":
                    yield line

        table_rows = rows()
        yield names, table_rows
        for _ in table_rows:
            pass
        names = _next_names(remaining) if ended else None


def _next_names(lines: Iterator[Line]) -> Line | None:
    return next((line for line in lines if line.text.lstrip()[:1] != "#"), None)


def _rearranged(
    names: Sequence[str], titles: Sequence[str], rows: Iterator[Line]
) -> Iterator[Line]:
    """The rows of a table with these names, for a table with these titles."""
    if list(names) == list(titles):
        yield from rows
        return
    places = {name: place for place, name in enumerate(names)}
    for line in rows:
        cells = _cells(line.text)
        arranged = []
        for title in titles:
            place = places.get(title, len(cells))
            arranged.append(cells[place] if place < len(cells) else "")
        yield line_of(line.place, arranged)


def _cells(text: str) -> list[str]:
    return next(csv.reader([text]), [])
