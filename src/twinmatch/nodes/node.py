"""Base class of all nodes of this package: parameters, entrance, diagnostics, a worker thread, orderly end.

Everything that a node receives comes through its `Entrance`. A `Worker` does a node's heavy work, so that
its callbacks never wait.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from queue import Empty, SimpleQueue
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.node import Node
from rclpy.timer import Timer

from twinmatch.ending import end_in_order
from twinmatch.errors import TwinmatchError
from twinmatch.links import Background
from twinmatch.nodes.entrance import Entrance
from twinmatch.nodes.health import Level, NodeHealth, Report, status_message
from twinmatch.nodes.step import InStep
from twinmatch.parameters.declared import ParameterError, Setting, Values, check

PERIOD = 1.0
"""Reporting period (REP 107), s, by a clock that runs even while simulated time is stopped."""


Queued = TypeVar("Queued")
PATIENCE = 0.2
"""Interval at which an idle worker checks whether it should end, s."""


class Worker(Background, Generic[Queued]):
    """Handles what is queued, in the order in which it came.

    Nothing is ever dropped: what is queued is small, and a lost sample would cost a whole window. After a
    `TwinmatchError` of the handler, which is reported, it continues with the next; any other exception is a
    defect and ends the worker.
    """

    def __init__(
        self, handle: Callable[[Queued], None], health: NodeHealth, backlog: int = 100
    ) -> None:
        """Start the thread; a queue longer than `backlog` is reported as a warning."""
        super().__init__("worker", self._work)
        self._handle = handle
        self._health = health
        self._backlog = backlog
        self._queue: SimpleQueue[Queued] = SimpleQueue()
        self.start()

    @property
    def depth(self) -> int:
        """Length of the queue."""
        return self._queue.qsize()

    def put(self, queued: Queued) -> None:
        """Queue this for the handler."""
        self._queue.put(queued)

    def watch(self) -> None:
        """Report the queue's depth."""
        depth = self.depth
        self._health.set("queue depth", depth)
        message = (
            f"{depth} messages are queued; they arrive faster than they are processed"
        )
        self._health.flag_if(depth > self._backlog, "queue", Level.WARN, message)

    def _work(self) -> None:
        while not self.ending.is_set():
            try:
                self._handle(self._queue.get(timeout=PATIENCE))
            except Empty:
                continue
            except TwinmatchError as error:
                self._health.set("last error", error)
                self._health.count("errors")
                self._health.flag("error", Level.ERROR, str(error))
            else:
                self._health.withdraw("error")


KEEPER = "keeper"
"""Name of the node that keeps the messages of a run."""


class Readers:
    """The readers that a node waits for before its first sample, by the wall clock.

    Nodes are matched by name: foreign programs may subscribe too, and come and go.
    """

    def __init__(
        self, node: TwinmatchNode, topic: str, timeout: float, number: int = 0
    ) -> None:
        """Wait for the nodes of the parameter `readers` and so many subscribers, `timeout` s at most."""
        self._node = node
        self._topic = topic
        self._timeout = timeout
        self._number = number
        self._names = set(node.values["readers"].split())
        self._until = time.monotonic() + timeout
        self.awaited = True
        """Whether the readers are still waited for."""

    @property
    def lacking(self) -> str:
        """Which readers do not subscribe yet, as a sentence; empty if none is missing."""
        if not (self._names or self._number):
            return ""
        names = [
            info.node_name
            for info in self._node.get_subscriptions_info_by_topic(self._topic)
        ]
        if missing := sorted(self._names.difference(names)):
            return f"{', '.join(missing)} did not subscribe to {self._topic}"
        # the keeper runs in the publisher's process
        number = sum(name != KEEPER for name in names)
        return (
            ""
            if number >= self._number
            else f"{self._topic} has {number} of {self._number} subscribers"
        )

    @property
    def late(self) -> bool:
        """Whether the time to wait is over."""
        return time.monotonic() > self._until

    def there(self) -> bool:
        """Whether the first sample may be published; readers that are missing when the wait is over are a
        warning."""
        if self.awaited:
            lacking = self.lacking
            if lacking and not self.late:
                return False
            if lacking:
                text = f"{lacking} after {self._timeout:g} s; started without them"
                self._node.get_logger().warning(text)
                self._node.health.flag("readers", Level.WARN, text)
            self.awaited = False
        return True


class Missed:
    """Reports the ticks that a loop has missed, for `REMEMBER` ticks after the last of them."""

    REMEMBER = 60

    def __init__(self, health: NodeHealth, subject: str = "") -> None:
        """`subject` precedes the message."""
        self._health = health
        self._subject = subject
        self._count = self._index = 0

    def watch(self, count: int, index: int) -> None:
        """Take the number of missed ticks so far and the newest index."""
        if count != self._count:
            self._count = count
            self._index = index
            text = f"{self._subject}ticks were missed, {count} in all; behind a long gap windows start over"
            self._health.flag("missed", Level.WARN, text)
        elif index - self._index > self.REMEMBER:
            self._health.withdraw("missed")


class Running(Protocol):
    """What runs beside a node's callbacks: a thread, or the client of a service."""

    @property
    def failure(self) -> Exception | None:
        """The error that ended it, if any."""

    def close(self) -> bool:
        """End it; returns whether it ended in time."""


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
    LINGER: ClassVar[float] = 0.0
    """Time after a signal in which messages are still taken: those that were sent before it, s."""
    step: InStep | None = None
    """Keeps a virtual plant in step with this process, if it runs faster than real time."""
    failed: Exception | None = None
    """Set by a node that cannot continue: the process then ends with it."""
    _diagnostics: Any = None

    def __init__(self, context: Context | None = None) -> None:
        """Read the parameters into `self.values`; by default in the context of the process.

        Raises:
            ParameterError: a parameter does not exist, has the wrong type or is out of range.
            TwinmatchError: parameters contradict each other.
        """
        self.health = NodeHealth()
        self.entrance = Entrance(self, self.health)
        try:
            super().__init__(
                self.NAME,
                context=context,
                automatically_declare_parameters_from_overrides=True,
            )
        except ValueError as error:  # an empty list or null has no type in ROS 2
            msg = f"{self.NAME}: a parameter is empty ([] or null); leave it out or give it a value"
            raise ParameterError(msg) from error
        self.exit_code: int | None = None
        """Set by a node that has finished: the process then exits with this code."""
        self.beside: list[Running] = []
        """What runs beside the callbacks, in the order in which it is closed."""
        try:
            self.values: Values = declare(self, self.table_for)
            self.read_parameters()
        except TwinmatchError:
            self.destroy_node()
            raise
        self.add_on_set_parameters_callback(self._on_set)

    def wall_timer(self, period: float, call: Callable[[], object]) -> Timer:
        """Call this every `period` s by a clock that runs even while simulated time is stopped."""
        return self.create_timer(
            period, call, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def create_subscription(
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[[Any], None],
        qos_profile: Any,
        **options: Any,
    ) -> Any:
        """Subscribe through the entrance: `callback` gets what `expected.MESSAGES` makes of a message.

        Bytes that are not a message reach it, too; a subscription of rclpy's that is not raw drops them.
        """
        course = self.entrance.course(msg_type, topic)
        take = self.entrance.before(
            msg_type, topic, callback, course, raw=options.get("raw", False)
        )
        raw_options = options | {"raw": True}
        subscription = super().create_subscription(
            msg_type, topic, take, qos_profile, **raw_options
        )
        if course is not None and course.owned:
            course.second = self.entrance.second(subscription)
        return subscription

    def destroy_subscription(self, subscription: Any) -> bool:
        """Destroy a subscription, and what watches it."""
        self.entrance.release(subscription)
        return bool(super().destroy_subscription(subscription))

    def create_service(
        self,
        srv_type: Any,
        srv_name: str,
        callback: Callable[[Any, Any], Any],
        **options: Any,
    ) -> Any:
        """Serve through the entrance."""
        answer = self.entrance.serving(srv_name, callback)
        return super().create_service(srv_type, srv_name, answer, **options)

    def report_on(self, **tasks: Callable[[], Report]) -> None:
        """Publish the node's health on /diagnostics every `PERIOD`, together with these further tasks."""
        self._tasks = {"health": self.report, **tasks}
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.wall_timer(PERIOD, self.report_now)

    def report(self) -> Report:
        """The node's health; a subclass updates it first."""
        return self.health.report()

    def report_now(self) -> None:
        """Report, also outside the regular period, such as before the end."""
        if self._diagnostics is not None:
            self.entrance.watch(time.monotonic())
            name = self.get_fully_qualified_name().lstrip("/")
            message = DiagnosticArray()
            message.header.stamp = self.get_clock().now().to_msg()
            message.status = [
                status_message(f"{name}: {key}", task())
                for key, task in self._tasks.items()
            ]
            self._diagnostics.publish(message)

    @classmethod
    def table_for(
        cls, overrides: Mapping[str, Any]
    ) -> tuple[Sequence[Setting], Mapping[str, Any]]:
        """The node's parameters, which may depend on the given values, and the given values to check.

        Raises:
            ParameterError: the given values contradict each other.
        """
        return cls.PARAMETERS, overrides

    def read_parameters(self) -> None:
        """Derive what the node needs from `self.values`; after an error here there is no node.

        Raises:
            TwinmatchError: parameters contradict each other, or name what does not exist.
        """

    def change(self, values: Values) -> None:
        """Adopt values of changeable parameters that were set while the node runs.

        Raises:
            TwinmatchError: they contradict each other; then nothing changes.
        """

    def open(self) -> None:
        """Create publishers, subscriptions and threads.

        Raises:
            TwinmatchError: what the parameters name cannot be used: a session, a folder, an address.
        """

    @property
    def failure(self) -> Exception | None:
        """The error with which the process has to end, if any."""
        failures = (part.failure for part in self.beside)
        return self.failed or next(
            (failure for failure in failures if failure is not None), None
        )

    @property
    def busy(self) -> bool:
        """Whether the process should stay up for a moment although a node in it has finished."""
        return False

    def close(self) -> bool:
        """End what runs beside the callbacks; returns whether all of it ended."""
        return end_in_order(*(part.close for part in self.beside))

    def _on_set(self, parameters: Sequence[Any]) -> SetParametersResult:
        """Handle `ros2 param set`: check against the table, then let the node adopt the values."""
        requested = {parameter.name: parameter.value for parameter in parameters}
        table = {
            parameter.name: parameter for parameter in self.table_for(self.values)[0]
        }
        values = dict(self.values)
        try:
            for name, value in requested.items():
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


def declare(
    node: Node,
    table_for: Callable[
        [Mapping[str, Any]], tuple[Sequence[Setting], Mapping[str, Any]]
    ],
) -> Values:
    """Declare a node's parameters and return their values; `table_for` gets the values given.

    The node must have been created with `automatically_declare_parameters_from_overrides=True`, which makes
    all given names known; those in the table are then declared again with type, range and description.

    Raises:
        ParameterError: as for `check`.
    """
    overrides = {
        name: parameter.value
        for name, parameter in node.get_parameters_by_prefix("").items()
    }
    table, to_check = table_for(overrides)
    values = check(node.get_name(), table, to_check)
    for name in (
        *(name for name in overrides if name not in to_check),
        *(p.name for p in table),
    ):
        if node.has_parameter(name):
            node.undeclare_parameter(name)
    for parameter in table:
        value = values[parameter.name]
        node.declare_parameter(
            parameter.name, value, _descriptor(parameter), ignore_override=True
        )
    return values


def _descriptor(parameter: Setting) -> ParameterDescriptor:
    limits = parameter.limits
    text = f"{parameter.description} ({limits})" if limits else parameter.description
    constraint = "" if parameter.changeable else "read once, when the node starts"
    descriptor = ParameterDescriptor(
        description=text, additional_constraints=constraint
    )
    low = parameter.low
    high = parameter.high
    if math.isfinite(low) and math.isfinite(high):
        if type(parameter.default) is float:
            span = FloatingPointRange(from_value=float(low), to_value=float(high))
            descriptor.floating_point_range = [span]
        elif type(parameter.default) is int:
            descriptor.integer_range = [
                IntegerRange(from_value=int(low), to_value=int(high), step=1)
            ]
    return descriptor
