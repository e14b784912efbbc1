"""ROS in the test's own process."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from tests.support.waiting import PATIENCE, wait_for

T = TypeVar("T")


class Listener:
    """A node in this process that keeps what it receives."""

    def __init__(self, context: Context) -> None:
        self.node = Node("listener", context=context)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self.node)

    def hear(self, kind: Any, topic: str, qos: Any) -> list[Any]:
        """The messages of a topic, growing as they come."""
        heard: list[Any] = []
        self.node.create_subscription(kind, topic, heard.append, qos)
        return heard

    def spin_until(
        self, condition: Callable[[], T], what: str | Callable[[], str], patience: float = PATIENCE
    ) -> T:
        """Take what comes until something holds."""
        return wait_for(condition, what, patience=patience, meanwhile=self.spin_once)

    def spin_once(self) -> None:
        self._executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()


@contextmanager
def listening() -> Iterator[Listener]:
    """A listener with a context of its own."""
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    made = Listener(context)
    try:
        yield made
    finally:
        made.close()
        rclpy.try_shutdown(context=context)
