"""Health of a node as REP 107 diagnostics: what to report, and the message it becomes.

A `Health` is told what happens and knows nothing of ROS; `Reporter` publishes it once a second.
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
"""Seconds between two reports (REP 107), by a clock that runs even when simulated time stands."""


class Level(IntEnum):
    """Levels of REP 107; the worst of several is their maximum."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class Report(NamedTuple):
    """What one part of a node says of itself."""

    level: Level
    message: str
    values: Mapping[str, str]


class Health:
    """Counters, values and complaints of one part of a node; may be told things from any thread.

    A complaint stands until it is withdrawn, so that a fault of a tenth of a second is seen by a reader
    that looks once a second. Without complaints the report is OK.
    """

    def __init__(self, idle: str = "working") -> None:
        """Begin with nothing to report but `idle`, the message while all is well."""
        self._idle = idle
        self._values: dict[str, str] = {}
        self._complaints: dict[str, tuple[Level, str]] = {}
        self._lock = threading.Lock()

    def set(self, key: str, value: object) -> None:
        """Show a value."""
        with self._lock:
            self._values[key] = f"{value:g}" if isinstance(value, float) else str(value)

    def count(self, key: str) -> None:
        """Show one more of something."""
        with self._lock:
            self._values[key] = str(int(self._values.get(key, "0")) + 1)

    def say(self, message: str) -> None:
        """What the report says while there is no complaint."""
        with self._lock:
            self._idle = message

    def complain(self, about: str, level: Level, message: str) -> None:
        """Raise a complaint, or replace the one about the same thing."""
        with self._lock:
            self._complaints[about] = (level, message)

    def withdraw(self, about: str) -> None:
        """Withdraw the complaint about something, if there is one."""
        with self._lock:
            self._complaints.pop(about, None)

    def report(self) -> Report:
        """The worst complaint as level, all of them as message, worst first."""
        with self._lock:
            standing = sorted(self._complaints.values(), key=lambda entry: -entry[0])
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
        """Report now, out of turn."""
        name = self._node.get_fully_qualified_name().lstrip("/")
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.status = [
            status_message(f"{name}: {key}", self._hardware, task()) for key, task in self._tasks.items()
        ]
        self._publisher.publish(message)
