"""Topics of foreign programs: found on the graph, and subscribed with the QoS they are offered with."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, Final

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node

from twinmatch.errors import TwinmatchError
from twinmatch.nodes.message_types import fields_of, message_class
from twinmatch.nodes.recorder_topics import offered, reader_profile
from twinmatch.sessions.sampling import Channel, SamplingError, check_path

__all__ = ["ForeignTopics"]

_OURS: Final = ("/plant/", "/twin/", "/thermal/")
_SHARED: Final = ("/clock", "/diagnostics", "/parameter_events", "/rosout")
_MOST_LISTED: Final = 40
"""Most topics that an error lists."""

Receive = Callable[[str, Any], None]
"""Called with the topic's name and a message."""


class ForeignTopics:
    """Looks for topics and subscribes with a QoS that matches their publishers."""

    def __init__(
        self, node: Node, channels: Iterable[Channel], types: Mapping[str, str], receive: Receive
    ) -> None:
        """Start without any found.

        Args:
            node: the node that subscribes.
            channels: the channels whose topics are wanted.
            types: the configured message types, by topic.
            receive: called with each message.
        """
        self._node = node
        self._receive = receive
        self._types = {node.resolve_topic_name(topic): kind for topic, kind in types.items()}
        self._names = {c.topic: node.resolve_topic_name(c.topic) for c in channels}
        self._counted: dict[str, int] = {}
        self._readers: dict[str, tuple[Any, Any]] = {}  # profile and subscription
        self.kinds: dict[str, str] = {}
        """Types of the topics found, by topic name as configured."""

    @property
    def missing(self) -> list[str]:
        """Topics that have had no publisher yet."""
        return [topic for topic in self._names if topic not in self.kinds]

    def publishers(self, topic: str) -> int:
        """The number of publishers of a topic now."""
        return int(self._node.count_publishers(self._names[topic]))

    def look(self) -> None:
        """Find topics, and resubscribe where publishers changed; to be called a few times a second.

        Raises:
            TwinmatchError: a topic has several types, or a type that is not installed.
        """
        for topic, name in self._names.items():
            count = self.publishers(topic)
            if count and count != self._counted.get(topic):
                self._subscribe(topic, name)
                self._counted[topic] = count
            elif not count:
                self._counted.pop(topic, None)

    def path(self, channel: Channel) -> str:
        """The field path of a channel whose topic was found.

        Raises:
            SamplingError: its messages have no such number; the error lists those that they have.
        """
        try:
            return check_path(self.kinds[channel.topic], channel.path, fields_of)
        except SamplingError as error:
            raise SamplingError(f"{channel.text}: {error}") from None

    def alternatives(self) -> str:
        """The foreign topics that exist, for the error about one that does not."""
        found = [
            f"{name} ({', '.join(kinds)})"
            for name, kinds in sorted(self._node.get_topic_names_and_types())
            if not name.startswith(_OURS) and name not in _SHARED and self._node.count_publishers(name)
        ]
        more = f" and {len(found) - _MOST_LISTED} more" if len(found) > _MOST_LISTED else ""
        return ", ".join(found[:_MOST_LISTED]) + more or "none, in this domain and from this machine"

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
        if reader is not None:  # a new publisher offers a weaker QoS
            self._node.destroy_subscription(reader)
        quiet = SubscriptionEventCallbacks(use_default_callbacks=False)
        reader = self._node.create_subscription(
            sent, name, partial(self._receive, topic), profile, event_callbacks=quiet
        )
        self._readers[topic] = profile, reader
        self.kinds[topic] = kind

    def _kind(self, topic: str, name: str, found: set[str]) -> str:
        given = self._types.get(name)
        if given is not None:
            return given
        if len(found) > 1:
            msg = (
                f"{topic} is published as {' and '.join(sorted(found))}; choose one with types:="
                f"'{topic} {min(found)}'"
            )
            raise SamplingError(msg)
        return self.kinds.get(topic) or next(iter(found))
