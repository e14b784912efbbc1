"""Requests to the keeper for messages of the session so far."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from rclpy.node import Node

from twinmatch.nodes.keeper import PAST
from twinmatch.signals import Sample
from twinmatch_msgs.srv import Past

__all__ = ["PastRequests", "samples_of_answer"]

ANSWER = 2.0
"""Time after which an unanswered request is dropped, wall s; the keeper needs milliseconds."""


class PastRequests:
    """One request at a time; one without an answer is dropped, so that it can be repeated."""

    def __init__(self, node: Node, on_answer: Callable[[Past.Response], None]) -> None:
        """Call `on_answer` with each answer, in the executor's thread."""
        self._client = node.create_client(Past, PAST)
        self._on_answer = on_answer
        self._pending: Any = None  # future of the pending request
        self._requested_at = 0.0

    def ready(self, now: float) -> bool:
        """Whether a request can be sent at `now`, wall s."""
        if self._pending is None:
            return bool(self._client.service_is_ready())
        if now - self._requested_at > ANSWER:
            self.drop()  # the answer to a process that was suspended may be lost
        return False

    def send(self, request: Past.Request, now: float) -> None:
        """Send a request at `now`, wall s; only while none is pending."""
        self._requested_at = now
        self._pending = self._client.call_async(request)
        self._pending.add_done_callback(self._on_done)

    def drop(self) -> None:
        """Expect no answer any longer; the client would keep the request for as long as it lives."""
        if self._pending is not None:
            self._client.remove_pending_request(self._pending)
            self._pending = None

    def _on_done(self, future: Any) -> None:
        if future is not self._pending:
            return  # too late
        self._pending = None
        answer = future.result()
        if answer is not None:
            self._on_answer(answer)


def samples_of_answer(answer: Past.Response) -> Iterator[Sample]:
    """The samples in an answer."""
    width = len(answer.disturbances) // max(1, len(answer.index))
    columns = (answer.index, answer.stamp, answer.reference, answer.output, answer.input)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    for k, (index, stamp, reference, output, u) in enumerate(rows):
        disturbances = answer.disturbances[k * width : (k + 1) * width].tolist()
        yield Sample(index, stamp, reference, output, u, tuple(disturbances))
