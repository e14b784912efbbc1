"""Topics of programs that are not ours: found on the graph, and heard as they are sent."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, Final

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node

from twinmatch.errors import TwinmatchError
from twinmatch.nodes.message_types import fields_of, message_class
from twinmatch.nodes.recorder_topics import offered, reader_profile
from twinmatch.sampling import Channel, SamplingError, check_path

__all__ = ["ForeignTopics"]

_OURS: Final = ("/plant/", "/twin/", "/thermal/")
_NOBODYS: Final = ("/clock", "/diagnostics", "/parameter_events", "/rosout")
_MANY: Final = 40
"""Topics that an error lists."""

Hear = Callable[[str, Any], None]
"""Is given the topic's name and the message."""


class ForeignTopics:
    """Looks for topics and subscribes as their publishers send."""

    def __init__(self, node: Node, channels: Iterable[Channel], types: Mapping[str, str], hear: Hear) -> None:
        """Begin with none found.

        Args:
            node: whose subscriptions they are.
            channels: whose topics are wanted.
            types: those that were given, by topic.
            hear: is given what comes.
        """
        self._node = node
        self._hear = hear
        self._types = {node.resolve_topic_name(topic): kind for topic, kind in types.items()}
        self._names = {c.topic: node.resolve_topic_name(c.topic) for c in channels}
        self._counted: dict[str, int] = {}
        self._readers: dict[str, tuple[Any, Any]] = {}  # profile and subscription
        self.kinds: dict[str, str] = {}
        """Types of the topics that were found, by the name that was written."""

    @property
    def missing(self) -> list[str]:
        """Topics that nobody has published yet."""
        return [topic for topic in self._names if topic not in self.kinds]

    def publishers(self, topic: str) -> int:
        """How many programs publish a topic now."""
        return int(self._node.count_publishers(self._names[topic]))

    def look(self) -> None:
        """Find topics, and hear again those whose publishers changed; to be called a few times a second.

        Raises:
            TwinmatchError: a topic has several types, or one that is not installed.
        """
        for topic, name in self._names.items():
            count = self.publishers(topic)
            if count and count != self._counted.get(topic):
                self._subscribe(topic, name)
                self._counted[topic] = count
            elif not count:
                self._counted.pop(topic, None)

    def path(self, channel: Channel) -> str:
        """The path to the number of a channel whose topic was found.

        Raises:
            SamplingError: its messages have no such number; the message says which they have.
        """
        try:
            return check_path(self.kinds[channel.topic], channel.path, fields_of)
        except SamplingError as error:
            raise SamplingError(f"{channel.text}: {error}") from None

    def instead(self) -> str:
        """Which topics of others there are, for who looked for another one."""
        found = [
            f"{name} ({', '.join(kinds)})"
            for name, kinds in sorted(self._node.get_topic_names_and_types())
            if not name.startswith(_OURS) and name not in _NOBODYS and self._node.count_publishers(name)
        ]
        more = f" and {len(found) - _MANY} more" if len(found) > _MANY else ""
        return ", ".join(found[:_MANY]) + more or "none, in this domain and from this machine"

    def _subscribe(self, topic: str, name: str) -> None:
        endpoints = self._node.get_publishers_info_by_topic(name)
        if not endpoints:
            return
        kind = self._kind(topic, name, {endpoint.topic_type for endpoint in endpoints})
        profile = reader_profile(offered([e for e in endpoints if e.topic_type == kind] or endpoints))
        known, reader = self._readers.get(topic, (None, None))
        if known == profile:
            return
        try:
            sent = message_class(kind)
        except TwinmatchError as error:
            raise SamplingError(f"{topic}: {error}") from error
        if reader is not None:  # other publishers came that offer less
            self._node.destroy_subscription(reader)
        quiet = SubscriptionEventCallbacks(use_default_callbacks=False)
        reader = self._node.create_subscription(
            sent, name, partial(self._hear, topic), profile, event_callbacks=quiet
        )
        self._readers[topic] = profile, reader
        self.kinds[topic] = kind

    def _kind(self, topic: str, name: str, found: set[str]) -> str:
        given = self._types.get(name)
        if given is not None:
            return given
        if len(found) > 1:
            msg = (
                f"{topic} is published as {' and '.join(sorted(found))}; say which is meant: types:="
                f"'{topic} {min(found)}'"
            )
            raise SamplingError(msg)
        return self.kinds.get(topic) or next(iter(found))
