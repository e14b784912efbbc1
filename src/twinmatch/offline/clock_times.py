"""Times of day and dates as people write them, in seconds after a sample."""

from __future__ import annotations

import re
from datetime import datetime, timedelta
from typing import Final

from twinmatch.errors import TwinmatchError

_AHEAD: Final = re.compile(r"\+(?P<seconds>\d+(?:\.\d*)?)")
_OF_DAY: Final = re.compile(
    r"(?P<hour>\d{1,2}):(?P<minute>\d{2})(?::(?P<second>\d{2}))?"
)
_DATED: Final = datetime(1990, 1, 1).timestamp()
"""Stamps before this are seconds since a recording began, not dates."""


class ClockTimeError(TwinmatchError):
    """A time is not written as one, or does not lie ahead."""


def seconds_until(text: str, stamp: int) -> float:
    """Seconds from a sample's stamp, ns, to a time: `HH:MM` or `HH:MM:SS` of this machine's clock, the next
    one after the sample; a date and time (ISO 8601); or `+SECONDS`.

    Raises:
        ClockTimeError: the text is none of these, is past, or the samples have no date.
    """
    ahead = _AHEAD.fullmatch(text.strip())
    if ahead is not None:
        return float(ahead["seconds"])
    now = stamp * 1e-9
    if now < _DATED:
        raise ClockTimeError(
            f"--by {text}: the samples have no date, only seconds; give +SECONDS"
        )
    seconds = _moment(text.strip(), datetime.fromtimestamp(now)).timestamp() - now
    if seconds <= 0.0:
        raise ClockTimeError(f"--by {text}: is not after the sample; give a later time")
    return seconds


def _moment(text: str, now: datetime) -> datetime:
    of_day = _OF_DAY.fullmatch(text)
    try:
        if of_day is None:
            return datetime.fromisoformat(text)
        hour = int(of_day["hour"])
        moment = now.replace(
            hour=hour,
            minute=int(of_day["minute"]),
            second=int(of_day["second"] or 0),
            microsecond=0,
        )
    except ValueError:
        raise ClockTimeError(
            f"--by {text[:80]!r} is not a time; give HH:MM, a date and time such as 2026-03-01T07:00, or "
            "+SECONDS"
        ) from None
    return moment if moment > now else moment + timedelta(days=1)


def clock_words(stamp: int, seconds: float) -> str:
    """The time so many seconds after a stamp, ns, by this machine's clock; empty without a date."""
    moment = stamp * 1e-9 + seconds
    return (
        datetime.fromtimestamp(moment).strftime("%H:%M:%S") if moment >= _DATED else ""
    )
