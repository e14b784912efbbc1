"""Times of loggers as seconds: numbers with a unit, counts since 1970, dates, durations, times of day.

Numbers far beyond any recording's length are counts since 1970, and their size gives the unit: seconds from
1e8 (1973), milliseconds from 1e11, microseconds from 1e14, nanoseconds from 1e17; so late that they would
be of 2084 and after, they are counted since 1904. Dates, durations and times of day are those of `dates`. A
time of day that falls by more than half a day has passed midnight. A date and a time of day may be in two
columns.

Spreadsheets count days since 1899-12-30. Nothing tells such numbers from seconds for certain, so a column
that looks like them is not guessed: its unit must be given.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from twinmatch.errors import TwinmatchError
from twinmatch.importing.dates import (
    clock_seconds,
    from_iso,
    in_order,
    is_local,
    is_two_numbers,
    order_of,
)
from twinmatch.importing.tables import Table
from twinmatch.sessions.files import RecordingError
from twinmatch.signals import FloatArray
from twinmatch.units import conversion

_ZONE: Final = re.compile(r":\d{2}.*[+-](?!00:?00)\d{2}:?\d{2}$")
"""A time zone other than UTC."""
_SINCE_1970: Final = 1e8
"""Times from here on, s, are counted from 1970: it was reached in 1973."""
_SINCE_1904: Final = 3.6e9
"""Times from here on, s, are counted from 1904, as LabVIEW does: so it was reached in 2018."""
_FROM_1904_TO_1970: Final = 2082844800.0
"""Seconds from the beginning of 1904 to that of 1970."""
_UNITS_SINCE_1970: Final = ((1e17, 1e9), (1e14, 1e6), (1e11, 1e3), (_SINCE_1970, 1.0))
"""Size from which a number is a count since 1970, and its units per second."""
_UNIT_AT_END: Final = re.compile(
    r".[ _.-](ns|us|ms|s|secs?|seconds?|min|mins|minutes?|h|hrs?|hours?|d|days?)$", re.I
)
_SHORT_UNIT: Final = re.compile(r"(ns|us|ms|sec|seconds?)", re.IGNORECASE)
"""Units that are a title by themselves."""
_WRITTEN_OUT: Final = {"millis": "ms", "micros": "us", "nanos": "ns"}
"""Beginnings of units within a title, as in `millis()`."""
_LIKELY_DAYS: Final = (36526.0, 73051.0)
"""Days since 1899-12-30 from the year 2000 on, to 2100."""
_LONGEST_STEP: Final = 0.05
"""Longest usual step of a logger in days: 72 minutes."""
_DAY: Final = 86400.0
_EPOCH_IN_DAYS: Final = 25569.0
"""Days from 1899-12-30 to 1970."""


class Times(NamedTuple):
    """Times of the rows."""

    seconds: FloatArray
    """Seconds since `origin`, shape (N,); nan for rows without a time."""
    origin: float | None
    """Seconds since 1970; None if the table has no absolute time."""
    order: str = ""
    """Order of day and month, if the dates have the year last."""


def read_times(table: Table, title: str, unit: str = "", scale: float = 1.0) -> Times:
    """The times in a column.

    Args:
        table: the table.
        title: that of the column.
        unit: unit of the numbers; empty: that in the title (`time (ms)`, `time_ms`), or judged by their size.
            Of times such as `12:30` that of the first number.
        scale: factor applied to the numbers first.

    Raises:
        RecordingError: a cell is not a time, or the unit is not one of time.
    """
    texts = table.texts.get(title)
    if texts:
        before_first_text = table.columns[title][: min(texts)]
        if not np.isfinite(before_first_text).any():
            return _times_of_texts(table, title, texts, unit or table.unit(title))
    values = table.values(title) * scale
    sizes = np.abs(values[np.isfinite(values)])
    largest = float(np.max(sizes, initial=0.0))
    unit = unit or table.unit(title) or unit_in(title)
    if unit:
        per_second = _per_second(table, title, unit)
    else:
        _require_no_days(table, title, values)
        per_second = next(
            (count for least, count in _UNITS_SINCE_1970 if largest >= least), 1.0
        )
    if per_second == 1.0 / _DAY and _may_be_days(values):
        return _since((values - _EPOCH_IN_DAYS) * _DAY)
    if largest / per_second >= _SINCE_1970:
        counted_since = (
            _FROM_1904_TO_1970 if largest / per_second >= _SINCE_1904 else 0.0
        )
        return _since(values / per_second - counted_since)
    return Times(values / per_second, None)


def read_date_and_time(table: Table, date_title: str, time_title: str) -> Times:
    """The times in two columns, one of dates and one of times of day.

    Raises:
        RecordingError: a row has no date or no time of day.
    """
    dates = table.texts.get(date_title, {})
    clocks = table.texts.get(time_title, {})
    joined = {
        row: f"{dates[row].strip()} {clocks[row].strip()}"
        for row in dates
        if row in clocks
    }
    both = f"{date_title}, {time_title}"
    if not joined:
        raise RecordingError(
            f"{table.path}: {both!r} are not a date and a time of day such as 2021-01-22 and 14:48:58; map "
            "one column to time"
        )
    empty = np.full(len(table.lines), np.nan)
    joined_table = Table(
        table.path, {both: empty}, table.lines, table.row, {both: joined}
    )
    return _times_of_texts(joined_table, both, joined, "")


def _times_of_texts(
    table: Table, title: str, texts: Mapping[int, str], unit: str
) -> Times:
    first_text = next((text for text in texts.values() if text.strip()), "")
    if _is_clock(first_text):
        return Times(
            _past_midnight(
                _clock_column(table, title, texts, _first_unit(title, unit))
            ),
            None,
        )
    order = order_of(texts.values()) if is_local(first_text) else ""
    return _since(_dates(table, title, texts, order))._replace(order=order)


def _is_clock(text: str) -> bool:
    """Whether a text is a duration or a time of day."""
    return is_two_numbers(text) or clock_seconds(text) is not None


def _first_unit(title: str, unit: str) -> str:
    """Unit of the first of two numbers, as in `12:30`: `h`, `min`, or empty where nothing says it."""
    words = f"{title} {unit}".lower()
    if re.search(r"\bm+(in)?:s+\b", words) or unit == "min":
        return "min"
    return "h" if re.search(r"\bh+:m+", words) or unit == "h" else ""


def _clock_column(
    table: Table, title: str, texts: Mapping[int, str], first_unit: str
) -> FloatArray:
    """Seconds of durations or times of day, shape (N,).

    Raises:
        RecordingError: a cell is neither, or nothing says which two numbers it has.
    """
    seconds = np.full(len(table.lines), np.nan)
    for row, text in texts.items():
        value = clock_seconds(text, first_unit)
        if value is None and is_two_numbers(text):
            raise RecordingError(
                f"{table.place(row)}: {title!r} is {text.strip()!r}: hours and minutes, or minutes and "
                f"seconds? Write time='{title}; unit=h' or time='{title}; unit=min'"
            )
        if value is None:
            raise RecordingError(
                f"{table.place(row)}: {title!r} is {text.strip()[:40]!r}, not a time such as 14:48:58.7"
            )
        seconds[row] = value
    return seconds


def _past_midnight(seconds: FloatArray) -> FloatArray:
    """Times of day with a day added wherever they fall by more than half of one, shape (N,)."""
    is_there = np.isfinite(seconds)
    falls = np.diff(seconds[is_there], prepend=seconds[is_there][:1]) < -0.5 * _DAY
    continued = seconds.copy()
    continued[is_there] += _DAY * np.cumsum(falls)
    return continued


def _per_second(table: Table, title: str, unit: str) -> float:
    """How many of this unit make a second.

    Raises:
        RecordingError: it is not a unit of time.
    """
    try:
        return 1.0 / conversion(unit, "s").scale
    except TwinmatchError:
        msg = f"{table.path}: {title!r} is in {unit}, not a unit of time; write time='{title}; unit=s'"
        raise RecordingError(msg) from None


def unit_in(title: str) -> str:
    """The unit of time with which a title ends, as in `t_ms` or `elapsed hours`; empty without one."""
    plain = title.strip()
    for written, unit in _WRITTEN_OUT.items():
        if written in plain.lower():
            return unit
    ending = _UNIT_AT_END.search(plain) or _SHORT_UNIT.fullmatch(plain)
    return ending[1].lower() if ending else ""


def is_since_1970(values: FloatArray) -> bool:
    """Whether all are so large that they are counts since 1970."""
    finite = values[np.isfinite(values)]
    return bool(finite.size) and bool((finite >= _SINCE_1970).all())


def _may_be_days(values: FloatArray) -> bool:
    """Whether all are days of a spreadsheet from 2000 to 2100."""
    finite = values[np.isfinite(values)]
    return bool(finite.size) and bool(
        (finite >= _LIKELY_DAYS[0]).all() and (finite < _LIKELY_DAYS[1]).all()
    )


def _require_no_days(table: Table, title: str, values: FloatArray) -> None:
    """Refuse numbers without a unit that may be days of a spreadsheet as well as seconds."""
    finite = values[np.isfinite(values)]
    if (
        finite.size > 1
        and _may_be_days(values)
        and np.median(np.abs(np.diff(finite))) < _LONGEST_STEP
    ):
        raise RecordingError(
            f"{table.path}: {title!r} goes from {finite.min():g} to {finite.max():g} in small steps: days of "
            f"a spreadsheet, or seconds? Write time='{title}; unit=d' or time='{title}; unit=s'"
        )


def row_times(rows: int, period: float) -> Times:
    """Times of rows of which only the distance is known, s."""
    return Times(period * np.arange(rows, dtype=np.float64), None)


def _since(seconds: FloatArray) -> Times:
    """Times relative to the first one, so that they keep their precision; `seconds` are since 1970."""
    first = np.flatnonzero(np.isfinite(seconds))[:1]
    origin = float(seconds[first].sum())  # 0 if there is no time at all
    return Times(seconds - origin, origin)


def _dates(
    table: Table, title: str, texts: Mapping[int, str], order: str
) -> FloatArray:
    """Seconds since 1970 of the dates in a column, shape (N,); `order` is empty if they are ISO 8601.

    Raises:
        RecordingError: a cell is not a date, or only some of them have a time zone.
    """
    numbers = table.columns[title]
    seconds = np.full(numbers.size, np.nan)
    first_row: dict[bool, int] = {}  # by whether it has a time zone
    for k in sorted({*texts, *np.flatnonzero(np.isfinite(numbers)).tolist()}):
        text = texts.get(k, f"{numbers[k]:g}")
        stamp = in_order(text, order) if order else from_iso(text)
        if stamp is None:
            raise RecordingError(
                f"{table.place(k)}: {title!r} is {text.strip()[:40]!r}, neither a number nor a date such as "
                f"{'22/01/2021 14:48:58' if order else '2021-01-22 14:48:58.7'}"
            )
        seconds[k] = stamp
        if text.strip():
            has_zone = _ZONE.search(text.strip()) is not None
            first_row.setdefault(has_zone, k)
    if len(first_row) == 2:
        raise RecordingError(
            f"{table.place(first_row[True])}: {title!r} has a time zone, but none in "
            f"{table.row_name(first_row[False])}; write all rows alike"
        )
    return seconds
