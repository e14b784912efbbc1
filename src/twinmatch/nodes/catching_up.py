"""Fetches for a node what it missed, from the keeper, while its worker gets on with it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from twinmatch.nodes.diagnostics import Level
from twinmatch.nodes.keeper import PAST
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.nodes.stream import Stream
from twinmatch.signals import Sample
from twinmatch_msgs.srv import Past

__all__ = ["ANSWER", "CatchingUp", "samples_of_answer"]

LOOK = 0.05
"""Wall seconds between two looks for something missing."""
PATIENCE = 6.0
"""Wall seconds without anything new after which a node does without what is missing."""
ANSWER = 2.0
"""Wall seconds after which a question without an answer is asked again; the keeper needs milliseconds."""
NONE = 2**64 - 1
"""As many verdicts as nobody has said: none of them is wanted."""
SETTLE = 1.0
"""Wall seconds in which the readers of a new node find it; what it says earlier they may miss."""
LONGEST_SETTLE = 3.0
"""Wall seconds after which a reader that is known but not connected is not waited for any longer."""
MOST_WAITING = 4000
"""Samples that may wait for the worker before more are asked for."""


class CatchingUp:
    """Asks for what a stream misses, and before the first sample for what was said already."""

    def __init__(
        self,
        node: TwinmatchNode,
        stream: Stream,
        waiting: Callable[[], int],
        learn: Callable[[Past.Response], None],
    ) -> None:
        """Look after a stream.

        Args:
            node: whose it is.
            stream: of the samples.
            waiting: how many samples wait for the worker.
            learn: is given the answers to the question what was said, before the first sample is.
        """
        self._node, self._stream, self._waiting, self._learn = node, stream, waiting, learn
        self._client = node.create_client(Past, PAST)
        self._asked: Any = None  # the future of the question that is out
        self._asked_at = 0.0
        self._since: float | None = None  # when something was missing without anything new
        self._fresh = True
        self._opened, self._connected = time.monotonic(), False
        self._matches = 0
        node.create_timer(LOOK, self.look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def look(self) -> None:
        """Ask, if something is missing and no question is out; do without, if nothing comes."""
        missing, now = self._stream.missing, time.monotonic()
        if missing is None:
            self._since = None
            self._fresh = self._fresh and not self._stream.begun
            return
        if self._since is None:
            self._since = now
        if now - self._since > PATIENCE:
            self._do_without(f"samples {missing.first} to {missing.last} cannot be had")
        elif self._asked is not None and now - self._asked_at > ANSWER:
            self._asked = None  # an answer to a process that stood still may be lost
        elif self._asked is None and self._client.service_is_ready() and self._settled(now):
            if self._waiting() > MOST_WAITING:
                self._since = now  # the worker is busy with what was fetched
                return
            count = 0 if self._fresh else missing.last + 1 - missing.first
            question = Past.Request(first=missing.first, count=count, matches=self._matches, scores=NONE)
            self._asked = self._client.call_async(question)
            self._asked_at = now
            self._asked.add_done_callback(self._on_answer)

    def _settled(self, now: float) -> bool:
        """Whether those who read this node's topics are connected: what was missed is published at once."""
        age = now - self._opened
        self._connected = (
            self._connected or age > LONGEST_SETTLE or (age > SETTLE and all_connected(self._node))
        )
        return self._connected

    def _do_without(self, why: str) -> None:
        self._node.health.complain("past", Level.WARN, why)
        self._asked, self._since, self._fresh = None, None, False
        self._stream.go_on()

    def _on_answer(self, future: Any) -> None:
        if future is not self._asked:
            return  # it came too late
        self._asked = None
        answer = future.result()
        if answer is None or self._stream.missing is None:
            return
        if self._fresh:
            self._matches += len(answer.match)
            self._fresh = self._matches < answer.matches_heard and len(answer.match) > 0
            self._learn(answer)
            news = True
        else:
            news = self._stream.fetched(list(samples_of_answer(answer)), answer.heard)
        if news:
            self._since = None
            self._node.health.withdraw("past")
            self.look()


def all_connected(node: Node) -> bool:
    """Whether every known reader of a node's topics is connected to it."""
    return all(p.get_subscription_count() >= node.count_subscribers(p.topic_name) for p in node.publishers)


def samples_of_answer(answer: Past.Response) -> Iterator[Sample]:
    """The samples in an answer."""
    width = len(answer.disturbances) // max(1, len(answer.index))
    columns = (answer.index, answer.stamp, answer.reference, answer.output, answer.input)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    for k, (index, stamp, reference, output, u) in enumerate(rows):
        disturbances = answer.disturbances[k * width : (k + 1) * width].tolist()
        yield Sample(index, stamp, reference, output, u, tuple(disturbances))
