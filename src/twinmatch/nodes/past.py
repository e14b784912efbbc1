"""How a node gets what it missed, from the keeper, and how a recorder gets the start of its session.

A restarted node has missed all samples, a paused one some. It asks the keeper for those between its last
sample and the newest one, and holds back what arrives meanwhile. Only samples that the keeper does not have
either are a gap: the rig itself published none.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from heapq import heappop, heappush
from typing import Any, NamedTuple

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message

from twinmatch.nodes.health import Level
from twinmatch.nodes.messages import SAMPLED, nanoseconds
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.sessions.messages import decode_sample, encode_sample
from twinmatch.signals import Sample
from twinmatch_msgs.msg import Match, ModelScore
from twinmatch_msgs.srv import Past

PAST = "plant/past"
"""Name of the keeper's service."""
ANSWER = 2.0
"""Time after which an unanswered request is dropped, wall s; the keeper needs milliseconds."""


class PastRequests:
    """One request at a time; one without an answer is dropped, so that it can be repeated."""

    def __init__(self, node: TwinmatchNode, on_answer: Callable[[Past.Response], None]) -> None:
        """Call `on_answer` with each answer, in the executor's thread."""
        self._client = node.create_client(Past, PAST)
        self._passes = node.entrance.passes
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
        if answer is not None and self._passes(PAST, answer):
            self._on_answer(answer)


def samples_of_answer(answer: Past.Response) -> Iterator[Sample]:
    """The samples in an answer."""
    size = len(answer.index)
    signals = [np.array(getattr(answer, name)).reshape(size, -1).tolist() for name in SAMPLED] if size else []
    for index, stamp, *rows in zip(answer.index.tolist(), answer.stamp.tolist(), *signals, strict=True):
        yield Sample(index, stamp, *map(tuple, rows))


class Stream:
    """Passes samples on in order, and reports which are missing."""

    def __init__(self, give: Callable[[Sample], None]) -> None:
        """Pass every sample on to `give`."""
        self.missing: range | None = None
        """Indices of the samples to fetch now; live samples are held back until then."""
        self._give = give
        self._end = 0  # index of the newest sample passed on, plus one
        self._live: deque[Sample] = deque()

    @property
    def begun(self) -> bool:
        """Whether a sample was passed on."""
        return self._end > 0

    @property
    def waiting(self) -> int:
        """Number of samples held back."""
        return len(self._live)

    def push(self, sample: Sample) -> None:
        """Take a live sample."""
        if self.missing is not None:
            self._live.append(sample)
        elif sample.index > self._end:
            self.missing = range(self._end, sample.index)
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
        if self._end >= missing.stop or (not samples and heard >= missing.stop):
            self.skip()
            return True
        self.missing = range(self._end, missing.stop)
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
"""Fetched samples waiting for the worker or the disk above which no more are requested."""


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
        node.wall_timer(INTERVAL, self.request)

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
            self._give_up(f"samples {missing[0]} to {missing[-1]} are missing and cannot be fetched")
        elif self._requests.ready(now) and self._settled(now):
            if self._waiting() > MOST_WAITING:
                self._since = now  # the worker is busy with what was fetched
                return
            count = 0 if self._fresh else len(missing)
            wanted = Past.Request(first=missing.start, count=count, matches=self._matches, scores=NONE)
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


def all_connected(node: TwinmatchNode) -> bool:
    """Whether every known reader of a node's topics is connected to it."""
    return all(p.get_subscription_count() >= node.count_subscribers(p.topic_name) for p in node.publishers)


class Fetched(NamedTuple):
    """A serialised message from the keeper."""

    sample: int
    """Index of the sample itself, or of the sample that the message is about."""
    data: bytes
    stamp: int
    """ns"""


class Copies:
    """Recognises live messages that were fetched from the keeper already.

    A message that the keeper has received may reach the recorder only after the keeper's answer, even after
    everything fetched is written. The messages of a topic come in order, so the first new one ends this.
    Messages are compared by a text with all their values: serialised ones differ in padding bytes, which are
    never set, and deserialised ones in NaN, which equals nothing.
    """

    def __init__(self) -> None:
        self._fetched: dict[str, set[str]] = {}

    def add(self, name: str, values: str) -> None:
        """Take note of a fetched message of a topic."""
        self._fetched.setdefault(name, set()).add(values)

    def found(self, name: str, values: Callable[[], str]) -> bool:
        """Whether a message with these values was fetched; if not, no later one of its topic was."""
        fetched = self._fetched.get(name)
        if fetched is None:
            return False
        if values() not in fetched:
            del self._fetched[name]
            return False
        return True


class InOrder:
    """Writes samples and the messages about them, each message directly after its sample.

    An answer of the keeper holds 2000 samples but only a few messages. A sample is held back until all
    messages about it have arrived, so that a recorder killed in between leaves a session without a gap.
    """

    def __init__(self, write: Callable[[str, Fetched], None], topics: Sequence[str]) -> None:
        """Write with `write`; the first of the topics is that of the samples."""
        self._write, self._ranks = write, {name: rank for rank, name in enumerate(topics)}
        self._held: list[tuple[int, int, int, str, Fetched]] = []  # a heap, in the order of writing
        self._known = dict.fromkeys(topics, -math.inf)  # all about earlier samples has arrived
        self.counts = dict.fromkeys(topics, 0)
        """Messages fetched so far, by topic."""

    @property
    def waiting(self) -> int:
        """Number of samples and messages held back."""
        return len(self._held)

    def add(self, name: str, messages: Iterable[Fetched], there_are: float = math.inf) -> None:
        """Take messages of a topic, in the order of their samples; the keeper has `there_are` of them."""
        rank = self._ranks[name]
        for message in messages:
            self.counts[name] += 1
            heappush(self._held, (message.sample, rank, self.counts[name], name, message))
            # Another message about this sample may follow, but no other sample of this index.
            self._known[name] = message.sample + (rank == 0)
        if self.counts[name] >= there_are:
            self._known[name] = math.inf

    def write(self, end: float | None = None) -> None:
        """Write the samples before `end` and the messages about them; by default all that is complete."""
        end = min(self._known.values()) if end is None else end
        while self._held and self._held[0][0] < end:
            *_, name, message = heappop(self._held)
            self._write(name, message)


Write = Callable[[str, bytes, int], None]


class RecorderPast:
    """Gives a recorder that started late the start of its session: earlier messages, from the keeper.

    A recorder that was killed continues in another folder. A session that starts in the middle could not be
    judged, so the folder starts with the samples, matches and verdicts so far, in an order in which a session
    cut off anywhere still verifies. New messages on these topics are held back until those are written.
    """

    INTERVAL = 0.1
    """Interval at which the next request is considered, wall s."""
    PATIENCE = 10.0
    """Time without progress after which the session starts where the recorder started, wall s."""

    def __init__(self, node: TwinmatchNode, write: Write, known: Callable[[str], bool]) -> None:
        """`write` writes a topic's serialised message with its time (ns); `known`: is a topic recorded?"""
        names = [node.resolve_topic_name(n) for n in ("plant/sample", "twin/match", "twin/model_score")]
        self._sample, self._match, self._score = self._names = names
        self._kinds = {self._match: Match, self._score: ModelScore}
        self._write, self._known = write, known
        self._requests = PastRequests(node, self._on_answer)
        self._requested = 0  # samples in the pending request
        self._waiting: list[tuple[str, bytes, int]] | None = []  # messages held back until then
        self._until: int | None = None  # index of the first sample that came live
        self._next = 0
        self._order = InOrder(lambda name, it: write(name, it.data, it.stamp), names)
        self._copies = Copies()
        self._since = 0.0
        self._timer = node.wall_timer(self.INTERVAL, self._request)

    def take(self, name: str, data: bytes, now: int) -> bool:
        """Whether a message may be written at once; otherwise it is held back and written later."""
        if name not in self._names:
            return True
        if self._waiting is None:
            return not self._is_copy(name, data)
        if not self._waiting:
            self._since = time.monotonic()
        self._waiting.append((name, bytes(data), now))
        if name == self._sample and self._until is None:
            self._until, self._since = decode_sample(bytes(data)).index, time.monotonic()
            if self._until == 0:
                self.finish()
        return False

    def finish(self) -> None:
        """Write what was held back, except what was fetched too, and hold nothing back from now on."""
        if self._waiting is None:
            return
        self._order.write(math.inf)
        waiting, self._waiting = self._waiting, None
        self._timer.cancel()
        for name, data, now in waiting:
            if not self._is_copy(name, data):
                self._write(name, data, now)

    def _request(self) -> None:
        if self._waiting is None or self._until is None:
            return
        now = time.monotonic()
        if now - self._since > self.PATIENCE:
            self.finish()
        elif self._requests.ready(now) and all(map(self._known, self._names)):
            count = 0 if self._order.waiting > MOST_WAITING else self._until - self._next
            matches, scores = self._order.counts[self._match], self._order.counts[self._score]
            self._requested = count
            request = Past.Request(first=self._next, count=count, matches=matches, scores=scores)
            self._requests.send(request, now)

    def _on_answer(self, answer: Past.Response) -> None:
        if self._waiting is None or self._until is None:
            return
        samples = list(samples_of_answer(answer))
        self._order.add(self._sample, [Fetched(s.index, encode_sample(s), s.stamp) for s in samples])
        if samples:
            self._next = samples[-1].index + 1
        heard = {self._match: answer.matches_heard, self._score: answer.scores_heard}
        for name, messages in ((self._match, answer.match), (self._score, answer.score)):
            for message in messages:
                self._copies.add(name, repr(message))
            self._order.add(name, map(_fetched, messages), heard[name])
        self._order.write()
        progress = bool(samples or answer.match or answer.score)
        if progress:
            self._since = time.monotonic()
        at_the_end = self._requested > 0 and not samples and answer.heard > self._until
        all_said = all(self._order.counts[name] >= count for name, count in heard.items())
        if all_said and (self._next >= self._until or at_the_end):
            self.finish()
        elif progress:
            self._request()

    def _is_copy(self, name: str, data: bytes) -> bool:
        return self._copies.found(name, lambda: values_of(bytes(data), self._kinds[name]))


def values_of(data: bytes, kind: type[Match | ModelScore]) -> str:
    """All values of a serialised message, as text."""
    return repr(deserialize_message(data, kind))


def _fetched(message: Match | ModelScore) -> Fetched:
    return Fetched(message.sample, serialize_message(message), nanoseconds(message.header.stamp))
