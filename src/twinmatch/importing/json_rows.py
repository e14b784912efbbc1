"""Rows as JSON objects, one per line (JSON Lines) or in one array, as scripts and flows log them.

They become a line of names and rows of cells: `{"ts": 1, "oven": {"temp": 20.5}}` has the columns `ts` and
`oven.temp`.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Final

from twinmatch.importing.heads import Line
from twinmatch.sessions.files import RecordingError

__all__ = ["begins_as_json", "table_of_objects"]

_DEEPEST: Final = 20
"""How deep objects may stand within objects."""


def begins_as_json(text: str) -> bool:
    """Whether a first line is that of JSON objects."""
    plain = text.strip()
    return plain in ("[", "{") or plain.startswith(("{", "[{"))


def table_of_objects(
    path: Path, all_lines: Callable[[], Iterable[Line]]
) -> Iterator[Line]:
    """One line of names, then a row for each object.

    `all_lines` gives the lines of the file that are not empty, from the first on; it is called twice.

    Raises:
        RecordingError: a line is not an object.
    """
    titles: dict[str, None] = {}
    for _, cells in _objects(path, all_lines()):
        titles.update(dict.fromkeys(cells))
    yield Line(1, _written(titles))
    for place, cells in _objects(path, all_lines()):
        yield Line(place, _written(cells.get(title, "") for title in titles))


def _objects(path: Path, lines: Iterable[Line]) -> Iterator[tuple[int, dict[str, str]]]:
    """The cells of each object by column, with the line, or the place in the array, of the object."""
    remaining = iter(lines)
    first = next(remaining)
    is_one_text = first.text.strip() in ("[", "{") or first.text.lstrip().startswith(
        "["
    )
    if is_one_text:
        text = "\n".join([first.text, *(line.text for line in remaining)])
        whole = _decoded(path, 1, text)
        for place, entry in enumerate(whole if isinstance(whole, list) else [whole], 1):
            yield place, _cells(path, place, entry)
        return
    yield (
        first.place,
        _cells(path, first.place, _decoded(path, first.place, first.text)),
    )
    for line in remaining:
        yield (
            line.place,
            _cells(path, line.place, _decoded(path, line.place, line.text)),
        )


def _decoded(path: Path, place: int, text: str) -> object:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RecordingError(
            f"{path}, line {place}: is not JSON ({error}); write one object per line, or all in one array"
        ) from None


def _cells(path: Path, place: int, entry: object) -> dict[str, str]:
    if not isinstance(entry, Mapping):
        raise RecordingError(
            f'{path}, row {place}: is not an object; each row must be one, such as {{"time": 0, "T": 20}}'
        )
    return dict(_flattened("", entry, _DEEPEST))


def _flattened(
    prefix: str, entry: Mapping[str, object], depth: int
) -> Iterator[tuple[str, str]]:
    """Names with dots and cells of an object and of those within it; lists are left out."""
    for name, value in entry.items():
        if isinstance(value, Mapping):
            if depth:
                yield from _flattened(f"{prefix}{name}.", value, depth - 1)
        elif not isinstance(value, list):
            yield f"{prefix}{name}", "" if value is None else str(value)


def _written(cells: Iterable[str]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="").writerow(
        " ".join(cell.split()) for cell in cells
    )
    return text.getvalue()
