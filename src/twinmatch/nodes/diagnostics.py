"""Health of a node as REP 107 diagnostics: the state to report, and the message for it.

`Health` collects the state and knows nothing of ROS; `Reporter` publishes it once a second.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

__all__ = ["Health", "Level", "Report", "Reporter", "status_message"]

PERIOD = 1.0
"""Reporting period (REP 107), s, by a clock that runs even while simulated time is stopped."""


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


class Health:
    """Counters, values and problems of one part of a node; thread-safe.

    A problem stands until it is withdrawn, so that a fault of a tenth of a second is seen by a reader that
    looks once a second. Without problems the report is OK.
    """

    def __init__(self, idle: str = "working") -> None:
        """Start without problems; `idle` is the message while there are none."""
        self._idle = idle
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

    def withdraw(self, key: str) -> None:
        """Withdraw the problem with this key, if it is flagged."""
        with self._lock:
            self._problems.pop(key, None)

    def report(self) -> Report:
        """The level of the worst problem, and the messages of all, worst first."""
        with self._lock:
            standing = sorted(self._problems.values(), key=lambda entry: -entry[0])
            values = dict(self._values)
            idle = self._idle
        if not standing:
            return Report(Level.OK, idle, values)
        return Report(standing[0][0], "; ".join(message for _, message in standing), values)


def status_message(name: str, hardware: str, report: Report) -> DiagnosticStatus:
    """One report as a message."""
    return DiagnosticStatus(
        level=bytes([report.level]),
        name=name,
        message=report.message,
        hardware_id=hardware,
        values=[KeyValue(key=key, value=value) for key, value in report.values.items()],
    )


class Reporter:
    """Publishes the health of a node's parts on /diagnostics."""

    def __init__(self, node: Node, tasks: Mapping[str, Callable[[], Report]], hardware: str = "") -> None:
        """Report the tasks, named `<node>: <key>`, every second from now on."""
        self._node = node
        self._tasks = tasks
        self._hardware = hardware
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(PERIOD, self.publish, clock=steady)

    def publish(self) -> None:
        """Report now, outside the regular period."""
        name = self._node.get_fully_qualified_name().lstrip("/")
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.status = [
            status_message(f"{name}: {key}", self._hardware, task()) for key, task in self._tasks.items()
        ]
        self._publisher.publish(message)
