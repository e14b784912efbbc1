"""A listener: the values that a source brings, as samples. It is the same whatever the plant speaks."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import chain
from typing import Final, Protocol

from twinmatch.dynamics import Plant
from twinmatch.errors import TwinmatchError
from twinmatch.sampling.channels import Channel, SamplingError, UnreadableError
from twinmatch.sampling.names import signals_of
from twinmatch.sampling.sampler import Sampler
from twinmatch.sampling.sources import FollowedSignal, SignalSource
from twinmatch.signals import NANOSECONDS, Sample

SEARCH: Final = 0.2
"""Interval between two searches, s."""
_CHECKS: Final = 20
"""Checks for complete samples per sampling period."""
_INTERVAL: Final = (0.002, 0.05)
"""Shortest and longest interval between two checks, s."""

Read = Callable[[Channel], float | str | None]
"""The number or text at a channel of one message; None if the message has nothing for it.

Raises an UnreadableError if what is there is not a value, and a SamplingError if it cannot be meant.
"""
_MOST_REFUSALS: Final = 20
"""Most different refusals that are reported; the others are only counted."""


@dataclass
class RefusedValues:
    """Values of a signal that were not numbers."""

    count: int = 0
    now: str = ""
    """Why the newest value was refused; empty: it was not."""
    unreported: list[str] = field(default_factory=list)
    """Reasons that were not reported yet."""
    reported: set[str] = field(default_factory=set)

    def add(self, reason: str) -> None:
        """Take one more."""
        self.count += 1
        self.now = reason
        if reason not in self.reported and len(self.reported) < _MOST_REFUSALS:
            self.reported.add(reason)
            self.unreported.append(reason)


class Receive(Protocol):
    """Takes each message of a topic."""

    def __call__(
        self, topic: str, read: Read, stamp: int = 0, *, retained: bool = False
    ) -> None:
        """Take a message that can be `read`. `stamp`: when its values were measured, ns; 0: not known.
        `retained`: it was sent at some time before, and kept by a broker for late subscribers."""


class Source(Protocol):
    """Where messages come from. It is given the channels that are wanted, and a `Receive`."""

    @property
    def kinds(self) -> Mapping[str, str]:
        """Types of the topics found, by topic as configured; a type without a name is empty."""

    @property
    def lost(self) -> str:
        """Why nothing at all can come now, such as a connection that is lost; empty: it can."""

    def search(self, waited: float) -> None:
        """Look for what is wanted; to be called a few times a second, `waited` s after the first time; 0:
        however long it takes.

        Raises:
            TwinmatchError: something cannot be used, or has been waited for in vain.
        """

    def path(self, channel: Channel) -> str:
        """The path to the number of a channel whose topic was found.

        Raises:
            SamplingError: its messages have no such number.
        """

    def poll(self) -> None:
        """Hand on what has arrived, in the caller's thread."""

    def trouble(self, topic: str) -> str:
        """Why no numbers come from a topic now; empty if nothing is known against it."""

    def news(self) -> list[str]:
        """What it has noticed since it was last asked, for the user to know; each thing one time."""

    def close(self) -> bool:
        """End it; nothing is handed on any longer. Returns whether its threads have ended."""


Open = Callable[[list[Channel], Receive], Source]
"""Opens a source of these channels."""


class SignalListener:
    """Takes the messages of a source and gives one sample per tick of the loop.

    At the start, a place that is missing, a field or a unit that does not fit is an error. Once there were
    samples, it waits for a plant that falls silent.
    """

    def __init__(
        self,
        sampler: Sampler,
        plant: type[Plant],
        sources: Mapping[str, SignalSource],
        channels: Mapping[str, tuple[Channel, ...]],
        *,
        now: Callable[[], int],
        wait: float = 0.0,
    ) -> None:
        """Start without a source, which `open` gives it.

        Args:
            sampler: makes the samples.
            plant: whose signals they are.
            sources: where each signal comes from, by its name.
            channels: the same as channels.
            now: the time of the clock of the stamps, ns.
            wait: longest wait for what is missing, s; 0: for ever.
        """
        self.sampler = sampler
        self.channels = channels
        self.failed: SamplingError | None = None
        """Why there will be no samples; only the user can correct it."""
        self.ahead = ""
        """That the newest stamp was ahead of this machine's clock; empty: it was not."""
        self.misnamed: dict[str, str] = {}
        """Why messages are left out, by signal."""
        self.refusals = {name: RefusedValues() for name in sources}
        """Values that were not numbers, by signal."""
        self._words: dict[str, str] = {}
        """The newest text of each signal that sends texts; empty where words are known not to be used."""
        self._notices: list[str] = []
        self._sources = sources
        self._now = now
        self._wait = wait
        self._close: Callable[[], bool] = lambda: True  # nothing is open yet
        self._units = {name: signal.unit for name, signal in signals_of(plant).items()}
        self._ready: dict[str, FollowedSignal] = {}
        self._fresh: dict[str, dict[int, tuple[float, int]]] = {
            name: {} for name in sources
        }
        self._heard: dict[str, float] = {}
        self._begun = time.monotonic()
        self._has_samples = False

    def open(self, opened: Open) -> None:
        """Begin to listen to a source, which may have messages at once."""
        self._source = opened(
            list(chain.from_iterable(self.channels.values())), self.receive
        )
        self._close = self._source.close
        self.search()

    @property
    def interval(self) -> float:
        """Time between two calls of `samples`, s."""
        return min(max(self.sampler.period / _CHECKS, _INTERVAL[0]), _INTERVAL[1])

    @property
    def late(self) -> bool:
        """Whether the longest wait is over."""
        return bool(self._wait) and time.monotonic() > self._begun + self._wait

    def search(self) -> None:
        """Look for what is wanted; to be called every `SEARCH` s. An error is left in `failed`."""
        try:
            self._source.search(self._wait if self.late else 0.0)
            kinds = self._source.kinds
            for name, source in self._sources.items():
                channels = self.channels[name]
                if name not in self._ready and all(c.topic in kinds for c in channels):
                    checked = [c._replace(path=self._source.path(c)) for c in channels]
                    channel_kinds = [kinds[c.topic] for c in checked]
                    self._ready[name] = source.follow(
                        name, self._units[name], checked, channel_kinds
                    )
        except TwinmatchError as error:
            self.failed = SamplingError(str(error))

    def receive(
        self, topic: str, read: Read, stamp: int = 0, *, retained: bool = False
    ) -> None:
        """Take a message.

        A reading stamped in the future would never become stale, so it counts as of now; one without a stamp
        is new, unless it was `retained`: then it says nothing, except where values hold at any age.
        """
        arrived = self._now()
        is_ahead = stamp > arrived + round(self.sampler.period * NANOSECONDS)
        ahead = f"{(stamp - arrived) / 1e9:.1f} s ahead of this machine's clock; the time of arrival is used"
        self.ahead = f"the stamps of {topic} are {ahead}" if is_ahead else ""
        measured = min(stamp, arrived) if stamp else arrived
        for name, source in self._ready.items():
            if retained and not stamp and self.sampler.limits[name].max_age:
                continue
            fresh = self._fresh[name]
            numbers = self._numbers(name, source, topic, read)
            fresh |= {place: (number, measured) for place, number in numbers.items()}
            if numbers:
                self._heard[name] = time.monotonic()
                self.refusals[name].now = ""
                if len(fresh) == len(source.channels):
                    oldest = min(number_stamp for _, number_stamp in fresh.values())
                    numbers_in_order = [
                        fresh[place][0] for place in range(len(source.channels))
                    ]
                    value = source.value(numbers_in_order, oldest / NANOSECONDS)
                    if (
                        not math.isfinite(value)
                        and not self.sampler.limits[name].max_age
                    ):
                        self.sampler.end(name)
                    self.sampler.take(name, value, oldest, arrived, retained=retained)
                    fresh.clear()

    def samples(self) -> list[Sample]:
        """The samples that are complete now; to be called every `interval` s.

        Ticks that are due are read before newer values come: those belong to later ticks.
        """
        complete = self.sampler.collect(self._now())
        self._source.poll()
        if self._source.lost:
            # a value that is sent when it changes no longer holds until the next one
            self.sampler.forget()
        complete += self.sampler.collect(self._now())
        self._has_samples = self._has_samples or bool(complete)
        return complete

    def tick(self) -> None:
        """A tick of the timer, where that paces the samples."""
        self.sampler.tick(self._now())

    def news(self) -> list[str]:
        """What to report at once, each thing one time: refused values, and what the source noticed."""
        lines = []
        for name, refusals in self.refusals.items():
            lines += [
                f"{name}: {reason}; the value before it has ended"
                for reason in refusals.unreported
            ]
            refusals.unreported.clear()
        lines += self._notices
        self._notices.clear()
        return lines + self._source.news()

    def close(self) -> bool:
        """End the source, if one was opened; returns whether its threads have ended."""
        return self._close()

    def trouble(self, name: str) -> str:
        """Why a signal gives no samples now; empty if it does."""
        refused = self.refusals[name].now
        if refused and not self._source.lost:
            return f"{name}: {refused}; no samples until there is a number"
        return self._silence(name) or self._explained(
            name, self.sampler.troubles.get(name, "")
        )

    def _numbers(
        self, name: str, source: FollowedSignal, topic: str, read: Read
    ) -> dict[int, float]:
        """The numbers of a signal in a message, by their places.

        Before the first sample a message that cannot be meant is an error; later it is left out: the loop
        that was sampled until then may still run.
        """
        try:
            numbers = {}
            for place, channel in enumerate(source.channels):
                value = read(channel) if channel.topic == topic else None
                if isinstance(value, str):
                    self._words[name] = value
                elif value is not None:
                    self._notice_unused_words(name, source)
                if value is not None:
                    numbers[place] = self._finite(name, source.number(value))
        except UnreadableError as error:
            self._end(name, f"{self.channels[name][0].text}: {error}")
            return {}
        except SamplingError as error:
            if not self._has_samples:
                self.failed = SamplingError(f"{name}: {error}")
            self.misnamed[name] = f"{error}; other messages are left out"
            return {}
        return numbers

    def _notice_unused_words(self, name: str, source: FollowedSignal) -> None:
        """Notice once that values are numbers though their map has words, which may be misspelt settings."""
        if (
            source.source.words
            and not source.source.formula
            and name not in self._words
        ):
            self._words[name] = ""
            words = ", ".join(source.source.words)
            self._notices.append(
                f"{name} comes as numbers, so that {words} of its map is not used; the settings of numbers "
                "are unit, scale, offset and missing"
            )

    def _finite(self, name: str, number: float) -> float:
        """The number as it is; one that is not finite ends a value that would otherwise hold for ever.

        Raises:
            UnreadableError: it does.
        """
        if not math.isfinite(number) and not self.sampler.limits[name].max_age:
            raise UnreadableError(f"{number:g} is not a value")
        return number

    def _end(self, name: str, reason: str) -> None:
        """End a signal's value: what has come instead cannot be read."""
        self._heard[name] = time.monotonic()
        self._fresh[name].clear()
        self.sampler.end(name)
        self.refusals[name].add(reason)

    def _silence(self, name: str) -> str:
        """The report on a signal that is silent; empty if it is not, or if silence is allowed."""
        distinct_topics = dict.fromkeys(
            channel.topic for channel in self.channels[name]
        )
        topics = " and ".join(distinct_topics)
        why = self._source.lost or next(
            filter(None, map(self._source.trouble, distinct_topics)), ""
        )
        limit = self.sampler.limits[name].max_age
        heard = self._heard.get(name)
        wall_now = time.monotonic()
        if heard is None or self._source.lost:
            return f"{name}: {why or f'no message on {topics} yet'}; no samples"
        if limit and wall_now - heard > limit:
            reason = f"; {why}" if why else ""
            return f"{name}: no message on {topics} for {wall_now - heard:.1f} s{reason}; no samples"
        return ""

    def _explained(self, name: str, trouble: str) -> str:
        text = self.channels[name][0].text
        if "outside" in trouble:
            topics = [channel.topic for channel in self.channels[name]]
            if why := next(filter(None, map(self._source.trouble, topics)), ""):
                return f"{trouble} {self._units[name]}: no samples; {why}"
            if (word := self._words.get(name, "")).isalpha():
                return f"{trouble} {self._units[name]}: no samples; if {word!r} means 1, append '; {word}=1'"
            return (
                f"{trouble} {self._units[name]}: no samples; if {text} has another unit, append '; unit=' to "
                "its map entry"
            )
        if "s old" in trouble:
            return f"{trouble}: no samples; the stamps of {text} lag behind this machine's clock"
        return f"{name}: {trouble}; no samples" if trouble else ""
