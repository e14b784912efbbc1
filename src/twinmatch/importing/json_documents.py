"""Rows within one JSON document, as servers answer with them.

A document may hold rows of values below their names (`columns` and `values`, as InfluxDB answers), series of times
with values (`metric` and `values`, as Prometheus answers), a list of values for each name, or objects in a list
somewhere (openHAB, ThingSpeak and most others).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

DEEPEST: Final = 20
"""How deep rows may stand within a document, and objects within a row."""
_FEWEST: Final = 2
"""Fewest objects of a list that are rows."""


def rows_in(document: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    """The rows in a document, each an object; empty if it has none."""
    tables = list(_objects_with(document, ("columns", "values"), DEEPEST))
    if tables:
        return _rows_below_names(tables)
    series = list(_objects_with(document, ("metric", "values"), DEEPEST))
    if series:
        return _rows_of_series(series)
    columns = next(_objects_of_columns(document, DEEPEST), None)
    if columns is not None:
        return [
            dict(zip(columns, cells, strict=True))
            for cells in zip(*columns.values(), strict=True)
        ]
    longest: Sequence[Mapping[str, Any]] = ()
    for rows in _lists_of_objects(document, DEEPEST):
        if len(rows) > len(longest):
            longest = rows
    return longest if len(longest) >= _FEWEST else ()


def _objects_with(
    value: object, keys: Sequence[str], depth: int
) -> Iterator[Mapping[str, Any]]:
    """The objects in a document that have these keys."""
    if not depth:
        return
    if isinstance(value, Mapping):
        if all(key in value for key in keys):
            yield value
            return
        for within in value.values():
            yield from _objects_with(within, keys, depth - 1)
    elif isinstance(value, list):
        for within in value:
            yield from _objects_with(within, keys, depth - 1)


def _lists_of_objects(
    value: object, depth: int
) -> Iterator[Sequence[Mapping[str, Any]]]:
    if not depth:
        return
    if isinstance(value, Mapping):
        for within in value.values():
            yield from _lists_of_objects(within, depth - 1)
    elif isinstance(value, list) and value:
        if all(isinstance(entry, Mapping) for entry in value):
            yield value
        for within in value[:1]:
            yield from _lists_of_objects(within, depth - 1)


def _objects_of_columns(
    value: object, depth: int
) -> Iterator[Mapping[str, Sequence[Any]]]:
    """The objects in a document that hold a list of as many values for each of two names or more."""
    if not depth or not isinstance(value, Mapping):
        return
    columns = {
        str(name): cells
        for name, cells in value.items()
        if isinstance(cells, list)
        and len(cells) >= _FEWEST
        and not any(isinstance(cell, list | Mapping) for cell in cells)
    }
    if len(columns) >= _FEWEST and len({len(cells) for cells in columns.values()}) == 1:
        yield columns
        return
    for within in value.values():
        yield from _objects_of_columns(within, depth - 1)


def _rows_below_names(
    tables: Sequence[Mapping[str, Any]],
) -> list[Mapping[str, Any]]:
    """Rows of values with the names of their columns; of several tables each with the name of its own."""
    rows: list[Mapping[str, Any]] = []
    for table in tables:
        names = [str(name) for name in table["columns"]]
        own_words = {}
        if len(tables) > 1:
            own_words["name"] = _series_name(table.get("tags"), table.get("name"))
        for values in table["values"]:
            if isinstance(values, list):
                cells = dict(zip(names, values, strict=False))
                rows.append(own_words | cells)
    return rows


def _rows_of_series(
    series: Sequence[Mapping[str, Any]],
) -> list[Mapping[str, Any]]:
    """A row for each time of each series: the time, the name of the series, and the value."""
    usual_names = []
    for a_series in series:
        metric = a_series["metric"]
        usual_names.append(
            metric.get("__name__") if isinstance(metric, Mapping) else None
        )
    counts = Counter(usual_names)
    rows: list[Mapping[str, Any]] = []
    for a_series, usual_name in zip(series, usual_names, strict=True):
        name = usual_name
        if usual_name is None or counts[usual_name] > 1:
            name = _series_name(a_series["metric"], usual_name)
        for pair in a_series["values"]:
            if isinstance(pair, list) and len(pair) == 2:
                rows.append({"time": pair[0], "name": name, "value": pair[1]})
    return rows


def _series_name(labels: object, name: object) -> str:
    """A name with the labels by which series of that name differ."""
    words = [] if name is None else [str(name)]
    if isinstance(labels, Mapping):
        words += [
            f"{key}={value}" for key, value in labels.items() if key != "__name__"
        ]
    return " ".join(words)
