"""How a node gets the samples it missed, from the keeper, while its worker processes them.

A restarted node has missed all samples, a paused one some. It asks the keeper for those between its last
sample and the newest one, and holds back what arrives meanwhile. Only samples that the keeper does not have
either are a gap: the rig itself published none.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from twinmatch.nodes.node import Level, TwinmatchNode
from twinmatch.signals import Sample
from twinmatch_msgs.srv import Past

PAST = "plant/past"
"""Name of the keeper's service."""
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


class Missing(NamedTuple):
    """First and last of the samples to fetch."""

    first: int
    last: int


class Stream:
    """Passes samples on in order, and reports which are missing."""

    def __init__(self, give: Callable[[Sample], None]) -> None:
        """Pass every sample on to `give`."""
        self.missing: Missing | None = None
        """The samples to fetch now; live samples are held back until then."""
        self._give = give
        self._end = 0  # index of the newest sample passed on, plus one
        self._live: deque[Sample] = deque()

    @property
    def begun(self) -> bool:
        """Whether a sample was passed on."""
        return self._end > 0

    def push(self, sample: Sample) -> None:
        """Take a live sample."""
        if self.missing is not None:
            self._live.append(sample)
        elif sample.index > self._end:
            self.missing = Missing(self._end, sample.index - 1)
            self._live.append(sample)
        else:
            self._pass_on(sample)

    def fetched(self, samples: Sequence[Sample], heard: int) -> bool:
        """Take an answer: some of the missing samples, and the end of what the keeper has received.

        Returns whether this made progress; if not, asking again at once is useless.
        """
        missing = self.missing
        if missing is None:
            return False
        for sample in samples:
            self._pass_on(sample)
        if self._end > missing.last or (not samples and heard > missing.last):
            self.skip()
            return True
        self.missing = Missing(self._end, missing.last)
        return bool(samples)

    def skip(self) -> None:
        """Skip what is still missing, and pass on what was held back."""
        self.missing = None
        live, self._live = self._live, deque()
        if live:
            self._pass_on(live.popleft())  # possibly with a gap before it
        for sample in live:
            self.push(sample)

    def _pass_on(self, sample: Sample) -> None:
        self._end = sample.index + 1
        self._give(sample)


INTERVAL = 0.05
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
        node.create_timer(INTERVAL, self.request, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def request(self) -> None:
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
            wanted = Past.Request(first=missing.first, count=count, matches=self._matches, scores=NONE)
            self._requests.send(wanted, now)

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
            self.request()


def all_connected(node: Node) -> bool:
    """Whether every known reader of a node's topics is connected to it."""
    return all(p.get_subscription_count() >= node.count_subscribers(p.topic_name) for p in node.publishers)
