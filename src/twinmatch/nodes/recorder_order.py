"""The order in which a recorder writes fetched messages: a session cut off anywhere still verifies."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable
from typing import NamedTuple

__all__ = ["Copies", "Fetched", "InOrder"]


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
