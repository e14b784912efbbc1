"""Maps of signals in YAML files, and a first map of a table or a bag, guessed from its columns."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from twinmatch.decoding import decoded
from twinmatch.errors import TwinmatchError
from twinmatch.importing.tables import Table, split_title
from twinmatch.importing.times import read_times
from twinmatch.sampling.sources import SignalMap, SignalSource, source_of
from twinmatch.sessions.documents import read_yaml
from twinmatch.sessions.files import RecordingError
from twinmatch.signals import FloatArray


class _MapFile(msgspec.Struct, forbid_unknown_fields=True):
    columns: dict[str, Any]
    plant: str = ""
    period: float | None = None


def read_map(path: Path) -> SignalMap:
    """Read a map from a YAML file.

    Raises:
        DocumentError: the file does not exist, or is not YAML.
        RecordingError: it is not a map.
    """
    content = decoded(read_yaml(path), _MapFile, str(path), RecordingError)
    if not content.columns:
        raise RecordingError(f"{path}: columns is empty; give a line for each signal, such as output: T")
    if content.period is not None and not 0 < content.period < np.inf:
        raise RecordingError(f"{path}: period is {content.period:g}; give a positive number of seconds")
    sources = {name: source_of(f"{path}: {name}", given) for name, given in content.columns.items()}
    return SignalMap(sources, content.plant, content.period)


_REFERENCE: Final = re.compile(
    r"set.?-?point|\bsp\b|^sp\d*$|reference|^ref$|^r$|desired|target", re.IGNORECASE
)
_OUTPUT: Final = re.compile(
    r"^t\d*$|(?-i:^[Tt]_?out)|temp|(?-i:^y(?:[A-Z_\d].*)?$)|^y\d*$|speed|level|pressure|output|measur|sensor|^pv$|position|angle|flow",
    re.IGNORECASE,
)
_INPUT: Final = re.compile(
    r"heater|(?-i:^u(?:[A-Z_\d].*)?$)|^u\d*$|^q\d*$|pwm|duty|volt|power|valve|pump|command|\bcmd|input|^mv$|drive|actuat|throttle",
    re.IGNORECASE,
)
_AROUND: Final = re.compile(r"amb|room|outside|outdoor|environment|t_?inf|surround", re.IGNORECASE)
_TIME: Final = re.compile(
    r"^t$|^t[ _.-](ns|us|ms|s|min|h)$|time|stamp|date|^sec|elapsed|^zeit", re.IGNORECASE
)
_FEW: Final = 12
"""A column with at most so many different values looks commanded rather than measured."""
_REPEATED: Final = 0.9
_JUMP: Final = 0.05
"""A column that repeats its value in this share of the rows, and otherwise jumps by this share of its range,
looks commanded too. A slow reading that is rounded repeats its value as often, but moves by one digit."""

_TIMES: Final = ("time", "t", "timestamp", "seconds", "sec", "elapsed", "zeit", "temps", "tiempo", "tempo")
"""Titles of times that may also stand still or go back."""
_RESTARTS: Final = 0.1
"""Most steps back, as a share of those forward, in a column that is a time by its title."""
_TWICE: Final = 0.05
"""Largest share of rows that may repeat the time before in a column that is a time by its title."""


class Column(NamedTuple):
    """Summary of a column."""

    title: str
    unit: str
    """Unit in its title; empty without one."""
    low: float
    high: float
    different: int
    """Number of different values."""
    empty: int
    """Rows without a value."""
    kind: str
    """`time` (increasing), `numbers`, `on or off`, `constant` or `text`."""
    stepped: bool = False
    """Whether it holds its value and jumps, as a command does."""


def columns_of(table: Table) -> list[Column]:
    """Summaries of all columns."""
    return [_column(table, title) for title in table.columns]


def _column(table: Table, title: str) -> Column:
    try:
        return described(title, table.unit(title), table.values(title), ordered=True)
    except TwinmatchError:
        pass
    try:
        seconds = read_times(table, title).seconds
    except TwinmatchError:
        different = {*table.texts[title].values(), *table.columns[title].tolist()}
        return Column(title, table.unit(title), np.nan, np.nan, len(different), 0, "text")
    return Column(title, "date", 0.0, float(np.nanmax(seconds)), seconds.size, 0, "time")


def described(title: str, unit: str, values: FloatArray, *, ordered: bool) -> Column:
    """The summary of a column of numbers, shape (N,), nan in rows without a value.

    `ordered`: whether it may be a time, and whether it holds its value is of interest.
    """
    finite = values[np.isfinite(values)]
    if not finite.size:
        return Column(title, unit, np.nan, np.nan, 0, values.size, "text")
    different = int(np.unique(finite).size)
    steps = np.diff(finite)
    grows = finite.size > 2 and bool((steps > 0).all())
    # A logger may write a row twice; more repeats are those of another quantity, such as a counter.
    twice = int(np.sum(steps == 0))
    by_title = finite.size > 2 and _TIME.search(split_title(title)[0]) is not None
    # Also a time that a restarted logger set back, or whose digits are too few: the import says so.
    restarted = by_title and bool((steps < 0).sum() <= _RESTARTS * (steps > 0).sum())
    few = bool((steps >= 0).all()) and twice <= max(1, _TWICE * steps.size)
    repeats = by_title and (few or (restarted and split_title(title)[0].lower() in _TIMES))
    if different == 1:
        kind = "constant"
    elif ordered and (grows or repeats):
        kind = "time"
    else:
        kind = "on or off" if set(np.unique(finite)) <= {0.0, 1.0} else "numbers"
    low, high = float(finite.min()), float(finite.max())
    empty = values.size - finite.size
    return Column(title, unit, low, high, different, empty, kind, ordered and _stepped(finite))


def _stepped(values: FloatArray) -> bool:
    changes = np.abs(np.diff(values))
    moved = changes[changes > 0]
    if not moved.size or moved.size > (1.0 - _REPEATED) * changes.size:
        return False
    return float(np.median(moved)) >= _JUMP * float(np.ptp(values))


def proposed(columns: Sequence[Column]) -> dict[str, SignalSource]:
    """A guess at the columns of time, output, input, reference and room, for a person to check."""
    sources: dict[str, SignalSource] = {}
    taken: set[str] = set()
    named = list(_named(columns, _INPUT, ("on or off", "numbers")))
    for signal, candidates in (
        ("time", _named(columns, _TIME, ("time",))),
        ("reference", _named(columns, _REFERENCE, ("numbers", "constant"))),
        ("room", _named(columns, _AROUND, ("numbers", "constant"))),
        ("input", (c for c in named if c.stepped or c.kind == "on or off")),
        ("input", named),
        ("input", (c for c in _of(columns, "numbers") if c.stepped)),
        ("output", _liveliest(c for c in _named(columns, _OUTPUT, ("numbers", "time")) if not c.stepped)),
        ("output", _liveliest(_named(columns, _OUTPUT, ("numbers", "time")))),
        ("time", _of(columns, "time")),
        ("input", _of(columns, "on or off")),
        ("input", (c for c in _of(columns, "numbers") if c.different <= _FEW)),
        ("output", _liveliest(_of(columns, "numbers"))),
        ("input", _of(columns, "numbers")),
    ):
        choice = next((column.title for column in candidates if column.title not in taken), None)
        if signal not in sources and choice is not None:
            sources[signal] = SignalSource((choice,))
            taken.add(choice)
    if seen_by_controller(columns, sources):
        sources["output"], sources["input"] = (SignalSource((c.title,)) for c in _in_and_out(columns))
    order = ("time", "output", "input", "reference", "room")
    return {signal: sources[signal] for signal in order if signal in sources}


SEEN: Final = (
    "Input is taken as what is measured, and Output as the drive: the set-point is near Input, as where PID "
    "libraries give these names. If that is wrong, exchange them in --map."
)


def seen_by_controller(columns: Sequence[Column], sources: Mapping[str, SignalSource]) -> bool:
    """Whether Input and Output are those of the controller, as PID libraries call them.

    The set-point tells: what is measured follows it.
    """
    found = _in_and_out(columns)
    target = next(
        (c for c in columns if "reference" in sources and c.title in sources["reference"].places), None
    )
    if len(found) != 2 or target is None:
        return False
    given, made = (abs(c.low - target.low) + abs(c.high - target.high) for c in found)
    return given < made


def _in_and_out(columns: Sequence[Column]) -> list[Column]:
    """The columns Input and Output, if there are both."""
    named = {split_title(c.title)[0].lower(): c for c in columns if c.kind != "text"}
    return [named[name] for name in ("input", "output") if name in named]


def _named(columns: Sequence[Column], words: re.Pattern[str], kinds: Sequence[str]) -> Iterator[Column]:
    return (c for c in columns if c.kind in kinds and words.search(split_title(c.title)[0]))


def _of(columns: Sequence[Column], kind: str) -> Iterator[Column]:
    return (c for c in columns if c.kind == kind)


def _liveliest(columns: Iterator[Column]) -> Iterator[Column]:
    """Columns with most different values first: of several temperatures, the room's varies least."""
    return iter(sorted(columns, key=lambda column: -column.different))
