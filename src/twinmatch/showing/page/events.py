"""The event log: matches, changes of the verdict, faults and node errors, in order of time."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum

__all__ = ["Event", "EventLog", "Lane", "Mark"]


class Lane(Enum):
    """The rows of the time line."""

    TRUST = "trust"
    MATCH = "match"
    FAULT = "fault"
    NODES = "nodes"


class Mark(Enum):
    """How good or bad an event is."""

    GOOD = "good"
    NOTE = "note"
    WARNING = "warning"
    BAD = "bad"


@dataclass(frozen=True)
class Event:
    """One thing that happened."""

    session: int
    """Which session it belongs to, counted from 1 since the page was started."""
    sample: int | None
    """Newest sample when it happened; None before the first sample."""
    lane: Lane
    mark: Mark
    title: str
    """What happened, in a few words."""
    text: str
    """Why, as the node reported it."""


class EventLog:
    """The newest events; the oldest are dropped."""

    def __init__(self, capacity: int) -> None:
        """Keep at most `capacity` events."""
        self._events: deque[Event] = deque(maxlen=capacity)
        self.count = 0
        """Events so far, including those dropped."""

    def add(self, event: Event) -> None:
        """Append an event."""
        self.count += 1
        self._events.append(event)

    def newest_first(self) -> list[Event]:
        """All events kept."""
        return list(reversed(self._events))
