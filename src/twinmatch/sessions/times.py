"""Times of loggers as seconds: numbers with a unit, counts since 1970, dates.

Numbers far beyond any recording's length are counts since 1970, and their size gives the unit: seconds from
1e8 (1973), milliseconds from 1e11, microseconds from 1e14, nanoseconds from 1e17. Dates are ISO 8601
(`2021-01-22 14:48:58.720`, `2021-01-22T14:48:58Z`), or have the year last (`22/01/2021 14:48:58`); without a
time zone they are taken as UTC.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timezone
from typing import NamedTuple

import numpy as np

from twinmatch.errors import TwinmatchError
from twinmatch.sessions.dates import in_order, is_local, order_of
from twinmatch.sessions.errors import RecordingError
from twinmatch.sessions.tables import Table, number
from twinmatch.signals import FloatArray
from twinmatch.units import conversion

__all__ = ["Times", "read_times", "row_times"]

_COUNTS = ((1e17, 1e9), (1e14, 1e6), (1e11, 1e3), (1e8, 1.0))
"""Size from which a number is a count since 1970, and its units per second."""


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
        title: title of the column.
        unit: unit of the numbers; empty: that in the title, or judged by their size.
        scale: factor applied to the numbers first.

    Raises:
        RecordingError: a cell is not a time, or the unit is not one of time.
    """
    column = table.columns[title]
    if not isinstance(column, np.ndarray):
        first = next((text for text in column if text.strip()), "")
        if number(first, table.decimal) is None:
            order = order_of(column) if is_local(first) else ""
            return _since(_dates(table, title, column, order))._replace(order=order)
    values = table.values(title) * scale
    unit = unit or table.unit(title)
    size = float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))
    if unit:
        try:
            per_second = 1.0 / conversion(unit, "s").scale
        except TwinmatchError:
            msg = f"{table.path}: {title!r} is in {unit}, not a unit of time; write time='{title}; unit=s'"
            raise RecordingError(msg) from None
    else:
        per_second = next((count for least, count in _COUNTS if size >= least), 1.0)
    if size / per_second >= 1e8:
        return _since(values / per_second)
    return Times(values / per_second, None)


def row_times(rows: int, period: float) -> Times:
    """Times of rows of which only the distance is known, s."""
    return Times(period * np.arange(rows, dtype=np.float64), None)


def _since(seconds: FloatArray) -> Times:
    """Times relative to the first one, which keeps their precision."""
    origin = float(seconds[np.flatnonzero(np.isfinite(seconds))[:1]].sum())
    return Times(seconds - origin, origin)


def _dates(table: Table, title: str, column: Sequence[str], order: str) -> FloatArray:
    seconds = np.full(len(column), np.nan)
    for k, text in enumerate(column):
        if not text.strip():
            continue
        stamp = in_order(text, order) if order else _date(text)
        if stamp is None:
            msg = (
                f"{table.place(k)}: {title!r} is {text.strip()[:40]!r}, neither a number nor a date such as "
                f"{'22/01/2021 14:48:58' if order else '2021-01-22 14:48:58.7'}"
            )
            raise RecordingError(msg)
        seconds[k] = stamp
    return seconds


def _date(text: str) -> float | None:
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
