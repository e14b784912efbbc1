"""Dates, times of day and durations as loggers write them, as seconds.

Dates are ISO 8601 (`2021-01-22 14:48:58.720`, `2021-01-22T14:48:58Z`), or have the year last
(`22/01/2021 14:48:58`), or the name of the month (`22-Jan-2021 14:48:58`). Without a time zone they are taken
as UTC, and without a time of day as midnight.

Whether the day or the month comes first differs from country to country, and `05/03/2026` is a date in both
orders. The rows decide: in the wrong order a day above 12 is not a month, and the step past midnight becomes
one of a month. So of the orders that give a date in every row, the one with the shorter longest step is
taken. Within one day both give the same times; then the day comes first, or the month before a clock with am
and pm. With dots the day comes first everywhere.

A time without a date (`14:48:58`, `0d 00:00:02.00`, `2:05:03 PM`) is a duration or a time of day; both are
seconds from their zero. Two numbers, as in `12:30`, may be minutes and seconds or hours and minutes: only
`12:30.5` tells.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from datetime import datetime, timedelta, timezone
from typing import Final

import numpy as np

from twinmatch.signals import FloatArray

__all__ = [
    "DAY_FIRST",
    "MONTH_FIRST",
    "clock_seconds",
    "from_iso",
    "in_order",
    "is_date",
    "is_local",
    "is_two_numbers",
    "order_of",
]

DAY_FIRST: Final = "day/month/year"
MONTH_FIRST: Final = "month/day/year"
_LOCAL_DATE: Final = re.compile(
    r"(\d{1,2})([./-])(\d{1,2})\2(\d{4}|\d{2})(?:[ ,T]+"
    r"(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,:](\d{1,9}))?)?\s*([ap]\.?m\.?)?(Z|[+-]\d{2}:\d{2})?)?",
    re.IGNORECASE,
)
"""A date with the year last, and perhaps a time of day."""
_CLOCK: Final = re.compile(
    r"(?:(?P<days>\d{1,5})\s*(?:d|days?|\.)[ ,]*)?(?P<first>\d{1,6}):(?P<second>\d{2})"
    r"(?::(?P<third>\d{2}))?(?:[.,](?P<fraction>\d{1,9}))?\s*(?P<half>[ap]\.?m\.?)?",
    re.IGNORECASE,
)
"""A duration or a time of day: perhaps days, then two or three numbers."""
_DAY: Final = 86400.0
_COLON_FRACTION: Final = re.compile(r"(:\d{2}:\d{2}):(\d{1,6})$")
"""Milliseconds behind a colon."""
_MONTHS: Final = [
    "jan",
    "feb",
    "mar",
    "apr",
    "may",
    "jun",
    "jul",
    "aug",
    "sep",
    "oct",
    "nov",
    "dec",
]
_HOURS_EAST: Final = {
    **{
        "UTC": 0,
        "GMT": 0,
        "WET": 0,
        "CET": 1,
        "MEZ": 1,
        "CEST": 2,
        "MESZ": 2,
        "EET": 2,
        "EEST": 3,
    },
    **{"EST": -5, "EDT": -4, "CDT": -5, "MDT": -6, "PST": -8, "PDT": -7},
}
"""Names of time zones, and their hours east of Greenwich; without those that mean several."""
_ZONES: Final = "|".join(_HOURS_EAST)
_ZONE_AT_END: Final = re.compile(rf"\s*\b({_ZONES})$")
_WEEKDAY: Final = r"(?:[A-Za-z]{3,9},?\s+)?"
_MONTH: Final = r"(?P<month>[A-Za-z]{3})[a-z]*\.?"
_DAY_AND_NAME: Final = re.compile(
    rf"{_WEEKDAY}(?P<day>\d{{1,2}})[-\s]+{_MONTH}[-\s,]+(?P<year>\d{{4}})[\s,T]+(?P<clock>\d.*)"
)
_NAME_AND_DAY: Final = re.compile(
    rf"{_WEEKDAY}{_MONTH}\s+(?P<day>\d{{1,2}}),?\s+(?P<year>\d{{4}}),?\s+(?P<clock>\d.*)"
)
_NAME_AND_YEAR_LAST: Final = re.compile(
    rf"{_WEEKDAY}{_MONTH}\s+(?P<day>\d{{1,2}})\s+(?P<clock>\d[\d:.]*\s+(?:{_ZONES})?)\s*"
    r"(?P<year>\d{4})"
)
"""Dates with the name of a month, in English."""


def clock_seconds(text: str, unit_of_first: str = "") -> float | None:
    """Seconds of a duration or a time of day, such as `0d 00:00:02.00`; None if the text is neither.

    `unit_of_first` is `h` or `min`, that of the first of only two numbers; empty: minutes if a fraction
    follows the second, else not known, which gives None.
    """
    match = _CLOCK.fullmatch(text.strip())
    if match is None or (match["days"] and match["third"] is None):
        return None
    numbers = [float(match["first"]), float(match["second"])]
    if match["third"] is not None:
        numbers.append(float(match["third"]))
    if max(numbers[1:]) >= 60.0:
        return None
    if len(numbers) == 2:
        if match["half"]:
            unit_of_first = "h"
        elif not unit_of_first and match["fraction"]:
            unit_of_first = "min"
        if not unit_of_first:
            return None
        numbers = [*numbers, 0.0] if unit_of_first == "h" else [0.0, *numbers]
    hours, minutes, seconds = numbers
    if match["half"]:
        if not 1.0 <= hours <= 12.0:
            return None
        hours = hours % 12.0 + (12.0 if match["half"][0] in "pP" else 0.0)
    days = float(match["days"] or 0)
    return (
        days * _DAY
        + hours * 3600.0
        + minutes * 60.0
        + seconds
        + float(f"0.{match['fraction'] or 0}")
    )


def is_two_numbers(text: str) -> bool:
    """Whether a text is a duration or a time of day of only two numbers, such as `12:30`."""
    match = _CLOCK.fullmatch(text.strip())
    return match is not None and match["third"] is None and not match["days"]


def is_date(text: str) -> bool:
    """Whether a text is a date, with or without a time of day, or a time with three numbers."""
    plain = text.strip()
    if plain.isdigit() or not any(character.isdigit() for character in plain[:9]):
        return False
    return (
        from_iso(plain) is not None
        or is_local(plain)
        or clock_seconds(plain, "h") is not None
    )


def from_iso(text: str) -> float | None:
    """Seconds since 1970 of a date of ISO 8601, as UTC without a time zone; None if the text is not one."""
    plain = _without_names(text.strip())
    plain = plain.replace("/", "-").replace(",", ".")
    plain = _ZONE_AT_END.sub(
        lambda zone: f"{_HOURS_EAST[zone[1]]:+03d}:00", plain.rstrip()
    )
    plain = _COLON_FRACTION.sub(r"\1.\2", plain)
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


def _without_names(text: str) -> str:
    """A date with the name of its month, such as `01-Mar-2026 10:00:00`, as one of ISO 8601; others as is."""
    for form in (_DAY_AND_NAME, _NAME_AND_DAY, _NAME_AND_YEAR_LAST):
        match = form.fullmatch(text)
        if match is not None and match["month"].lower() in _MONTHS:
            month = _MONTHS.index(match["month"].lower()) + 1
            return (
                f"{match['year']}-{month:02d}-{int(match['day']):02d} {match['clock']}"
            )
    return text


def is_local(text: str) -> bool:
    """Whether a cell has the form of a date with the year last, perhaps with a time of day."""
    return _LOCAL_DATE.fullmatch(text.strip()) is not None


def in_order(text: str, order: str) -> float | None:
    """Seconds since 1970 of a date with the year last, as UTC without a time zone.

    None if the text is not a date in this `order` of day and month.
    """
    match = _LOCAL_DATE.fullmatch(text.strip())
    if match is None:
        return None
    first, _, second, year, hour, minute, seconds, fraction, am_or_pm, zone = (
        match.groups()
    )
    day, month = (first, second) if order == DAY_FIRST else (second, first)
    if am_or_pm is not None and not 1 <= int(hour) <= 12:
        return None
    hours = int(hour or 0)
    if am_or_pm is not None:
        hours = hours % 12 + (12 if am_or_pm[0] in "pP" else 0)
    try:
        stamp = datetime(
            int(year) + (2000 if len(year) == 2 else 0),
            int(month),
            int(day),
            hours,
            int(minute or 0),
            int(seconds or 0),
            tzinfo=timezone.utc,
        )
    except ValueError:
        return None
    hours_east = (
        0
        if zone in {None, "Z", "z"}
        else int(f"{zone[0]}1") * (int(zone[1:3]) + int(zone[4:]) / 60)
    )
    return (
        stamp + timedelta(seconds=float(f"0.{fraction or 0}"), hours=-hours_east)
    ).timestamp()


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
    # of equal ones the first
    return min(orders, key=lambda order: _longest_step(dates, order))


def _longest_step(texts: Sequence[str], order: str) -> float:
    """The longest time between two rows, s; infinite if a row is not a date in this order."""
    stamps = [in_order(text, order) for text in texts]
    if any(stamp is None for stamp in stamps):
        return np.inf
    seconds: FloatArray = np.array(stamps, dtype=np.float64)
    return float(np.abs(np.diff(seconds)).max(initial=0.0))
