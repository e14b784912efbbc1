"""How a node gets what it missed, from the keeper, and how a recorder gets the start of its session.

A restarted node has missed all samples, a paused one some. It asks the keeper for those between its last
sample and the newest one, and holds back what arrives meanwhile. Only samples that the keeper does not have
either are a gap: the rig itself published none.
"""

from __future__ import annotations

import time
from bisect import insort
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
from rclpy.serialization import deserialize_message

from twinmatch.nodes.cdr import serialized
from twinmatch.nodes.health import Level
from twinmatch.nodes.messages import nanoseconds
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.record import SAMPLED
from twinmatch.sessions.cdr import decode_sample, encode_sample
from twinmatch.signals import Sample
from twinmatch_msgs.msg import Match, ModelScore
from twinmatch_msgs.srv import Past

PAST = "plant/past"
"""Name of the keeper's service."""
NONE = 2**64 - 1
"""More messages than there can be: requests none of them."""


def samples_of_answer(answer: Past.Response) -> Iterator[Sample]:
    """The samples in an answer."""
    size = len(answer.index)
    signals = (
        [np.array(getattr(answer, name)).reshape(size, -1).tolist() for name in SAMPLED]
        if size
        else []
    )
    for index, stamp, *rows in zip(
        answer.index.tolist(), answer.stamp.tolist(), *signals, strict=True
    ):
        yield Sample(index, stamp, *map(tuple, rows))


class Indexed(Protocol):
    """A sample, in whatever form."""

    @property
    def index(self) -> int:
        """Its index."""


class Stream:
    """Passes samples on in order, and knows what to request from the keeper.

    Until it has caught up for the first time, that includes the matches so far, and the verdicts on request:
    all that are about a sample are learned before the next sample is passed on.
    """

    def __init__(
        self,
        give: Callable[[Any], None],
        learn: Callable[[Past.Response], None] = lambda _: None,
        *,
        verdicts: bool = False,
    ) -> None:
        """Pass every sample on to `give`; what an answer holds besides samples goes to `learn` before."""
        self.missing: range | None = None
        """Indices of the samples to fetch now; live samples are held back until then."""
        self._give = give
        self._learn = learn
        self._matches = 0  # number that was received
        self._verdicts = 0 if verdicts else NONE  # number that was received
        self._end = 0  # index of the newest sample passed on, plus one
        self._live: deque[Indexed] = deque()

    @property
    def begun(self) -> bool:
        """Whether a sample was passed on."""
        return self._end > 0

    @property
    def waiting(self) -> int:
        """Number of samples held back."""
        return len(self._live)

    def push(self, sample: Indexed) -> None:
        """Take a live sample."""
        self._live.append(sample)
        if self.missing is None:
            self._pass_live_on()

    def wanted(self) -> Past.Request | None:
        """What to request now; None: nothing."""
        if self.missing is None:
            return None
        return Past.Request(
            first=self.missing.start,
            count=len(self.missing),
            matches=self._matches,
            scores=self._verdicts,
        )

    def answered(self, answer: Past.Response) -> bool:
        """Take an answer: some of what is missing, and what the keeper has received.

        Returns whether this made progress; if not, asking again at once is useless.
        """
        missing = self.missing
        if missing is None:
            return False
        if self._matches < NONE:
            self._learn(answer)
        self._matches = min(self._matches + len(answer.match), NONE)
        self._verdicts = min(self._verdicts + len(answer.score), NONE)
        lacks_messages = (
            self._matches < answer.matches_heard or self._verdicts < answer.scores_heard
        )
        samples = list(samples_of_answer(answer))
        for sample in samples:
            self._pass_on(sample)
        self.missing = range(self._end, missing.stop)
        if not lacks_messages and (
            not self.missing or (not samples and answer.heard >= missing.stop)
        ):
            self.skip()
            return True
        return bool(samples) or len(answer.match) > 0 or len(answer.score) > 0

    def skip(self) -> None:
        """Skip what is still missing, and pass on what was held back."""
        self.missing = None
        if self._live:
            self._pass_on(self._live.popleft())  # possibly with a gap before it
        self._pass_live_on()

    def _pass_live_on(self) -> None:
        while self._live:
            if self._live[0].index > self._end:
                self.missing = range(self._end, self._live[0].index)
                return
            self._pass_on(self._live.popleft())

    def _pass_on(self, sample: Indexed) -> None:
        self._end = sample.index + 1
        if self.missing is None:
            self._matches = NONE  # from now on they are received
            self._verdicts = NONE
        self._give(sample)


class CatchingUp:
    """Requests what a stream is missing: one request at a time, which is repeated if it is not answered."""

    INTERVAL: Final = 0.05
    """Interval between two checks for missing samples, wall s."""
    ANSWER: Final = 2.0
    """Time after which an unanswered request is dropped, wall s; the keeper needs milliseconds."""
    PATIENCE: Final = 6.0
    """Time without progress after which a node gives up on what is missing, wall s."""
    MAX_WAITING: Final = 4000
    """Fetched samples waiting for the worker or the disk above which no more are requested."""

    def __init__(
        self,
        node: TwinmatchNode,
        stream: Stream,
        *,
        ready: Callable[[float], bool],
        waiting: Callable[[], int],
        patience: float = PATIENCE,
    ) -> None:
        """Follow a stream.

        Args:
            node: the node that owns the stream.
            stream: the samples in order.
            ready: whether a request may be sent, from the age of this object, wall s.
            waiting: returns the number of samples in the worker's queue.
            patience: time without progress after which what is missing is given up, wall s.
        """
        self._node = node
        self._stream = stream
        self._ready = ready
        self._waiting = waiting
        self._patience = patience
        self._client = node.create_client(Past, PAST)
        self._pending: Any = None  # future of the pending request
        self._requested_at = 0.0
        self._since: float | None = None  # start of the wait without progress
        self._opened = time.monotonic()
        node.wall_timer(self.INTERVAL, self.request)

    def request(self) -> None:
        """Request what is missing, unless a request is pending; give up when patience ends."""
        wanted = self._stream.wanted()
        wall_now = time.monotonic()
        if wanted is None:
            self._since = None
            return
        if self._since is None:
            self._since = wall_now
        if wall_now - self._since > self._patience:
            last = wanted.first + wanted.count - 1
            why = f"samples {wanted.first} to {last} are missing and cannot be fetched"
            self._node.health.flag("past", Level.WARN, why)
            self._drop()
            self._since = None
            self._stream.skip()
        elif self._pending is not None:
            if wall_now - self._requested_at > self.ANSWER:
                self._drop()  # the answer to a process that was suspended may be lost
        elif self._client.service_is_ready() and self._ready(wall_now - self._opened):
            if self._waiting() > self.MAX_WAITING:
                self._since = wall_now  # the worker is busy with what was fetched
                return
            self._requested_at = wall_now
            self._pending = self._client.call_async(wanted)
            self._pending.add_done_callback(self._on_done)

    def _drop(self) -> None:
        """Expect no answer any longer; the client would keep the request for as long as it lives."""
        if self._pending is not None:
            self._client.remove_pending_request(self._pending)
            self._pending = None

    def _on_done(self, future: Any) -> None:
        if future is not self._pending:
            return  # too late
        self._pending = None
        answer = future.result()
        if answer is None or not self._node.entrance.passes(PAST, answer):
            return
        if self._stream.answered(answer):
            self._since = None
            self._node.health.withdraw("past")
            self.request()


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
        """Whether a message with these values was fetched. Once one was not, no later one of its topic
        was."""
        fetched = self._fetched.get(name)
        if fetched is None:
            return False
        if values() not in fetched:
            del self._fetched[name]
            return False
        return True


@dataclass(frozen=True)
class HeldMessage:
    """A serialised message that is held back."""

    index: int
    """Index of the sample that the message is, or is about."""
    name: str
    data: bytes
    stamp: int
    """ns"""
    live: bool = True
    """Whether it was received from its publisher; else it was fetched from the keeper."""


Write = Callable[[str, bytes, int], None]
"""Takes a topic, a serialised message and its time, ns."""


class RecorderPast:
    """Gives a recorder that started late the start of its session: earlier messages, from the keeper.

    A recorder that was killed continues in another folder. A session that starts in the middle could not be
    judged, so the folder starts with the samples, matches and verdicts so far, each message directly after
    its sample: a session cut off anywhere still verifies. New messages on these topics are held back until
    those are written.
    """

    PATIENCE: Final = 10.0
    """Time without progress after which the session starts where the recorder started, wall s."""

    def __init__(self, topics: Sequence[str], write: Write) -> None:
        """Topics of samples, matches, verdicts; `write` writes a serialised message with its time (ns)."""
        self.stream = Stream(self._on_next, self._learn, verdicts=True)
        self._write = write
        self._sample, self._match, self._score = topics
        self._kinds: Mapping[str, type[Match | ModelScore]] = {
            self._match: Match,
            self._score: ModelScore,
        }
        self._about: list[HeldMessage] = []
        """Messages about samples that are still to come, in the order of writing."""
        self._copies = Copies()
        self._caught_up = False

    def take(self, name: str, data: bytes, now: int) -> bool:
        """Whether a message may be written at once; otherwise it is held back and written later."""
        if name not in (self._sample, *self._kinds):
            return True
        if self._caught_up:
            return not self._is_copy(name, data)
        if name == self._sample:
            self.stream.push(HeldMessage(decode_sample(data).index, name, data, now))
        else:
            message: Any = deserialize_message(data, self._kinds[name])
            self._hold(HeldMessage(message.sample, name, data, now))
        return False

    def finish(self) -> None:
        """Write what was held back, except what was fetched too, and hold nothing back from now on."""
        while self.stream.missing is not None:
            self.stream.skip()
        self._write_before(NONE)
        self._caught_up = True

    def _learn(self, answer: Past.Response) -> None:
        for name, messages in (
            (self._match, answer.match),
            (self._score, answer.score),
        ):
            for message in messages:
                self._copies.add(name, repr(message))
                data = serialized(message)
                stamp = nanoseconds(message.header.stamp)
                self._hold(HeldMessage(message.sample, name, data, stamp, live=False))

    def _hold(self, message: HeldMessage) -> None:
        insort(self._about, message, key=lambda waiting: (waiting.index, waiting.name))

    def _on_next(self, sample: HeldMessage | Sample) -> None:
        self._write_before(sample.index)
        if isinstance(sample, HeldMessage):
            self._write(sample.name, sample.data, sample.stamp)
        else:
            self._write(self._sample, encode_sample(sample), sample.stamp)
        if self.stream.missing is None and not self.stream.waiting:
            self.finish()

    def _write_before(self, index: int) -> None:
        """Write the messages about samples before this one."""
        while self._about and self._about[0].index < index:
            message = self._about.pop(0)
            if not (message.live and self._is_copy(message.name, message.data)):
                self._write(message.name, message.data, message.stamp)

    def _is_copy(self, name: str, data: bytes) -> bool:
        return self._copies.found(name, lambda: values_of(data, self._kinds[name]))


def values_of(data: bytes, kind: type[Match | ModelScore]) -> str:
    """All values of a serialised message, as text."""
    return repr(deserialize_message(data, kind))
