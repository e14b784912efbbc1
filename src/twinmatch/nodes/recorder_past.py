"""The start of a session for a recorder that started late: earlier messages, from the keeper.

A recorder that was killed continues in another folder. A session that starts in the middle could not be
judged, so the folder starts with the samples, matches and verdicts so far, in an order in which a session cut
off anywhere still verifies. New messages on these topics are held back until those are written.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import NamedTuple

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message

from twinmatch.nodes.past import PastRequests, samples_of_answer
from twinmatch.nodes.sample_messages import nanoseconds
from twinmatch.sessions.messages import decode_sample, encode_sample
from twinmatch_msgs.msg import Match, ModelScore
from twinmatch_msgs.srv import Past


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

    def expected(self, name: str) -> bool:
        """Whether copies of fetched messages of this topic may still arrive."""
        return name in self._fetched

    def found(self, name: str, values: str) -> bool:
        """Whether this message was fetched; if not, no later one of its topic was."""
        if values in self._fetched.get(name, ()):
            return True
        self._fetched.pop(name, None)
        return False


class InOrder:
    """Writes samples and the messages about them, each message directly after its sample.

    An answer of the keeper holds 2000 samples but only a few messages. A sample is held back until all
    messages about it have arrived, so that a recorder killed in between leaves a session without a gap.
    """

    def __init__(self, write: Callable[[str, Fetched], None], sample: str, kinds: Iterable[str]) -> None:
        """Write with `write`; `sample` is the topic of the samples, `kinds` are those of the messages."""
        self._write, self._topic = write, sample
        self._samples: deque[Fetched] = deque()
        self._about: dict[str, deque[Fetched]] = {name: deque() for name in kinds}
        self._known = dict.fromkeys(self._about, -math.inf)  # all messages about earlier samples have arrived
        self.counts = dict.fromkeys(self._about, 0)
        """Messages fetched so far, by topic."""

    @property
    def waiting(self) -> int:
        """Number of samples held back."""
        return len(self._samples)

    def add_samples(self, samples: Iterable[Fetched]) -> None:
        """Take samples, in the order of their indices."""
        self._samples.extend(samples)

    def add_messages(self, name: str, messages: Iterable[Fetched], there_are: int) -> None:
        """Take messages of a topic, in the order of their samples; the keeper has `there_are` of them."""
        for message in messages:
            self._about[name].append(message)
            self._known[name] = message.sample  # another one about this sample may follow
            self.counts[name] += 1
        if self.counts[name] >= there_are:
            self._known[name] = math.inf

    def write(self) -> None:
        """Write the samples whose messages have all arrived, and those messages."""
        self._write_before(min(self._known.values(), default=math.inf))

    def finish(self) -> None:
        """Write everything that is left."""
        self._write_before(math.inf)
        for name, messages in self._about.items():
            while messages:
                self._write(name, messages.popleft())

    def _write_before(self, end: float) -> None:
        while self._samples and self._samples[0].sample < end:
            sample = self._samples.popleft()
            self._write(self._topic, sample)
            for name, messages in self._about.items():
                while messages and messages[0].sample <= sample.sample:
                    self._write(name, messages.popleft())


INTERVAL = 0.1
"""Interval at which the next request is considered, wall s."""
PATIENCE = 10.0
"""Time without progress after which the session starts where the recorder started, wall s."""
MOST_WAITING = 4000
"""Fetched samples waiting to be written above which no more are requested."""

Write = Callable[[str, bytes, int], None]


class RecorderPast:
    """Holds the topics back until all earlier messages, if any, are written."""

    def __init__(self, node: Node, write: Write, known: Callable[[str], bool]) -> None:
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
        self._order = InOrder(lambda name, it: write(name, it.data, it.stamp), self._sample, self._kinds)
        self._copies = Copies()
        self._since = 0.0
        self._timer = node.create_timer(
            INTERVAL, self._request, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

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
        self._order.finish()
        waiting, self._waiting = self._waiting, None
        self._timer.cancel()
        for name, data, now in waiting:
            if not self._is_copy(name, data):
                self._write(name, data, now)

    def _request(self) -> None:
        if self._waiting is None or self._until is None:
            return
        now = time.monotonic()
        if now - self._since > PATIENCE:
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
        self._order.add_samples(Fetched(s.index, encode_sample(s), s.stamp) for s in samples)
        if samples:
            self._next = samples[-1].index + 1
        heard = {self._match: answer.matches_heard, self._score: answer.scores_heard}
        for name, messages in ((self._match, answer.match), (self._score, answer.score)):
            for message in messages:
                self._copies.add(name, repr(message))
            self._order.add_messages(name, map(_fetched, messages), heard[name])
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
        """Whether a message was fetched too."""
        if not self._copies.expected(name):
            return False
        return self._copies.found(name, values_of(bytes(data), self._kinds[name]))


def values_of(data: bytes, kind: type[Match | ModelScore]) -> str:
    """All values of a serialised message, as text."""
    return repr(deserialize_message(data, kind))


def _fetched(message: Match | ModelScore) -> Fetched:
    return Fetched(message.sample, serialize_message(message), nanoseconds(message.header.stamp))
