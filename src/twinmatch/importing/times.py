"""Times of loggers as seconds: numbers with a unit, counts since 1970, dates.

Numbers far beyond any recording's length are counts since 1970, and their size gives the unit: seconds from
1e8 (1973), milliseconds from 1e11, microseconds from 1e14, nanoseconds from 1e17. Dates are ISO 8601
(`2021-01-22 14:48:58.720`, `2021-01-22T14:48:58Z`), or have the year last (`22/01/2021 14:48:58`); without a
time zone they are taken as UTC.

Whether the day or the month comes first differs from country to country, and `05/03/2026` is a date in both
orders. The rows decide: in the wrong order a day above 12 is not a month, and the step past midnight becomes
one of a month. So of the orders that give a date in every row, the one with the shorter longest step is
taken. Within one day both give the same times; then the day comes first, or the month before a clock with am
and pm. With dots the day comes first everywhere.

Spreadsheets count days since 1899-12-30. Nothing tells such numbers from seconds for certain, so a column
that looks like them is not guessed: its unit must be given.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime, timedelta, timezone
from typing import Final, NamedTuple

import numpy as np

from twinmatch.errors import TwinmatchError
from twinmatch.importing.tables import Table
from twinmatch.sessions.files import RecordingError
from twinmatch.signals import FloatArray
from twinmatch.units import conversion

DAY_FIRST: Final = "day/month/year"
MONTH_FIRST: Final = "month/day/year"
_LOCAL_DATE: Final = re.compile(
    r"(\d{1,2})([./-])(\d{1,2})\2(\d{4}|\d{2})[ ,T]+"
    r"(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,](\d{1,9}))?)?\s*([ap]\.?m\.?)?(Z|[+-]\d{2}:\d{2})?",
    re.IGNORECASE,
)
"""A date with the year last, and a time of day."""
_ZONE: Final = re.compile(r":\d{2}.*[+-](?!00:?00)\d{2}:?\d{2}$")
"""A time zone other than UTC."""
_SINCE_1970: Final = 1e8
"""Times from here on, s, are counted from 1970: it was reached in 1973."""
_UNITS_SINCE_1970: Final = ((1e17, 1e9), (1e14, 1e6), (1e11, 1e3), (_SINCE_1970, 1.0))
"""Size from which a number is a count since 1970, and its units per second."""
_UNIT_AT_END: Final = re.compile(
    r".[ _.-](ns|us|ms|s|secs?|seconds?|min|mins|minutes?|h|hrs?|hours?|d|days?)$", re.I
)
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
        scale: factor applied to the numbers first.

    Raises:
        RecordingError: a cell is not a time, or the unit is not one of time.
    """
    texts = table.texts.get(title)
    if texts:
        before_first_text = table.columns[title][: min(texts)]
        if not np.isfinite(before_first_text).any():
            first_text = next(iter(texts.values()))
            order = order_of(texts.values()) if is_local(first_text) else ""
            return _since(_dates(table, title, texts, order))._replace(order=order)
    values = table.values(title) * scale
    sizes = np.abs(values[np.isfinite(values)])
    largest = float(np.max(sizes, initial=0.0))
    unit = unit or table.unit(title) or unit_in(title)
    if unit:
        per_second = _per_second(table, title, unit)
    else:
        _require_no_days(table, title, values)
        per_second = next((count for least, count in _UNITS_SINCE_1970 if largest >= least), 1.0)
    if per_second == 1.0 / _DAY and _may_be_days(values):
        return _since((values - _EPOCH_IN_DAYS) * _DAY)
    if largest / per_second >= _SINCE_1970:
        return _since(values / per_second)
    return Times(values / per_second, None)


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
    ending = _UNIT_AT_END.search(title.strip())
    return ending[1].lower() if ending else ""


def _may_be_days(values: FloatArray) -> bool:
    """Whether all are days of a spreadsheet from 2000 to 2100."""
    finite = values[np.isfinite(values)]
    return bool(finite.size) and bool((finite >= _LIKELY_DAYS[0]).all() and (finite < _LIKELY_DAYS[1]).all())


def _require_no_days(table: Table, title: str, values: FloatArray) -> None:
    """Refuse numbers without a unit that may be days of a spreadsheet as well as seconds."""
    finite = values[np.isfinite(values)]
    if finite.size > 1 and _may_be_days(values) and np.median(np.abs(np.diff(finite))) < _LONGEST_STEP:
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


def _dates(table: Table, title: str, texts: Mapping[int, str], order: str) -> FloatArray:
    """Seconds since 1970 of the dates in a column, shape (N,); `order` is empty if they are ISO 8601.

    Raises:
        RecordingError: a cell is not a date, or only some of them have a time zone.
    """
    numbers = table.columns[title]
    seconds = np.full(numbers.size, np.nan)
    first_row: dict[bool, int] = {}  # by whether it has a time zone
    for k in sorted({*texts, *np.flatnonzero(np.isfinite(numbers)).tolist()}):
        text = texts.get(k, f"{numbers[k]:g}")
        stamp = in_order(text, order) if order else _from_iso(text)
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


def _from_iso(text: str) -> float | None:
    """Seconds since 1970 of a date of ISO 8601, as UTC without a time zone; None if the text is not one."""
    plain = text.strip().replace("/", "-").replace(",", ".")
    plain = plain[:-1] + "+00:00" if plain.endswith(("Z", "z")) else plain
    head, dot, tail = plain.partition(".")
    if dot:  # Python 3.10 accepts three or six decimals, loggers write any number
        digits = len(tail) - len(tail.lstrip("0123456789"))
        plain = f"{head}.{tail[:digits][:6]:0<6}{tail[digits:]}"
    try:
        stamp = datetime.fromisoformat(plain)
    except ValueError:
        return None
    return (stamp if stamp.tzinfo else stamp.replace(tzinfo=timezone.utc)).timestamp()


def is_local(text: str) -> bool:
    """Whether a cell has the form of a date with the year last, and of a time of day."""
    return _LOCAL_DATE.fullmatch(text.strip()) is not None


def in_order(text: str, order: str) -> float | None:
    """Seconds since 1970 of a date with the year last, as UTC without a time zone.

    None if the text is not a date in this `order` of day and month.
    """
    match = _LOCAL_DATE.fullmatch(text.strip())
    if match is None:
        return None
    first, _, second, year, hour, minute, seconds, fraction, am_or_pm, zone = match.groups()
    day, month = (first, second) if order == DAY_FIRST else (second, first)
    if am_or_pm is not None and not 1 <= int(hour) <= 12:
        return None
    hours = int(hour)
    if am_or_pm is not None:
        hours = hours % 12 + (12 if am_or_pm[0] in "pP" else 0)
    try:
        stamp = datetime(
            int(year) + (2000 if len(year) == 2 else 0),
            int(month),
            int(day),
            hours,
            int(minute),
            int(seconds or 0),
            tzinfo=timezone.utc,
        )
    except ValueError:
        return None
    hours_east = 0 if zone in {None, "Z", "z"} else int(f"{zone[0]}1") * (int(zone[1:3]) + int(zone[4:]) / 60)
    return (stamp + timedelta(seconds=float(f"0.{fraction or 0}"), hours=-hours_east)).timestamp()


def order_of(texts: Iterable[str]) -> str:
    """The order of day and month in a column of dates with the year last; empty cells are skipped."""
    dates = [text.strip() for text in texts if text.strip()]
    if not dates:
        return DAY_FIRST
    has_dots = "." in dates[0][:3]
    if has_dots:
        return DAY_FIRST
    has_am_or_pm = dates[0][-1] in "mM."
    orders = (MONTH_FIRST, DAY_FIRST) if has_am_or_pm else (DAY_FIRST, MONTH_FIRST)
    return min(orders, key=lambda order: _longest_step(dates, order))  # of equal ones the first


def _longest_step(texts: Sequence[str], order: str) -> float:
    """The longest time between two rows, s; infinite if a row is not a date in this order."""
    stamps = [in_order(text, order) for text in texts]
    if any(stamp is None for stamp in stamps):
        return np.inf
    seconds: FloatArray = np.array(stamps, dtype=np.float64)
    return float(np.abs(np.diff(seconds)).max(initial=0.0))
