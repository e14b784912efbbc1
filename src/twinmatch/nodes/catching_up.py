"""Fetch the samples that a node missed from the keeper, while its worker processes them."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from twinmatch.nodes.node import Level, TwinmatchNode
from twinmatch.nodes.past_requests import PastRequests, samples_of_answer
from twinmatch.nodes.stream import Stream
from twinmatch_msgs.srv import Past

__all__ = ["CatchingUp"]

LOOK = 0.05
"""Interval between two checks for missing samples, wall s."""
PATIENCE = 6.0
"""Time without progress after which a node gives up on what is missing, wall s."""
NONE = 2**64 - 1
"""More verdicts than there can be: requests none of them."""
SETTLE = 1.0
"""Time in which readers discover a new node, wall s; they may miss what it publishes earlier."""
LONGEST_SETTLE = 3.0
"""Longest wait for readers that are known but not connected, wall s."""
MOST_WAITING = 4000
"""Samples in the worker's queue above which no more are requested."""


class CatchingUp:
    """Requests what a stream is missing, and before the first sample the results published so far."""

    def __init__(
        self,
        node: TwinmatchNode,
        stream: Stream,
        waiting: Callable[[], int],
        learn: Callable[[Past.Response], None],
    ) -> None:
        """Follow a stream.

        Args:
            node: the node that owns the stream.
            stream: the samples in order.
            waiting: returns the number of samples in the worker's queue.
            learn: called with earlier results, before the first sample is passed on.
        """
        self._node, self._stream, self._waiting, self._learn = node, stream, waiting, learn
        self._requests = PastRequests(node, self._on_answer)
        self._since: float | None = None  # start of the wait without progress
        self._fresh = True
        self._opened, self._connected = time.monotonic(), False
        self._matches = 0
        node.create_timer(LOOK, self.look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def look(self) -> None:
        """Request what is missing, unless a request is pending; give up after `PATIENCE`."""
        missing, now = self._stream.missing, time.monotonic()
        if missing is None:
            self._since = None
            self._fresh = self._fresh and not self._stream.begun
            return
        if self._since is None:
            self._since = now
        if now - self._since > PATIENCE:
            self._give_up(f"samples {missing.first} to {missing.last} are missing and cannot be fetched")
        elif self._requests.ready(now) and self._settled(now):
            if self._waiting() > MOST_WAITING:
                self._since = now  # the worker is busy with what was fetched
                return
            count = 0 if self._fresh else missing.last + 1 - missing.first
            request = Past.Request(first=missing.first, count=count, matches=self._matches, scores=NONE)
            self._requests.send(request, now)

    def _settled(self, now: float) -> bool:
        """Whether the readers of this node are connected; results for fetched samples follow at once."""
        age = now - self._opened
        self._connected = (
            self._connected or age > LONGEST_SETTLE or (age > SETTLE and all_connected(self._node))
        )
        return self._connected

    def _give_up(self, why: str) -> None:
        self._node.health.flag("past", Level.WARN, why)
        self._requests.drop()
        self._since, self._fresh = None, False
        self._stream.skip()

    def _on_answer(self, answer: Past.Response) -> None:
        if self._stream.missing is None:
            return
        if self._fresh:
            self._matches += len(answer.match)
            self._fresh = self._matches < answer.matches_heard and len(answer.match) > 0
            self._learn(answer)
            progress = True
        else:
            progress = self._stream.fetched(list(samples_of_answer(answer)), answer.heard)
        if progress:
            self._since = None
            self._node.health.withdraw("past")
            self.look()


def all_connected(node: Node) -> bool:
    """Whether every known reader of a node's topics is connected to it."""
    return all(p.get_subscription_count() >= node.count_subscribers(p.topic_name) for p in node.publishers)
