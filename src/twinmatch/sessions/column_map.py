"""Which column of somebody's table is which signal of a plant.

Written on a command line, signal by signal:

    time=elapsed   output="t2, t3"   input="Heater 1 (%)"   "room=t_room; unit=K"   "input=duty; scale=100"

or as YAML, where the plant and the sample time may stand too:

    plant: incubator
    period: 3.0                # s; if not given, that of the rows
    columns:
      time: {column: time, unit: ns}
      output: [t2, t3]         # the mean of both
      input: heater_on
      room: {column: t1, scale: 0.1, offset: -40}

A signal is the scale times the column plus the offset, then brought from the unit (of the column's title,
where none is written) to the plant's. Several columns give their mean.
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
    """Where a signal comes from."""

    columns: tuple[str, ...]
    """Titles; more than one: their mean. A single one may hold commas, of itself or between several."""
    unit: str = ""
    """Of scale·column + offset; empty: as the column's title says, or the plant's."""
    scale: float = 1.0
    offset: float = 0.0

    @property
    def text(self) -> str:
        """As it is written on a command line."""
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
    """Name or file; empty: not said."""
    period: float | None = None
    """Sample time, s."""

    def joined(self, other: ColumnMap) -> ColumnMap:
        """This map with what another says instead."""
        return ColumnMap(
            {**self.sources, **other.sources},
            other.plant or self.plant,
            self.period if other.period is None else other.period,
        )


def parse_map(entries: Sequence[str]) -> ColumnMap:
    """A map from what stands on a command line.

    Raises:
        RecordingError: an entry is no map.
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
    """What stands behind the `=` of an entry, such as `T; unit=K`.

    Args:
        place: begins the message of an error.
        text: the column, and what is to be known of it.

    Raises:
        RecordingError: it names no column, or something that is not known.
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
    """A map from a YAML file.

    Raises:
        RecordingError: the file is not there, is no YAML, or holds something else.
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
        raise RecordingError(f"{path}: {unknown[0]} is not known; a map has plant, period and columns")
    period = content.get("period")
    if period is not None and not (_is_number(period) and period > 0):
        raise RecordingError(f"{path}: period is {period!r}; give seconds")
    sources = {str(name): _source(f"{path}: {name}", given) for name, given in columns.items()}
    return ColumnMap(sources, str(content.get("plant", "")), None if period is None else float(period))


def _source(place: str, given: Any) -> Source:
    if isinstance(given, str | list):
        given = {"column": given}
    if not isinstance(given, dict):
        raise RecordingError(f"{place}: is {given!r}; name a column")
    known = {"column", "columns", "unit", "scale", "offset"}
    unknown = sorted(str(name) for name in given if name not in known)
    if unknown:
        raise RecordingError(f"{place}: {unknown[0]!r} is not known; there are unit, scale and offset")
    columns = given.get("column", given.get("columns"))
    columns = [columns] if isinstance(columns, str) else columns
    if not isinstance(columns, list) or not columns or not all(isinstance(c, str) and c for c in columns):
        raise RecordingError(f"{place}: names no column; give one, or a list of which the mean is taken")
    for name in ("scale", "offset"):
        if not _is_number(given.get(name, 1.0)):
            raise RecordingError(f"{place}: {name} is {given[name]!r}; give a number")
    unit = given.get("unit", "")
    if not isinstance(unit, str):
        raise RecordingError(f"{place}: unit is {unit!r}; give its name")
    if given.get("scale", 1.0) == 0:
        raise RecordingError(f"{place}: scale is 0, which leaves nothing of the column; give another")
    return Source(tuple(columns), unit, float(given.get("scale", 1.0)), float(given.get("offset", 0.0)))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _plain_number(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text
