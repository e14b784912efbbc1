"""The map from the columns of a table to the signals of a plant.

On a command line, signal by signal:

    time=elapsed   output="t2, t3"   input="Heater 1 (%)"   "room=t_room; unit=K"   "input=duty; scale=100"

or as YAML, which may also give the plant and the sampling period:

    plant: incubator
    period: 3.0                # s; that of the rows if not given
    columns:
      time: {column: time, unit: ns}
      output: [t2, t3]         # the mean of both
      input: heater_on
      room: {column: t1, scale: 0.1, offset: -40}

A signal is scale · column + offset, converted from the given unit (by default the one in the column's title)
to the plant's. Several columns give their mean.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from twinmatch.sessions.documents import read_yaml
from twinmatch.sessions.errors import DocumentError, RecordingError

__all__ = ["ColumnMap", "Source", "parse_map", "parse_source", "read_map"]

_FORM: Final = "write SIGNAL=COLUMN, such as output=T or 'output=T; unit=K; scale=0.1; offset=-40'"


@dataclass(frozen=True)
class Source:
    """The columns of a signal and their conversion."""

    columns: tuple[str, ...]
    """Titles; of several, the mean is used. A single text with commas may be one title, or several."""
    unit: str = ""
    """Unit of scale·column + offset; empty: that in the column's title, or the plant's."""
    scale: float = 1.0
    offset: float = 0.0

    @property
    def text(self) -> str:
        """The source as written on a command line."""
        more = [f"unit={self.unit}"] if self.unit else []
        more += [
            f"{n}={v:g}"
            for n, v, usual in (("scale", self.scale, 1), ("offset", self.offset, 0))
            if v != usual
        ]
        return "; ".join([", ".join(self.columns), *more])


@dataclass(frozen=True)
class ColumnMap:
    """Columns by signal: time, output, input, reference, and the plant's own names."""

    sources: Mapping[str, Source] = field(default_factory=dict)
    plant: str = ""
    """Name or file; empty: not given."""
    period: float | None = None
    """Sampling period, s."""

    def joined(self, other: ColumnMap) -> ColumnMap:
        """This map, updated with the entries of another."""
        return ColumnMap(
            {**self.sources, **other.sources},
            other.plant or self.plant,
            self.period if other.period is None else other.period,
        )


def parse_map(entries: Sequence[str]) -> ColumnMap:
    """Parse a map from a command line.

    Raises:
        RecordingError: an entry is not SIGNAL=COLUMN, or a signal is given twice.
    """
    sources: dict[str, Source] = {}
    for entry in entries:
        signal, equals, text = entry.partition("=")
        signal = signal.strip()
        if not (equals and signal):
            raise RecordingError(f"--map {entry!r}: {_FORM}")
        if signal in sources:
            raise RecordingError(f"--map {entry!r}: {signal} is given twice; name each signal once")
        sources[signal] = parse_source(f"--map {entry!r}", text)
    return ColumnMap(sources)


def parse_source(place: str, text: str) -> Source:
    """Parse what follows the `=` of an entry, such as `T; unit=K`.

    Args:
        place: start of the error message.
        text: the column, and its conversion.

    Raises:
        RecordingError: the column is missing, or a setting is unknown.
    """
    column, *settings = (part.strip() for part in text.split(";"))
    if not column:
        raise RecordingError(f"{place}: {_FORM}")
    given: dict[str, Any] = {"column": column}
    for setting in settings:
        name, _, value = (part.strip() for part in setting.partition("="))
        given[name] = value if name == "unit" else _plain_number(value)
    return _source(place, given)


def read_map(path: Path) -> ColumnMap:
    """Read a map from a YAML file.

    Raises:
        RecordingError: the file does not exist, is not YAML, or is not a map.
    """
    try:
        content = read_yaml(path)
    except DocumentError as error:
        raise RecordingError(str(error)) from error
    columns = content.get("columns") if isinstance(content, dict) else None
    if not isinstance(content, dict) or not isinstance(columns, dict) or not columns:
        raise RecordingError(
            f"{path}: has no section 'columns' with a line for each signal, such as output: T"
        )
    unknown = sorted(str(name) for name in content if name not in ("plant", "period", "columns"))
    if unknown:
        raise RecordingError(f"{path}: unknown entry {unknown[0]}; a map has plant, period and columns")
    period = content.get("period")
    if period is not None and not (_is_number(period) and period > 0):
        raise RecordingError(f"{path}: period is {period!r}; give a positive number of seconds")
    sources = {str(name): _source(f"{path}: {name}", given) for name, given in columns.items()}
    return ColumnMap(sources, str(content.get("plant", "")), None if period is None else float(period))


def _source(place: str, given: Any) -> Source:
    if isinstance(given, str | list):
        given = {"column": given}
    if not isinstance(given, dict):
        raise RecordingError(f"{place}: is {given!r}; give the title of a column")
    known = {"column", "columns", "unit", "scale", "offset"}
    unknown = sorted(str(name) for name in given if name not in known)
    if unknown:
        raise RecordingError(f"{place}: unknown setting {unknown[0]!r}; there are unit, scale and offset")
    columns = given.get("column", given.get("columns"))
    columns = [columns] if isinstance(columns, str) else columns
    if not isinstance(columns, list) or not columns or not all(isinstance(c, str) and c for c in columns):
        raise RecordingError(f"{place}: the column is missing; give one, or a list to average")
    for name in ("scale", "offset"):
        if not _is_number(given.get(name, 1.0)):
            raise RecordingError(f"{place}: {name} is {given[name]!r}; give a number")
    unit = given.get("unit", "")
    if not isinstance(unit, str):
        raise RecordingError(f"{place}: unit is {unit!r}; give its name")
    if given.get("scale", 1.0) == 0:
        raise RecordingError(f"{place}: scale is 0, which makes the whole column 0; give another")
    return Source(tuple(columns), unit, float(given.get("scale", 1.0)), float(given.get("offset", 0.0)))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _plain_number(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text
