"""Base class of all nodes of this package: table of parameters, diagnostics, a worker thread, orderly end.

`NodeHealth` collects what REP 107 diagnostics report and knows nothing of ROS; `Reporter` publishes it once a
second. A `Worker` does a node's heavy work, so that its callbacks never wait.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from queue import Empty, SimpleQueue
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from twinmatch.errors import TwinmatchError
from twinmatch.nodes.step import InStep
from twinmatch.parameters.declared import ParameterError, Setting, Values, check

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


class NodeHealth:
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
            standing = sorted(self._problems.values(), key=lambda entry: -entry[0])
            values = dict(self._values)
            idle = self._idle
        if not standing:
            return Report(Level.OK, idle, values)
        return Report(standing[0][0], "; ".join(message for _, message in standing), values)


def status_message(name: str, report: Report) -> DiagnosticStatus:
    """One report as a message."""
    values = [KeyValue(key=key, value=value) for key, value in report.values.items()]
    return DiagnosticStatus(level=bytes([report.level]), name=name, message=report.message, values=values)


class Reporter:
    """Publishes the health of a node's parts on /diagnostics."""

    def __init__(self, node: Node, tasks: Mapping[str, Callable[[], Report]]) -> None:
        """Report the tasks, named `<node>: <key>`, every second from now on."""
        self._node = node
        self._tasks = tasks
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(PERIOD, self.publish, clock=steady)

    def publish(self) -> None:
        """Report now, outside the regular period."""
        name = self._node.get_fully_qualified_name().lstrip("/")
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.status = [status_message(f"{name}: {key}", task()) for key, task in self._tasks.items()]
        self._publisher.publish(message)


Item = TypeVar("Item")
PATIENCE = 0.2
"""Interval at which an idle worker checks whether it should end, s."""


class Worker(Generic[Item]):
    """Handles items in the order in which they were queued.

    Nothing is ever dropped: the items are small, and a lost sample would cost a whole window. After a
    `TwinmatchError` of the handler, which is reported, the next item is handled; any other exception is a
    defect, ends the worker and is kept in `failure`.
    """

    def __init__(self, handle: Callable[[Item], None], health: NodeHealth, backlog: int = 100) -> None:
        """Start the thread; more than `backlog` queued items are reported as a warning."""
        self.failure: Exception | None = None
        self._handle = handle
        self._health = health
        self._backlog = backlog
        self._items: SimpleQueue[Item] = SimpleQueue()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="worker", daemon=True)
        self._thread.start()

    @property
    def depth(self) -> int:
        """Number of queued items."""
        return self._items.qsize()

    def put(self, item: Item) -> None:
        """Queue an item."""
        self._items.put(item)

    def watch(self) -> None:
        """Report the queue's depth."""
        depth = self.depth
        self._health.set("queue depth", depth)
        message = f"{depth} messages are queued; they arrive faster than they are processed"
        self._health.flag_if(depth > self._backlog, "queue", Level.WARN, message)

    def close(self, timeout: float = 2.0) -> bool:
        """End the worker after its current item; returns whether it ended within the timeout (s)."""
        self._ending.set()
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while not self._ending.is_set():
            try:
                item = self._items.get(timeout=PATIENCE)
            except Empty:
                continue
            try:
                self._handle(item)
            except TwinmatchError as error:
                self._health.set("last error", error)
                self._health.count("errors")
                self._health.flag("error", Level.ERROR, str(error))
            except Exception as error:  # handed to the main thread, which ends the process with it
                self.failure = error
                return
            else:
                self._health.withdraw("error")


KEEPER = "keeper"
"""Name of the node that keeps the messages of a run."""

READERS = Setting(
    "readers", "", "Nodes that must receive every plant/sample and are waited for; names with spaces between."
)


class TwinmatchNode(Node):
    """A node with checked parameters that reports its health on /diagnostics.

    A subclass defines its name and parameters. What it creates in `open` it releases in `close`, which is
    called even when `open` failed half-way.
    """

    NAME: ClassVar[str]
    PARAMETERS: ClassVar[Sequence[Setting]] = ()
    FIXED: ClassVar[str] = "it is read once, when the node starts"
    """Why a parameter that is not changeable cannot be set while the node runs."""
    CLOSING: ClassVar[int] = 0
    """Time that `close` may take in addition to the runner's `TEARDOWN`, s."""
    step: InStep | None = None
    """Keeps a virtual plant in step with this process, if it runs faster than real time."""

    def __init__(self) -> None:
        """Read the parameters into `self.values`.

        Raises:
            ParameterError: a parameter does not exist, has the wrong type or is out of range.
            TwinmatchError: parameters contradict each other.
        """
        try:
            super().__init__(self.NAME, automatically_declare_parameters_from_overrides=True)
        except ValueError as error:  # an empty list or null has no type in ROS 2
            msg = f"{self.NAME}: a parameter is empty ([] or null); leave it out or give it a value"
            raise ParameterError(msg) from error
        self.exit_code: int | None = None
        """Set by a node that has finished: the process then exits with this code."""
        self.health = NodeHealth()
        self._reporter: Reporter | None = None
        try:
            self.values: Values = declare(self, self.table_for)
            self.read_parameters()
        except TwinmatchError:
            self.destroy_node()
            raise
        self.add_on_set_parameters_callback(self._on_set)

    def report_on(self, **tasks: Callable[[], Report]) -> None:
        """Start to publish the node's health on /diagnostics, together with these further tasks."""
        self._reporter = Reporter(self, {"health": self.report, **tasks})

    def report(self) -> Report:
        """The node's health; a subclass updates it first."""
        return self.health.report()

    def report_now(self) -> None:
        """Report outside the regular period, such as before the end."""
        if self._reporter is not None:
            self._reporter.publish()

    @classmethod
    def table_for(cls, given: Mapping[str, Any]) -> tuple[Sequence[Setting], Mapping[str, Any]]:
        """The node's parameters, which may depend on the given values, and the given values to check.

        Raises:
            ParameterError: the given values contradict each other.
        """
        return cls.PARAMETERS, given

    def read_parameters(self) -> None:
        """Derive what the node needs from `self.values`; after an error here there is no node."""

    def change(self, values: Values) -> None:
        """Adopt values of changeable parameters that were set while the node runs.

        Raises:
            TwinmatchError: they contradict each other; then nothing changes.
        """

    def open(self) -> None:
        """Create publishers, subscriptions and threads."""

    @property
    def failure(self) -> Exception | None:
        """The error that ended a thread of this node, if any."""
        return None

    @property
    def busy(self) -> bool:
        """Whether the process should stay up for a moment although a node in it has finished."""
        return False

    def close(self) -> bool:
        """End the node's threads; returns whether all of them ended."""
        return True

    def _on_set(self, parameters: Sequence[Any]) -> SetParametersResult:
        """Handle `ros2 param set`: check against the table, then let the node adopt the values."""
        given = {parameter.name: parameter.value for parameter in parameters}
        table = {parameter.name: parameter for parameter in self.table_for(self.values)[0]}
        values = dict(self.values)
        try:
            for name, value in given.items():
                if name not in table:  # a parameter that every ROS 2 node has
                    continue
                if not table[name].changeable:
                    msg = f"{self.NAME}: {name} cannot change now: {self.FIXED}; restart the node with it"
                    raise ParameterError(msg)
                values[name] = table[name].accept(value, self.NAME)
            if values != self.values:
                self.change(values)
        except TwinmatchError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self.values = values
        return SetParametersResult(successful=True)


def count_readers(node: Node, topic: str) -> int:
    """The number of subscribers of a topic, without the keeper, which runs in the publisher's process."""
    return sum(info.node_name != KEEPER for info in node.get_subscriptions_info_by_topic(topic))


def missing_readers(node: Node, topic: str, wanted: str) -> list[str]:
    """The wanted nodes (names with spaces between) that do not subscribe to the topic yet.

    Subscribers are matched by name: foreign programs may subscribe too, and come and go.
    """
    names = set(wanted.split())
    found = {info.node_name for info in node.get_subscriptions_info_by_topic(topic)} if names else set()
    return sorted(names - found)


def declare(
    node: Node, table_for: Callable[[Mapping[str, Any]], tuple[Sequence[Setting], Mapping[str, Any]]]
) -> Values:
    """Declare a node's parameters and return their values; `table_for` gets the values given.

    The node must have been created with `automatically_declare_parameters_from_overrides=True`, which makes
    all given names known; those in the table are then declared again with type, range and description.

    Raises:
        ParameterError: as for `check`.
    """
    given = {name: found.value for name, found in node.get_parameters_by_prefix("").items()}
    table, known = table_for(given)
    values = check(node.get_name(), table, known)
    for name in (*(name for name in given if name not in known), *(p.name for p in table)):
        if node.has_parameter(name):
            node.undeclare_parameter(name)
    for parameter in table:
        value = values[parameter.name]
        node.declare_parameter(parameter.name, value, _descriptor(parameter), ignore_override=True)
    return values


def _descriptor(parameter: Setting) -> ParameterDescriptor:
    """The description that `ros2 param describe` shows."""
    limits = parameter.limits
    text = f"{parameter.description} ({limits})" if limits else parameter.description
    constraint = "" if parameter.changeable else "read once, when the node starts"
    descriptor = ParameterDescriptor(description=text, additional_constraints=constraint)
    low, high = parameter.low, parameter.high
    if math.isfinite(low) and math.isfinite(high):
        if type(parameter.default) is float:
            span = FloatingPointRange(from_value=float(low), to_value=float(high))
            descriptor.floating_point_range = [span]
        elif type(parameter.default) is int:
            descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
    return descriptor
