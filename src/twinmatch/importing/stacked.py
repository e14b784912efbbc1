"""Tables that stack many series: one column has the values, another names the series of each row.

Databases and home automation export so (InfluxDB, Home Assistant). Such a table is taken apart into one
column for each series, `state[sensor.room_temperature]` or `_value[_field=temperature]`, in which the other
rows have no value. Once a map says which series is the output, its rows are those of the plant, and the other
series are brought to their times.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.errors import TwinmatchError
from twinmatch.importing.resampling import Kind, bridged_up_to, held_means, usual_step
from twinmatch.importing.tables import Table, split_title
from twinmatch.importing.times import Times, read_times
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

__all__ = ["SeriesTable", "taken_apart"]


class _StackRule(Rule):
    """Which tables stack series."""

    most: int = 2000
    """Most series."""
    rows: int = 3
    """Fewest rows of a series, on average."""
    named: float = 0.9
    """Least share of the rows that have a name."""
    repeats: float = 0.02
    """Largest share of the rows of a series that repeat its time."""


_RULE: Final = _StackRule()
_VALUES: Final = re.compile(
    r"^(_?value|state|val|reading|data|mean|last|(numeric|var|variable|tag|point|signal)_?value)$",
    re.IGNORECASE,
)
_NAMES: Final = re.compile(
    r"^(_field|entity(_id)?|sensor(_?(id|name))?|tag(_?name)?|topic|var(iable)?(_?name)?|metric|series|"
    r"channel(_?name)?|signal(_?name)?|parameter|point(_?name)?|key|name|item|device(_?(id|name))?|"
    r"node(_?(id|name))?|attribute)$",
    re.IGNORECASE,
)
_CHANGES: Final = re.compile(r"^last_(changed|updated)(_ts)?$", re.IGNORECASE)
"""Times of values that are written only when they change."""


class _Stack(NamedTuple):
    """How a table stacks series."""

    time: str
    values: tuple[str, ...]
    """One column, or several if each row has the values of one device."""
    names: tuple[str, ...]
    """Columns that name the series together."""


@dataclass(frozen=True)
class SeriesTable(Table):
    """A table in which each row has a value of one series; its columns are made when they are asked for."""

    places_of: Mapping[str, NDArray[np.intp]] = field(default_factory=dict)
    """The rows of each series (from 0), in the order of their times, by title."""
    names: Mapping[str, str] = field(default_factory=dict)
    """Name of each series alone, by title."""
    time: str = ""
    """Title of the column of times."""
    is_held: bool = False
    """Whether a value is written only when it changes."""

    def find(self, name: str) -> str:
        """The title of a column; a series may be called by its name alone.

        Raises:
            RecordingError: no column matches, or several do.
        """
        plain = re.sub(r"\s*([=,\[\]])\s*", r"\1", name.strip()).lower()
        titles = [
            title for title, spellings in self._spellings.items() if plain in spellings
        ]
        if len(titles) == 1:
            return titles[0]
        return super().find(name)

    @cached_property
    def _spellings(self) -> dict[str, set[str]]:
        """In which ways each series may be written, by title, in small letters without spaces."""
        spellings = {}
        for title, name in self.names.items():
            values = ",".join(part.rpartition("=")[2] for part in name.split(", "))
            column = title.partition("[")[0]
            ways = {title, name, values, f"{column}[{values}]"}
            spellings[title] = {
                re.sub(r"\s*([=,\[\]])\s*", r"\1", way).lower() for way in ways
            }
        return spellings

    def own_values(self, title: str) -> FloatArray:
        """The values of the rows of a series, in the order of their times; of another column all."""
        values = self.values(title)
        return values[self.places_of[title]] if title in self.places_of else values

    def at_rows_of(
        self, clock: str, kinds: Mapping[str, Kind], times: Times
    ) -> tuple[Table, Times]:
        """Some columns at the rows of one of them, as a table whose rows have all values.

        Args:
            clock: title of the series whose rows are kept, that of the output.
            kinds: the titles of all series that are wanted, and what is between their values.
            times: of all rows.
        """
        rows = self._rising(clock, times.seconds)
        own_rows = rows
        seconds = times.seconds[rows]
        if self.is_held:
            seconds, own_rows = _with_standing_values(seconds, rows)
        columns = {}
        for title, kind in kinds.items():
            series_rows = self._rising(title, times.seconds)
            series = _Series(
                times.seconds[series_rows], self.values(title)[series_rows]
            )
            columns[title] = (
                series.newest(seconds)
                if self.is_held and kind != "held"
                else series.at(seconds, kind)
            )
        lines = [self.lines[row] for row in own_rows]
        table = Table(
            self.path,
            columns,
            lines,
            self.row,
            units=False,
            cell_units=self.cell_units,
            notes=self.notes,
        )
        return table, times._replace(seconds=seconds)

    def _rising(self, title: str, seconds: FloatArray) -> NDArray[np.intp]:
        """The rows of a series with rising times; of several at one time the last."""
        rows = self.places_of[title]
        rows = rows[np.isfinite(seconds[rows])]
        rows = rows[np.argsort(seconds[rows], kind="stable")]
        is_last = (
            np.append(np.diff(seconds[rows]) > 0, True)
            if rows.size
            else np.zeros(0, dtype=np.bool_)
        )
        return np.asarray(rows[is_last])


class _Series(NamedTuple):
    """A series: its times, s, increasing, and its values, nan where it is not available, of shape (N,)."""

    times: FloatArray
    values: FloatArray

    def at(self, times: FloatArray, kind: Kind) -> FloatArray:
        """Its values at these times; nan before the first one and while it is not available."""
        if not self.times.size:
            return np.full(times.size, np.nan)
        newest = self.newest(times)
        is_there = np.isfinite(self.values)
        if kind == "set" or not is_there.any():
            return newest
        if kind == "reading":
            between = np.interp(times, self.times[is_there], self.values[is_there])
            is_after = times > self.times[is_there][-1]
            return np.where(np.isfinite(newest) & ~is_after, between, newest)
        return self._means(times, newest)

    def newest(self, times: FloatArray) -> FloatArray:
        """The last value at or before each time."""
        places = np.searchsorted(self.times, times, side="right") - 1
        return np.where(places >= 0, self.values[np.maximum(places, 0)], np.nan)

    def _means(self, times: FloatArray, newest: FloatArray) -> FloatArray:
        """Means from each time to the next, where all of it is known; before a gap over a usual step."""
        usual = usual_step(np.diff(times))
        ends = np.append(times[1:], times[-1] + usual)
        ends = np.where(ends - times > bridged_up_to(times), times + usual, ends)
        missing = np.isnan(self.values).astype(np.float64)
        share_missing = held_means(self.times, missing, times, ends, ends - times)
        means = held_means(
            self.times, np.nan_to_num(self.values), times, ends, ends - times
        )
        return np.where((share_missing < 1e-9) & np.isfinite(newest), means, np.nan)


def _with_standing_values(
    seconds: FloatArray, rows: NDArray[np.intp]
) -> tuple[FloatArray, NDArray[np.intp]]:
    """Times with usual steps in pauses, in which a value stands, and the row that applies at each."""
    usual = usual_step(np.diff(seconds))
    if not np.isfinite(usual):
        return seconds, rows
    times = []
    places = []
    for row, begin, end in zip(
        rows, seconds, [*seconds[1:], seconds[-1] + usual], strict=True
    ):
        count = max(int((end - begin) / usual - 0.5), 0) + 1
        times.append(begin + usual * np.arange(count))
        places.append(np.full(count, row))
    return np.concatenate(times), np.concatenate(places)


class _SeriesColumns(Mapping[str, FloatArray]):
    """Numbers by title: the plain columns of the table, and its series, made when asked for."""

    def __init__(
        self,
        plain: Mapping[str, FloatArray],
        values: Mapping[str, FloatArray],
        places: Mapping[str, NDArray[np.intp]],
    ) -> None:
        """`values` are the columns of values, and `places` the rows of each series, by its title."""
        self._plain = plain
        self._values = values
        self._places = places

    def __getitem__(self, title: str) -> FloatArray:
        if title in self._plain:
            return self._plain[title]
        rows = self._places[title]
        column = np.full(self._values[title].size, np.nan)
        column[rows] = self._values[title][rows]
        return column

    def __iter__(self) -> Iterator[str]:
        yield from self._plain
        yield from self._places

    def __len__(self) -> int:
        return len(self._plain) + len(self._places)


def taken_apart(table: Table, units: Mapping[str, str] | None = None) -> Table:
    """A table with a column for each series, if it stacks them; otherwise the table itself.

    `units` are those of the series by their names, where they are known.
    """
    times = {}
    for title in table.columns:
        seconds = _times(table, title)
        if seconds is not None:
            times[title] = seconds
    if not times:
        return table
    time = max(times, key=lambda title: np.unique(times[title]).size)
    titled_values = [title for title in table.columns if _VALUES.match(title.strip())]
    if len(titled_values) == 1:
        names = _names(table, (titled_values[0], time), times[time])
        values = titled_values
    else:
        names = _names(table, (time,), times[time])
        values = [
            title
            for title in table.columns
            if title not in (*names, *times) and _is_numeric(table, title)
        ]
        if not names or np.unique(_codes(table, names)).size < 2:
            return table
    if not names or not values:
        return table
    return _series_table(
        table, _Stack(time, tuple(values), names), times[time], units or {}
    )


def _is_numeric(table: Table, title: str) -> bool:
    """Whether a column has more numbers than texts."""
    return bool(
        np.isfinite(table.columns[title]).sum() > len(table.texts.get(title, {}))
    )


def _times(table: Table, title: str) -> FloatArray | None:
    """The times in a column with several of them; None if it has none."""
    has_name = (
        re.search(r"time|stamp|date|last_|^t$|^ts$", title, re.IGNORECASE) is not None
    )
    if not (has_name or table.texts.get(title)):
        return None
    try:
        seconds = read_times(table, title).seconds
    except TwinmatchError:
        return None
    return seconds if np.unique(seconds[np.isfinite(seconds)]).size > 1 else None


def _names(
    table: Table, others: tuple[str, ...], seconds: FloatArray
) -> tuple[str, ...]:
    """The columns that name the series: one alone if its series have rising times, or else all.

    `others` are the columns of times and values.
    """
    rows = len(table.lines)
    counts = {}
    for title in table.columns:
        labels = [] if title in others else _labels(table, title)
        if sum(map(bool, labels)) > _RULE.named * rows and _times(table, title) is None:
            counts[title] = len(set(labels))
    most = min(_RULE.most, rows / _RULE.rows)
    varying = [title for title, count in counts.items() if count <= most]
    titled = [title for title in varying if _NAMES.match(title.strip())]
    for title in sorted(
        titled, key=lambda title: (title.lower() != "_field", -counts[title])
    ):
        if _rises_within(_codes(table, (title,)), seconds):
            return (title,)
    several = tuple(title for title in varying if counts[title] > 1)
    if titled and several and _rises_within(_codes(table, several), seconds):
        return several
    return ()


def _labels(table: Table, title: str) -> list[str]:
    """The texts of a column, by row; of one that has the name of a name, whole numbers are texts, too.

    Empty for another column of numbers.
    """
    texts = table.texts.get(title, {})
    column = table.columns[title]
    if texts:
        return [texts.get(row, "").strip() for row in range(column.size)]
    if (
        _NAMES.match(title.strip()) is None
        or not np.isfinite(column).all()
        or (column % 1.0).any()
    ):
        return []
    return [f"{value:g}" for value in column.tolist()]


def _codes(table: Table, names: tuple[str, ...]) -> NDArray[np.intp]:
    """A number for each row that tells its series, shape (N,)."""
    numbers: dict[tuple[str, ...], int] = {}
    keys = zip(*(_labels(table, title) for title in names), strict=True)
    return np.array(
        [numbers.setdefault(key, len(numbers)) for key in keys], dtype=np.intp
    )


def _rises_within(codes: NDArray[np.intp], seconds: FloatArray) -> bool:
    """Whether hardly a row of a series repeats the time of another one."""
    order = np.lexsort((seconds, codes))
    same_series = np.diff(codes[order]) == 0
    same_time = np.diff(seconds[order]) == 0
    return bool(np.sum(same_series & same_time) <= _RULE.repeats * codes.size)


def _series_table(
    table: Table, stack: _Stack, seconds: FloatArray, units: Mapping[str, str]
) -> SeriesTable:
    codes = _codes(table, stack.names)
    order = np.lexsort((seconds, codes))
    firsts = np.flatnonzero(np.diff(codes[order], prepend=-1))
    labels = {title: _labels(table, title) for title in stack.names}
    others = table.texts.keys() - {*stack.names, *stack.values, stack.time}
    has_other_names = any(
        title == "_measurement" or _NAMES.match(title.strip()) for title in others
    )
    columns = {}
    places_of = {}
    names = {}
    cell_units = {}
    texts = {stack.time: table.texts[stack.time]} if stack.time in table.texts else {}
    for rows in np.split(order, firsts[1:]):
        pairs = [f"{title}={labels[title][rows[0]]}" for title in stack.names]
        plain_name = labels[stack.names[0]][rows[0]]
        series = ", ".join(pairs) if has_other_names or len(pairs) > 1 else plain_name
        for value in stack.values:
            title = f"{value}[{series}]"
            columns[title] = table.columns[value]
            places_of[title] = rows
            names[title] = (
                series
                if len(stack.values) == 1
                else f"{series}.{split_title(value)[0]}"
            )
            series_texts = _texts_in(table, value, rows)
            if series_texts:
                texts[title] = series_texts
            unit = units.get(series) or table.unit(value)
            if unit:
                cell_units[title] = unit
    plain = {stack.time: table.columns[stack.time]}
    return SeriesTable(
        table.path,
        _SeriesColumns(plain, columns, places_of),
        table.lines,
        table.row,
        texts,
        units=False,
        cell_units=cell_units,
        notes=table.notes,
        places_of=places_of,
        names=names,
        time=stack.time,
        is_held=_CHANGES.match(stack.time) is not None,
    )


def _texts_in(table: Table, title: str, rows: NDArray[np.intp]) -> dict[int, str]:
    """The texts of a column in some rows, by row."""
    texts = table.texts.get(title, {})
    return {row: texts[row] for row in rows.tolist() if row in texts}
