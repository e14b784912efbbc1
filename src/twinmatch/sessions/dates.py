"""Dates of loggers that write day and month before the year, such as `22/01/2021 14:48:58`.

Whether the day or the month comes first differs from country to country, and `05/03/2026` is a date in both
orders. The rows decide: in the wrong order a day above 12 is not a month, and the step past midnight becomes
one of a month. So of the orders that give a date in every row, the one with the shorter longest step is
taken. Within one day both give the same times; then the day comes first, or the month before a clock with am
and pm. With dots the day comes first everywhere.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime, timedelta, timezone
from typing import Final

import numpy as np

from twinmatch.signals import FloatArray

__all__ = ["DAY_FIRST", "MONTH_FIRST", "in_order", "is_local", "order_of"]

DAY_FIRST: Final = "day/month/year"
MONTH_FIRST: Final = "month/day/year"
_FORM: Final = re.compile(
    r"(\d{1,2})([./-])(\d{1,2})\2(\d{4}|\d{2})[ ,T]+"
    r"(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,](\d{1,9}))?)?\s*([ap]\.?m\.?)?(Z|[+-]\d{2}:\d{2})?",
    re.IGNORECASE,
)


def is_local(text: str) -> bool:
    """Whether a cell has the form of such a date, with a time of day."""
    return _FORM.fullmatch(text.strip()) is not None


def in_order(text: str, order: str) -> float | None:
    """Seconds since 1970 of a date in this order, as UTC without a time zone; None if it is none."""
    match = _FORM.fullmatch(text.strip())
    if match is None:
        return None
    first, _, second, year, hour, minute, seconds, part, half, zone = match.groups()
    day, month = (first, second) if order == DAY_FIRST else (second, first)
    if half is not None and not 1 <= int(hour) <= 12:
        return None
    hours = int(hour) if half is None else int(hour) % 12 + (12 if half[0] in "pP" else 0)
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
    return (stamp + timedelta(seconds=float(f"0.{part or 0}"), hours=-hours_east)).timestamp()


def order_of(texts: Sequence[str]) -> str:
    """The order of day and month in a column of such dates; empty cells are skipped."""
    held = [text for text in texts if text.strip()]
    usual = MONTH_FIRST if held and held[0].strip()[-1] in "mM." else DAY_FIRST
    if held and "." in held[0].strip()[:3]:
        return DAY_FIRST
    other = DAY_FIRST if usual == MONTH_FIRST else MONTH_FIRST
    return min((usual, other), key=lambda order: _longest_step(held, order))  # of equal ones the first


def _longest_step(texts: Sequence[str], order: str) -> float:
    """The longest time between two rows, s; infinite if a row is not a date in this order."""
    stamps = [in_order(text, order) for text in texts]
    if any(stamp is None for stamp in stamps):
        return np.inf
    seconds: FloatArray = np.array(stamps, dtype=np.float64)
    return float(np.abs(np.diff(seconds)).max(initial=0.0))
