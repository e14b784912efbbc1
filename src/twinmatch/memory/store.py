"""The file of a memory: an SQLite database with one row for each session and structure."""

from __future__ import annotations

import json
import math
import os
import re
import sqlite3
import time
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from itertools import chain
from pathlib import Path
from textwrap import shorten
from typing import Any, Final

import msgspec

from twinmatch.controllers import LawComparison
from twinmatch.decoding import decoded, decoded_json
from twinmatch.memory.lesson import Lesson, MemoryFaultError, Span, in_order, natural

_APPLICATION: Final = 0x74776D6D
"""The file's `application_id`, "twmm": other programs' databases have another."""
VERSION: Final = 2
"""Version of the tables, kept as the file's `user_version`."""
WAIT: Final = 10.0
"""Longest time to wait for another writer, s."""
PATIENCE: Final = 10.0
"""Most processor time in a file, s; one of a million lessons takes a tenth of it."""
MOST: Final = 4000
"""Newest lessons that are read: those of some thousand sessions."""
_SUFFIX: Final = ".sqlite"
_TABLE: Final = f"""
CREATE TABLE lesson (
    session TEXT NOT NULL, name TEXT NOT NULL, plant TEXT NOT NULL, equations TEXT NOT NULL,
    rig TEXT NOT NULL, structure TEXT NOT NULL, began INTEGER NOT NULL, duration REAL NOT NULL,
    samples INTEGER NOT NULL,
    parameters TEXT NOT NULL, free TEXT NOT NULL, covariance TEXT NOT NULL, outputs TEXT NOT NULL,
    inputs TEXT NOT NULL, led INTEGER NOT NULL, chosen INTEGER NOT NULL, level TEXT NOT NULL,
    horizons TEXT NOT NULL, persistence_skill TEXT NOT NULL, arx_skill TEXT NOT NULL, fault_at INTEGER,
    PRIMARY KEY (session, plant, rig, structure, equations)
);
PRAGMA application_id = {_APPLICATION};
"""
_COMPARED: Final = tuple(field.name for field in fields(LawComparison))
_RECORD: Final = f"""
CREATE TABLE comparison ({", ".join(_COMPARED)}, PRIMARY KEY (session, plant, rig));
PRAGMA user_version = {VERSION};
"""
"""The second step: a row for each session in which a law ran that had been tried; NULL is not a number."""


class _Lists(msgspec.Struct):
    """The columns that hold JSON; null is not a number."""

    parameters: dict[str, float]
    free: tuple[str, ...]
    covariance: tuple[tuple[float, ...], ...]
    outputs: tuple[Span, ...]
    inputs: tuple[Span, ...]
    horizons: tuple[float, ...]
    persistence_skill: tuple[float | None, ...]
    arx_skill: tuple[float | None, ...]


_LISTS: Final = _Lists.__struct_fields__
_COLUMNS: Final = tuple(field.name for field in fields(Lesson))
_OTHERS: Final = tuple(name for name in _COLUMNS if name not in _LISTS)


class Memory:
    """What sessions have taught, in one file, which is created by the first `add`.

    Several programs may read and write it at once. A write is complete or has not happened, even if the
    program is killed in the middle of it.

    All methods raise `MemoryFaultError` if the file is not a memory, is damaged, was written by a newer
    version, or is locked; callers can do without it.
    """

    def __init__(self, path: Path) -> None:
        """Use this file; nothing is opened yet."""
        self.path = path

    def add(self, lessons: Iterable[Lesson]) -> int:
        """Add lessons, all or none; those that are there already stay. Returns how many are new."""
        rows = [_row_of(lesson) for lesson in lessons]
        if not rows:
            return 0
        names = ", ".join(_COLUMNS)
        places = ", ".join("?" * len(_COLUMNS))
        with self._opened(write=True, create=True) as database:
            before: int = database.total_changes
            database.executemany(
                f"INSERT OR IGNORE INTO lesson ({names}) VALUES ({places})",  # noqa: S608
                rows,
            )
            added: int = database.total_changes - before
        return added

    def lessons(
        self,
        plant: str | None = None,
        rig: str | None = None,
        equations: Collection[str] | None = None,
    ) -> list[Lesson]:
        """The lessons on this plant and rig, oldest session first; those given as None are not asked for.

        Args:
            plant: name of the plant.
            rig: name of the rig; an empty one is a rig without a name.
            equations: digests of equations, as `Model.equations`; lessons on others are left out.
        """
        wanted: dict[str, Collection[str]] = (
            {} if equations is None else {"equations": [*equations]}
        )
        if plant is not None:
            wanted["plant"] = [plant]
        if rig is not None:
            wanted["rig"] = [rig]
        conditions = [
            f"{name} IN ({', '.join('?' * len(values))})"
            for name, values in wanted.items()
        ]
        where = " AND ".join(conditions) or "1"
        lists = " || ',' || ".join(f"'\"{name}\":' || {name}" for name in _LISTS)
        newest = f"SELECT rowid FROM lesson WHERE {where} ORDER BY began DESC, in_order(name) DESC LIMIT {MOST}"  # noqa: S608
        query = f"SELECT {', '.join(_OTHERS)}, '{{' || {lists} || '}}' FROM lesson WHERE rowid IN ({newest})"  # noqa: S608
        with self._opened() as database:
            rows = (
                []
                if database is None
                else database.execute(query, [*chain(*wanted.values())])
            )
            return in_order([self._lesson_of(row) for row in rows])

    def unread(self, rig: str | None = None) -> int:
        """Number of lessons on a rig (None: on all) that are older than those that `lessons` reads."""
        with self._opened() as database:
            query = "SELECT count(*) FROM lesson WHERE rig = ifnull(?, rig)"
            (count,) = (
                (0,) if database is None else database.execute(query, [rig]).fetchone()
            )
        return max(0, count - MOST)

    def add_comparison(self, found: LawComparison) -> bool:
        """Keep what a session has shown of a prediction; the first one of a session stays. Returns whether it
        is new."""
        names = ", ".join(_COMPARED)
        places = ", ".join("?" * len(_COMPARED))
        row = [_plain(getattr(found, name)) for name in _COMPARED]
        with self._opened(write=True, create=True) as database:
            query = f"INSERT OR IGNORE INTO comparison ({names}) VALUES ({places})"  # noqa: S608
            return bool(database.execute(query, row).rowcount)

    def comparisons(self, plant: str, rig: str | None = None) -> list[LawComparison]:
        """What sessions have shown of predictions on this plant and rig; None: on all its rigs."""
        query = f"SELECT {', '.join(_COMPARED)} FROM comparison WHERE plant = ? AND rig = ifnull(?, rig)"  # noqa: S608
        with self._opened() as database:
            if database is None or not _keeps_record(database):
                return []
            rows = database.execute(query, [plant, rig]).fetchall()
        return [self._comparison_of(row) for row in rows]

    def forget(self, sessions: Collection[str]) -> list[str]:
        """Remove sessions, given by name or digest; return the names of those that were there."""
        marks = ", ".join("?" * len(sessions))
        where = f"WHERE session IN ({marks}) OR name IN ({marks})"
        with self._opened(write=True) as database:
            if database is None:
                return []
            names: set[str] = set()
            for table in ("lesson", "comparison"):
                rows = database.execute(
                    f"SELECT name FROM {table} {where}",  # noqa: S608
                    [*sessions, *sessions],
                )
                names.update(name for (name,) in rows)
                database.execute(f"DELETE FROM {table} {where}", [*sessions, *sessions])  # noqa: S608
            return sorted(names)

    @contextmanager
    def _opened(self, *, write: bool = False, create: bool = False) -> Iterator[Any]:
        """The database in a transaction; None if there is no file and none is to be created."""
        database: sqlite3.Connection | None = None
        try:
            if self.path.exists() and not self.path.is_file():
                raise MemoryFaultError(
                    f"memory {self.path}: is not a regular file; give a file"
                )
            if create:
                self.path.parent.mkdir(parents=True, exist_ok=True)
            if create or self.path.exists():
                database = sqlite3.connect(
                    self.path, timeout=WAIT, isolation_level=None
                )
                database.execute("BEGIN IMMEDIATE" if write else "BEGIN")
                end = time.thread_time() + PATIENCE
                database.set_progress_handler(lambda: time.thread_time() > end, 100_000)
                database.create_function("in_order", 1, natural, deterministic=True)
                self._check(database, write=write)
            yield database
            if database is not None:
                database.execute("COMMIT")
        except (sqlite3.Error, OSError, UnicodeError) as error:
            # the last for text of damaged pages
            raise MemoryFaultError(f"memory {self.path}: {_why(error)}") from error
        finally:
            if database is not None:
                database.close()  # an open transaction is rolled back

    def _check(self, database: sqlite3.Connection, *, write: bool) -> None:
        """Refuse a file that is not a memory; an empty one becomes one, and a file of the first version gets
        its second table when it is written."""
        (application,) = database.execute("PRAGMA application_id").fetchone()
        (version,) = database.execute("PRAGMA user_version").fetchone()
        empty = not database.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
        if application != _APPLICATION and not (empty and application == 0):
            raise MemoryFaultError(
                f"memory {self.path}: is a database of another program; give another file"
            )
        if database.execute(
            "SELECT 1 FROM sqlite_master WHERE sql NOT LIKE 'CREATE TABLE %'"
        ).fetchone():
            raise MemoryFaultError(
                f"memory {self.path}: has views, triggers or indexes, which no memory has; give another file"
            )
        if version > VERSION:
            raise MemoryFaultError(
                f"memory {self.path}: was written by a newer version of twinmatch (its format is {version}, "
                f"this one reads {VERSION}); update twinmatch, or give another file"
            )
        steps = (_TABLE if empty else "") + (
            _RECORD if empty or (write and version < VERSION) else ""
        )
        for statement in filter(None, steps.strip().split(";\n")):
            database.execute(statement)

    def _comparison_of(self, row: tuple[Any, ...]) -> LawComparison:
        numbers = [math.nan if value is None else value for value in row]
        values = dict(zip(_COMPARED, numbers, strict=True))
        values["stable"] = bool(values["stable"])
        return decoded(values, LawComparison, f"memory {self.path}", MemoryFaultError)

    def _lesson_of(self, row: tuple[Any, ...]) -> Lesson:
        place = f"memory {self.path}"
        lists = decoded_json(
            str(row[-1]), _Lists, f"{place}: a row cannot be read", MemoryFaultError
        )
        for name in ("persistence_skill", "arx_skill"):
            setattr(
                lists,
                name,
                [
                    math.nan if skill is None else skill
                    for skill in getattr(lists, name)
                ],
            )
        plain = dict(zip(_OTHERS, row[:-1], strict=True))
        plain |= {"led": bool(plain["led"]), "chosen": bool(plain["chosen"])}
        return decoded(
            plain | msgspec.structs.asdict(lists), Lesson, place, MemoryFaultError
        )


def _row_of(lesson: Lesson) -> list[Any]:
    values = {name: getattr(lesson, name) for name in _COLUMNS}
    values |= {name: json.dumps(_plain(values[name])) for name in _LISTS}
    return [values[name] for name in _COLUMNS]


def _plain(value: Any) -> Any:
    """For JSON: NaN becomes null."""
    if isinstance(value, tuple):
        return [_plain(element) for element in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def _keeps_record(database: sqlite3.Connection) -> bool:
    """Whether it has the second table; a file of the first version has not."""
    return bool(database.execute("PRAGMA user_version").fetchone()[0] >= VERSION)


_LONGEST: Final = 100
"""Most characters of SQLite's own words: it quotes whole tables."""
_REASONS: Final = {
    "SQLITE_NOTADB": "is not a memory of twinmatch; give another file, or move it away",
    **dict.fromkeys(
        ("SQLITE_BUSY", "SQLITE_LOCKED"),
        "another program is writing it; try again when it has finished",
    ),
    **dict.fromkeys(
        ("SQLITE_FULL", "SQLITE_IOERR"),
        "cannot be written or read ({}); free some disk space, or choose another folder",
    ),
    **dict.fromkeys(
        ("SQLITE_READONLY", "SQLITE_CANTOPEN", "SQLITE_PERM", "SQLITE_AUTH"),
        "cannot be opened or written ({}); check its permissions, or give another file",
    ),
    "SQLITE_INTERRUPT": f"takes more than {PATIENCE:g} s to read; give another file, or forget sessions",
    "": "is damaged ({}); move it away, and remember its sessions again",
}
"""By the beginning of SQLite's name of the error."""


def _why(error: sqlite3.Error | OSError | UnicodeError) -> str:
    if isinstance(error, OSError):
        return f"cannot be used ({error.strerror}); give another file"
    code = getattr(error, "sqlite_errorname", "") or ""
    why = next(why for begin, why in _REASONS.items() if code.startswith(begin))
    return why.format(shorten(str(error), _LONGEST, placeholder=" …"))


def default_file(plant: str, rig: str = "") -> Path:
    """Where the memory of a plant and a rig is kept: in `twinmatch` in the user's data folder.

    Raises:
        MemoryFaultError: the name of the rig cannot be part of a file's name.
    """
    if not re.fullmatch(r"[\w.-]*", rig) or rig.startswith("."):
        raise MemoryFaultError(
            f"rig {rig!r}: is not a name for a rig; use letters, digits, '-', '_' and '.'"
        )
    return _folder() / f"{plant}{'@' if rig else ''}{rig}{_SUFFIX}"


def default_files() -> list[Path]:
    """The memories that there are in that folder."""
    return sorted(_folder().glob(f"*{_SUFFIX}"))


def _folder() -> Path:
    base = os.environ.get("XDG_DATA_HOME")
    return (Path(base) if base else Path.home() / ".local" / "share") / "twinmatch"
