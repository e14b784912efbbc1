"""Rows as JSON objects, one per line (JSON Lines), in one array or in one document, as scripts, flows and servers
write them.

They become a line of names and rows of cells: `{"ts": 1, "oven": {"temp": 20.5}}` has the columns `ts` and
`oven.temp`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Final

from twinmatch.importing.heads import Line, line_of
from twinmatch.importing.json_documents import DEEPEST, rows_in
from twinmatch.sessions.files import RecordingError

__all__ = ["begins_as_json", "table_of_objects"]

_KEYS_NAMED: Final = 5
"""Most names of an object that a message names."""


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
    yield _row(1, titles)
    for place, cells in _objects(path, all_lines()):
        yield _row(place, (cells.get(title, "") for title in titles))


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
        yield from _objects_of_document(path, whole)
        return
    decoded = _decoded(path, first.place, first.text)
    second = next(remaining, None)
    if second is None:
        yield from _objects_of_document(path, decoded)
        return
    yield first.place, _cells(path, first.place, decoded)
    for line in chain([second], remaining):
        yield (
            line.place,
            _cells(path, line.place, _decoded(path, line.place, line.text)),
        )


def _objects_of_document(
    path: Path, document: object
) -> Iterator[tuple[int, dict[str, str]]]:
    """The cells of the rows in one document, with the place of each among them."""
    entries = document if isinstance(document, list) else [document]
    if isinstance(document, Mapping):
        entries = [*rows_in(document)]
        if not entries:
            raise RecordingError(
                f"{path}: is one JSON object without rows in it ({_keys(document)}); write one object per "
                'line, such as {"time": 0, "T": 20}, or a list of them'
            )
    for place, entry in enumerate(entries, 1):
        yield place, _cells(path, place, entry)


def _keys(document: Mapping[str, object]) -> str:
    """The first names in an object."""
    return (
        f"it has {', '.join([*document][:_KEYS_NAMED])}" if document else "it is empty"
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
    return dict(_flattened("", entry, DEEPEST))


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


def _row(place: int, cells: Iterable[str]) -> Line:
    """The line of these cells, each in one line."""
    return line_of(place, (" ".join(cell.split()) for cell in cells))
