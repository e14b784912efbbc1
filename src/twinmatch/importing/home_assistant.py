"""The recorder's database of Home Assistant (`home-assistant_v2.db`, SQLite) as a table of many series.

Each row of `states` is a new state of an entity. Numbers and words in the attributes of thermostats become
series, too: `climate.bath.current_temperature`. A state holds until the next one.
"""

from __future__ import annotations

import json
import math
import sqlite3
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from twinmatch.importing.bag_files import database_at
from twinmatch.importing.cells import number
from twinmatch.importing.dates import from_iso
from twinmatch.importing.stacked import taken_apart
from twinmatch.importing.tables import Table
from twinmatch.sessions.files import RecordingError, open_regular
from twinmatch.units import quantity_in

__all__ = ["is_database", "read_history"]

_SUFFIXES: Final = (".db", ".sqlite", ".sqlite3")
_BEGINNING: Final = b"SQLite format 3\x00"
_WITH_ATTRIBUTES: Final = ("climate.", "water_heater.", "humidifier.", "fan.", "cover.")
"""Entities whose attributes have what is measured and commanded."""
_ATTRIBUTES: Final = (
    "current_temperature",
    "temperature",
    "hvac_action",
    "current_humidity",
    "humidity",
    "percentage",
    "current_position",
)


class _EntityState(NamedTuple):
    """A new state of a series."""

    name: str
    text: str
    seconds: float
    """Since 1970."""


def is_database(path: Path) -> bool:
    """Whether a file is a database of SQLite, and not a bag."""
    if path.suffix.lower() not in _SUFFIXES:
        return False
    try:
        with open_regular(path) as file:
            return file.read(len(_BEGINNING)) == _BEGINNING
    except OSError:
        return False


def read_history(path: Path) -> Table:
    """The states of all entities that ever had a number, or a word for one.

    Raises:
        RecordingError: it is not a database of Home Assistant, or is damaged.
    """
    try:
        units: dict[str, str] = {}
        with database_at(path) as database:
            states = list(_states(database, units))
    except (sqlite3.Error, OSError) as error:
        raise RecordingError(
            f"{path}: cannot be read as the history of Home Assistant ({error}); give a copy of "
            "home-assistant_v2.db, made while it does not write"
        ) from error
    if not states:
        raise RecordingError(f"{path}: no entity of Home Assistant in it has a number")
    return taken_apart(_table(path, states), units)


def _states(
    database: sqlite3.Connection, units: dict[str, str]
) -> Iterator[_EntityState]:
    """All states of entities that have a number at least once, and those of their attributes.

    `units` is filled with the unit of each entity that states one.
    """
    rows_of: dict[str, list[_EntityState]] = {}
    for name, text, time, document in database.execute(_query_for(database)):
        seconds = _seconds(time)
        if name is None or seconds is None:
            continue
        rows_of.setdefault(name, []).append(_EntityState(name, str(text), seconds))
        content = _attributes(document) if name not in units else {}
        if content.get("unit_of_measurement"):
            units[name] = str(content["unit_of_measurement"])
        if str(name).startswith(_WITH_ATTRIBUTES):
            for attribute, value in _signals_in(content).items():
                series = f"{name}.{attribute}"
                rows_of.setdefault(series, []).append(
                    _EntityState(series, str(value), seconds)
                )
    for rows in rows_of.values():
        if any(_is_number(state.text) for state in rows):
            yield from rows


def _query_for(database: sqlite3.Connection) -> str:
    """The query for entity, state, time and attributes of all states, by what this version of Home Assistant keeps
    where.

    Raises:
        sqlite3.DatabaseError: it has no states.
    """
    columns = {str(row[1]) for row in database.execute("PRAGMA table_info(states)")}
    tables = {str(row[0]) for row in database.execute("SELECT name FROM sqlite_master")}
    if "state" not in columns:
        raise sqlite3.DatabaseError("it has no table of states")
    stamp = "last_updated_ts" if "last_updated_ts" in columns else "last_updated"
    attributes = "states.attributes" if "attributes" in columns else "''"
    entity = "states.entity_id"
    joined = ""
    if "states_meta" in tables:
        entity = "states_meta.entity_id"
        joined = "JOIN states_meta ON states_meta.metadata_id = states.metadata_id"
    if "state_attributes" in tables:
        attributes = "state_attributes.shared_attrs"
        joined += " LEFT JOIN state_attributes ON state_attributes.attributes_id = states.attributes_id"
    return f"SELECT {entity}, states.state, states.{stamp}, {attributes} FROM states {joined}"  # noqa: S608


def _attributes(document: Any) -> dict[str, Any]:
    """The attributes of a state, from their JSON; none if it cannot be read."""
    try:
        content = json.loads(document or "{}")
    except (TypeError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _signals_in(attributes: dict[str, Any]) -> dict[str, Any]:
    """The attributes that are signals."""
    return {
        name: attributes[name]
        for name in _ATTRIBUTES
        if attributes.get(name) is not None
    }


def _seconds(time: Any) -> float | None:
    return float(time) if isinstance(time, int | float) else from_iso(str(time))


def _is_number(text: str) -> bool:
    value = number(text)
    if value is None:
        return quantity_in(text) is not None
    return math.isfinite(value)


def _table(path: Path, states: list[_EntityState]) -> Table:
    """The table of these states, one row for each."""
    values = array("d")
    value_texts: dict[int, str] = {}
    for row, state in enumerate(states):
        value = number(state.text)
        if value is None:
            value_texts[row] = state.text
        values.append(math.nan if value is None else value)
    columns = {
        "entity_id": np.full(len(states), np.nan),
        "state": np.frombuffer(values),
        "last_updated": np.array([state.seconds for state in states]),
    }
    names = {row: state.name for row, state in enumerate(states)}
    texts = {"entity_id": names, "state": value_texts}
    return Table(path, columns, range(1, len(states) + 1), row="state", texts=texts)
