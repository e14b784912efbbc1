"""Alarms of a plant with several signals: what has been said of it, and what is said now."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import Final

from twinmatch.health.faults import Alarm, Fault, touching
from twinmatch.health.suspects import Suspect

_KEPT: Final = 1000
"""Number of alarms kept."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelAlarm(Alarm):
    """One fault of one signal, from its beginning to its end; the signal of a `DRIFT` is the likeliest."""

    size: float
    """Of a drive's effect what is left, as a share; losses as a factor; of readings and room the change, in
    their unit; NaN for the others."""
    rivals: tuple[str, ...]
    """What the samples did not tell apart from it, in words; empty for a named fault."""
    suspects: tuple[Suspect, ...]
    """What competed when it was reported, the best first."""


class ChannelAlarms:
    """The newest alarms of one plant; one alarm is on at a time."""

    def __init__(self) -> None:
        """Begin without any."""
        self._alarms: deque[ChannelAlarm] = deque(maxlen=_KEPT)

    @property
    def kept(self) -> tuple[ChannelAlarm, ...]:
        """Those that are kept, oldest first; only the last can still be on."""
        return tuple(self._alarms)

    @property
    def newest(self) -> ChannelAlarm | None:
        """The last one that was raised, whether it is on or over."""
        return self._alarms[-1] if self._alarms else None

    @property
    def on(self) -> ChannelAlarm | None:
        """The alarm that is on."""
        newest = self.newest
        return newest if newest is not None and newest.last is None else None

    def is_on(self, fault: Fault, place: int) -> bool:
        """Whether the alarm that is on is of this fault of this parameter, drive or output; that of several readings
        that have jumped is of none."""
        on = self.on
        if on is None or not on.suspects:
            return False
        return (on.fault, on.suspects[0].cause[1]) == (fault, place)

    def begin(self, alarm: ChannelAlarm) -> None:
        """Raise an alarm; the one that is on ends."""
        self.end(alarm.flagged)
        self._alarms.append(alarm)

    def end(self, index: int, withdrawn: str = "") -> None:
        """End the alarm that is on, if there is one, at a sample; `withdrawn` says why though its cause stays."""
        on = self.on
        if on is not None:
            self._alarms[-1] = replace(on, last=index, withdrawn=withdrawn)

    def fault_between(self, first: int, last: int, *, slow: bool) -> Alarm | None:
        """The first alarm that touches these samples; see `touching`."""
        return touching(self._alarms, first, last, slow=slow)

    def excuses_between(self, first: int, last: int) -> bool:
        """Whether the plant is known to have been another between two samples, or to have become another."""
        return any(alarm.excuses_between(first, last) for alarm in self._alarms)
