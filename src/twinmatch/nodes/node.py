"""What all nodes of this package are: a table of parameters, diagnostics, a way to end."""

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
"""Name of the node that keeps what is heard of a run."""

READERS = Parameter(
    "readers", "", "Nodes to wait for that must have every plant/sample, by name, with spaces."
)


class TwinmatchNode(Node):
    """A node whose parameters are checked and whose health is on /diagnostics.

    A subclass names itself and its parameters. What it makes in `open` it ends in `close`, which is called
    even when `open` failed half-way.
    """

    NAME: ClassVar[str]
    PARAMETERS: ClassVar[Sequence[Parameter]] = ()
    FIXED: ClassVar[str] = "it is read once, when the node starts"
    """Why a parameter that is not changeable cannot be set while the node runs."""
    CLOSING: ClassVar[int] = 0
    """Seconds that `close` may take beyond what every end may take."""

    def __init__(self) -> None:
        """Read the parameters into `self.values`.

        Raises:
            ParameterError: one does not exist, has another type or is out of its range.
            TwinmatchError: some do not go together.
        """
        try:
            super().__init__(self.NAME, automatically_declare_parameters_from_overrides=True)
        except ValueError as error:  # ROS 2 gives an empty list and null no type
            msg = f"{self.NAME}: a parameter is empty ([] or null); leave it out or give it a value"
            raise ParameterError(msg) from error
        self.exit_code: int | None = None
        """Set by a node that has come to its end: the process ends with it."""
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
        """Publish the node's health on /diagnostics from now on, and these parts beside it."""
        self._reporter = Reporter(self, {"health": self.report, **tasks})

    def report(self) -> Report:
        """The node's health; a subclass brings it up to date first."""
        return self.health.report()

    def report_now(self) -> None:
        """Report out of turn, such as before the end."""
        if self._reporter is not None:
            self._reporter.publish()

    @classmethod
    def table_for(cls, given: Mapping[str, Any]) -> tuple[Sequence[Parameter], Mapping[str, Any]]:
        """The node's parameters, which may depend on what was given, and of that what is to be checked.

        Raises:
            ParameterError: what was given does not go together.
        """
        return cls.PARAMETERS, given

    def read_parameters(self) -> None:
        """Make of `self.values` what the node needs; an error here means that there will be no node."""

    def change(self, values: Values) -> None:
        """Adopt values of changeable parameters that were set while the node runs.

        Raises:
            TwinmatchError: they do not go together; then everything stays as it was.
        """

    def open(self) -> None:
        """Make publishers, subscriptions and threads."""

    @property
    def failure(self) -> Exception | None:
        """A defect that ended a thread of this node."""
        return None

    @property
    def busy(self) -> bool:
        """Whether its process should go on for a moment, although a node of it has come to its end."""
        return False

    def close(self) -> bool:
        """End the node's threads; whether they all did."""
        return True

    def _on_set(self, parameters: Sequence[Any]) -> SetParametersResult:
        """Answer `ros2 param set`: check by the table, then let the node adopt the values."""
        given = {parameter.name: parameter.value for parameter in parameters}
        table = {parameter.name: parameter for parameter in self.table_for(self.values)[0]}
        values = dict(self.values)
        try:
            for name, value in given.items():
                if name not in table:  # one of those that every ROS 2 node has
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
    """How many read a topic; the keeper beside whoever publishes it is always there and does not count."""
    return sum(info.node_name != KEEPER for info in node.get_subscriptions_info_by_topic(topic))


def missing_readers(node: Node, topic: str, wanted: str) -> list[str]:
    """Those of the wanted nodes (names with spaces between) that do not read the topic yet.

    Readers are known by name: programs of other people may read along and come and go.
    """
    names = set(wanted.split())
    found = {info.node_name for info in node.get_subscriptions_info_by_topic(topic)} if names else set()
    return sorted(names - found)


def declare(
    node: Node, table_for: Callable[[Mapping[str, Any]], tuple[Sequence[Parameter], Mapping[str, Any]]]
) -> Values:
    """Declare a node's parameters and return their values; the table is asked with the values given.

    The node must have been made with `automatically_declare_parameters_from_overrides=True`: that is how
    the names somebody gave become known, of which those in the table are declared again as it says.

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
    """What `ros2 param describe` shows."""
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
