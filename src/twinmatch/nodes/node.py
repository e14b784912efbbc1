"""Base class of all nodes of this package: table of parameters, diagnostics, orderly end."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node

from twinmatch.errors import TwinmatchError
from twinmatch.nodes.diagnostics import Health, Report, Reporter
from twinmatch.nodes.parameters import Parameter, ParameterError, Values, check

__all__ = ["KEEPER", "READERS", "TwinmatchNode", "count_readers", "declare", "missing_readers"]

KEEPER = "keeper"
"""Name of the node that keeps the messages of a run."""

READERS = Parameter(
    "readers", "", "Nodes that must receive every plant/sample and are waited for; names with spaces between."
)


class TwinmatchNode(Node):
    """A node with checked parameters that reports its health on /diagnostics.

    A subclass defines its name and parameters. What it creates in `open` it releases in `close`, which is
    called even when `open` failed half-way.
    """

    NAME: ClassVar[str]
    PARAMETERS: ClassVar[Sequence[Parameter]] = ()
    FIXED: ClassVar[str] = "it is read once, when the node starts"
    """Why a parameter that is not changeable cannot be set while the node runs."""
    CLOSING: ClassVar[int] = 0
    """Time that `close` may take in addition to the runner's `TEARDOWN`, s."""

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
        self.health = Health()
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
    def table_for(cls, given: Mapping[str, Any]) -> tuple[Sequence[Parameter], Mapping[str, Any]]:
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
    node: Node, table_for: Callable[[Mapping[str, Any]], tuple[Sequence[Parameter], Mapping[str, Any]]]
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


def _descriptor(parameter: Parameter) -> ParameterDescriptor:
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
