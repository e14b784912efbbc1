"""The health of a node, as REP 107 diagnostics report it."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from enum import IntEnum
from typing import Final, NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from twinmatch.printing import printable

PLANT_REPORT: Final = "discriminator: plant"
"""End of the name of the report on the plant's own health on /diagnostics.

The report is for programs that read nothing else; displays that show verdicts leave it out.
"""


class Level(IntEnum):
    """Levels of REP 107; the worst of several is their maximum."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class Report(NamedTuple):
    """The status of one part of a node."""

    level: Level
    message: str
    values: Mapping[str, str]


class NodeHealth:
    """Counters, values and problems of one part of a node; thread-safe.

    A problem stands until it is withdrawn, so that a fault of a tenth of a second is seen by a reader that
    looks once a second. Without problems the report is OK.
    """

    def __init__(self) -> None:
        """Start without problems."""
        self._idle = "working"
        self._values: dict[str, str] = {}
        self._problems: dict[str, tuple[Level, str]] = {}
        self._lock = threading.Lock()

    def set(self, key: str, value: object) -> None:
        """Set a value."""
        with self._lock:
            self._values[key] = f"{value:g}" if isinstance(value, float) else str(value)

    def count(self, key: str) -> None:
        """Increment a counter."""
        with self._lock:
            self._values[key] = str(int(self._values.get(key, "0")) + 1)

    def say(self, message: str) -> None:
        """Set the message that is reported while there is no problem."""
        with self._lock:
            self._idle = message

    def flag(self, key: str, level: Level, message: str) -> None:
        """Report a problem, in place of an earlier one with this key."""
        with self._lock:
            self._problems[key] = (level, message)

    def flag_if(self, failed: bool, key: str, level: Level, message: str) -> None:
        """Report a problem, or withdraw it, whether or not it was reported."""
        if failed:
            self.flag(key, level, message)
        else:
            self.withdraw(key)

    def withdraw(self, key: str) -> None:
        """Withdraw the problem with this key, if it is flagged."""
        with self._lock:
            self._problems.pop(key, None)

    def report(self) -> Report:
        """The level of the worst problem, and the messages of all, worst first."""
        with self._lock:
            standing = sorted(self._problems.values(), key=lambda problem: -problem[0])
            values = dict(self._values)
            idle = self._idle
        if not standing:
            return Report(Level.OK, idle, values)
        return Report(
            standing[0][0], "; ".join(message for _, message in standing), values
        )


def status_message(name: str, report: Report) -> DiagnosticStatus:
    """One report as a message."""
    values = [
        KeyValue(key=key, value=printable(value))
        for key, value in report.values.items()
    ]
    message = printable(report.message)  # what cannot be encoded cannot be sent
    return DiagnosticStatus(
        level=bytes([report.level]), name=name, message=message, values=values
    )
