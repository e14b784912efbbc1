"""ROS in the test's own process."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from typing import Any, TypeVar

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

from tests.support.waiting import PATIENCE, wait_for
from twinmatch.errors import TwinmatchError
from twinmatch.nodes.__main__ import nodes_of
from twinmatch.nodes.messages import sample_message
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.nodes.runner import EXIT_DEFECT, Nodes, executor_of
from twinmatch.nodes.topics import EVERYTHING
from twinmatch.signals import Sample
from twinmatch_msgs.msg import LoopSample

T = TypeVar("T")


class Listener:
    """A node in this process that keeps what it receives."""

    def __init__(self, context: Context) -> None:
        self.node = Node("listener", context=context, start_parameter_services=False)
        self._executor = executor_of(context)
        self._executor.add_node(self.node)

    def hear(self, kind: Any, topic: str, qos: Any) -> list[Any]:
        """The messages of a topic, growing as they come."""
        heard: list[Any] = []
        self.node.create_subscription(kind, topic, heard.append, qos)
        return heard

    @cached_property
    def health(self) -> list[DiagnosticArray]:
        """The reports on /diagnostics since this was first looked at."""
        return self.hear(DiagnosticArray, "/diagnostics", QoSProfile(depth=100))

    def reports(self, name: str = "") -> list[DiagnosticStatus]:
        """Those of a node's task, such as `player: health`; of all if none is named."""
        return [
            s for message in self.health for s in message.status if name in ("", s.name)
        ]

    def said(self, words: str) -> bool:
        """Whether a report has these words."""
        return any(words in status.message for status in self.reports())

    def values(self, key: str) -> list[str]:
        """What was reported under a key."""
        return [
            entry.value
            for status in self.reports()
            for entry in status.values
            if entry.key == key
        ]

    @cached_property
    def samples(self) -> Publisher:
        """Publishes `plant/sample` as a rig does."""
        return self.node.create_publisher(LoopSample, "plant/sample", EVERYTHING)

    def send(self, samples: Iterable[Sample]) -> None:
        """Publish samples."""
        for sample in samples:
            self.samples.publish(sample_message(sample))

    def wait_for_nodes(self, *topics: str, readers: int = 1) -> None:
        """Until so many nodes read the samples and this listener receives what these topics bring."""
        self.spin_until(
            lambda: self.samples.get_subscription_count() >= readers, "the readers"
        )
        self.wait_for_publishers(*topics)

    def wait_for_publishers(self, *topics: str) -> None:
        """Until each of these topics has a publisher that knows of every subscription made here so far.

        A publisher that is seen here need not know yet who listens to it, and what it publishes before that is
        lost. Nodes learn of the subscriptions of another process in the order in which they were made: a report
        at the newest one shows that the older ones are known too.
        """
        reports = self.hear(DiagnosticArray, "/diagnostics", QoSProfile(depth=100))
        self.spin_until(
            lambda: all(map(self.node.count_publishers, topics)), "the publishers"
        )

        def publishing() -> set[str]:
            return {
                endpoint.node_name
                for topic in topics
                for endpoint in self.node.get_publishers_info_by_topic(topic)
            }

        def reporting() -> set[str]:
            names = (s.name for message in reports for s in message.status)
            return {name.split(":")[0].split("/")[-1] for name in names}

        self.spin_until(
            lambda: publishing() <= reporting(), "reports of the publishers"
        )

    def spin_until(
        self,
        condition: Callable[[], T],
        what: str | Callable[[], str],
        patience: float = PATIENCE,
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
    opened = Listener(context)
    try:
        yield opened
    finally:
        opened.close()
        rclpy.try_shutdown(context=context)


class Inside:
    """A program of nodes in the test's own process, with what a test asks of a process of its own."""

    def __init__(
        self, name: str, *ros_arguments: str, kinds: Sequence[type[TwinmatchNode]] = ()
    ) -> None:
        """Start it with ROS arguments; a mistake in them ends it as it would end the program.

        The program is that of `twinmatch.nodes` of this name, or these kinds of nodes.
        """
        self.text = ""
        """The line or the traceback with which it ended."""
        self.asked = False
        """Whether the test has asked for its exit code."""
        self._name = name
        self._code = 0
        self._nodes = Nodes(Context())
        self._stop = threading.Event()
        self._thread = threading.Thread(
            target=self._guarded, args=(self._spin,), daemon=True
        )
        if not kinds:
            kinds = nodes_of(name)
        arguments = [name, *(["--ros-args", *ros_arguments] if ros_arguments else [])]
        self._guarded(lambda: self._nodes.start(kinds, arguments))
        if self._code:
            self._nodes.close()
        else:
            self._thread.start()

    @property
    def nodes(self) -> list[TwinmatchNode]:
        return self._nodes.nodes

    @property
    def running(self) -> bool:
        return self._thread.is_alive()

    def wait(self, patience: float = PATIENCE) -> int:
        """Its exit code, once it has ended by itself."""
        self.asked = True
        if self._thread.ident is not None:
            self._thread.join(patience)
        assert not self.running, f"still running after {patience:g} s: {self._name}"
        return self._code

    def end(self) -> int:
        """End it as a signal does, and return the exit code."""
        self._stop.set()
        return self.wait()

    def _spin(self) -> None:
        try:
            code = None
            while code is None and not self._stop.is_set():
                code = self._nodes.spin_once()
            self._nodes.linger()
            self._code = code or 0
        finally:
            assert self._nodes.close(), "a thread continues"

    def _guarded(self, work: Callable[[], None]) -> None:
        try:
            work()
        except TwinmatchError as error:
            self.text = f"{error}\n"
            self._code = error.NODE_EXIT
        except Exception:
            self.text = traceback.format_exc()
            self._code = EXIT_DEFECT
