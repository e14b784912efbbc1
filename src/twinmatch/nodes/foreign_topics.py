"""Topics of foreign programs as a source: found, followed, and read field by field."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any, Final

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node

from twinmatch.nodes.topics import (
    ELSEWHERE,
    Following,
    MessageTypeError,
    message_class,
)
from twinmatch.sampling.channels import (
    Channel,
    Field,
    Followed,
    SamplingError,
    check_path,
)
from twinmatch.sampling.listener import Receive
from twinmatch.signals import NANOSECONDS

_KIND: Final = re.compile(
    r"(?:sequence<)?(?P<base>[\w/ ]+?)(?:<\d+>)?(?:\[(?P<length>\d+)\])?(?:, \d+)?>?$"
)
_OURS: Final = ("/plant/", "/twin/", "/thermal/")
_MAX_LISTED: Final = 40
"""Most topics that an error lists."""


def fields_of(kind: str) -> Mapping[str, Field]:
    """The fields of an installed type.

    Raises:
        MessageTypeError: it is not installed.
    """
    return {
        n: field_of(text)
        for n, text in message_class(kind).get_fields_and_field_types().items()
    }


def field_of(text: str) -> Field:
    """A field from ROS's notation of its type: `double`, `sequence<std_msgs/Header, 3>`, `float[9]`."""
    match = _KIND.match(text)
    base = match["base"] if match else text
    if "/" in base:
        package, name = base.split("/")
        base = f"{package}/msg/{name}"
    length = match["length"] if match else None
    return Field(
        base,
        text.startswith("sequence") or length is not None,
        int(length) if length else None,
    )


class ForeignTopics:
    """Topics of ROS as a source; it subscribes with a QoS that matches their publishers."""

    def __init__(
        self,
        node: Node,
        channels: Iterable[Channel],
        receive: Receive,
        *,
        types: Mapping[str, str],
    ) -> None:
        """Start without any found.

        Args:
            node: the node that subscribes.
            channels: the channels whose topics are wanted.
            receive: called with each message.
            types: the configured message types, by topic.
        """
        self._node = node
        self._receive = receive
        self._followed: dict[Channel, Followed] = {}
        self._types = {
            node.resolve_topic_name(topic): kind for topic, kind in types.items()
        }
        self._names = {c.topic: node.resolve_topic_name(c.topic) for c in channels}
        quiet = SubscriptionEventCallbacks(use_default_callbacks=False)
        # One each: a topic may be configured under two names, with a namespace and without.
        self._following = {
            topic: Following(node, event_callbacks=quiet) for topic in self._names
        }
        self.kinds: dict[str, str] = {}
        """Types of the topics found, by topic name as configured."""

    def search(self, waited: float) -> None:
        """Find topics, and resubscribe where publishers changed.

        Raises:
            TwinmatchError: a topic has several types, a type that is not installed, or no publisher.
        """
        for topic, name in self._names.items():
            if publishers := self._following[topic].news(name):
                self._subscribe(topic, name, publishers)
        missing = [topic for topic in self._names if topic not in self.kinds]
        if missing and waited:
            raise SamplingError(
                f"no publisher on {' or '.join(missing)} for {waited:g} s; topics with a publisher: "
                f"{self._alternatives()}"
            )

    def path(self, channel: Channel) -> str:
        """The field path of a channel whose topic was found.

        Raises:
            SamplingError: its messages have no such number; the error lists those that they have.
        """
        try:
            return check_path(self.kinds[channel.topic], channel.path, fields_of)
        except SamplingError as error:
            raise SamplingError(f"{channel.text}: {error}") from None

    @property
    def lost(self) -> str:
        """Why the connection is lost; always empty, as topics have publishers and no connection."""
        return ""

    def poll(self) -> None:
        """Messages are handed on as they arrive, by the node's executor."""

    def trouble(self, topic: str) -> str:
        """What is wrong with a topic: that it has no publisher; empty if it has one."""
        if self._node.count_publishers(self._names[topic]):
            return ""
        return (
            f"{topic} no longer has a publisher"
            if topic in self.kinds
            else f"no publisher on {topic}"
        )

    def news(self) -> list[str]:
        """Nothing: what is wrong is an error or a trouble."""
        return []

    def close(self) -> bool:
        """The node destroys its subscriptions."""
        return True

    def _take(self, topic: str, message: Any) -> None:
        header = getattr(message, "header", None)
        stamp = (
            0
            if header is None
            else header.stamp.sec * NANOSECONDS + header.stamp.nanosec
        )

        def read(channel: Channel) -> float | None:
            return self._followed.setdefault(channel, Followed(channel)).number(message)

        self._receive(topic, read, stamp)

    def _alternatives(self) -> str:
        """The foreign topics that exist, for the error about one that does not."""
        foreign = []
        for name, kinds in sorted(self._node.get_topic_names_and_types()):
            is_ours = name.startswith(_OURS) or name in ELSEWHERE
            if not is_ours and self._node.count_publishers(name):
                foreign.append(f"{name} ({', '.join(kinds)})")
        count_of_further = (
            f" and {len(foreign) - _MAX_LISTED} more"
            if len(foreign) > _MAX_LISTED
            else ""
        )
        return (
            ", ".join(foreign[:_MAX_LISTED]) + count_of_further
            or "none, in this domain and from this machine"
        )

    def _subscribe(self, topic: str, name: str, publishers: Sequence[Any]) -> None:
        kind = self._kind(
            topic, name, {publisher.topic_type for publisher in publishers}
        )
        of_kind = [
            publisher for publisher in publishers if publisher.topic_type == kind
        ] or publishers
        try:
            self._following[topic].subscribe(
                name, kind, of_kind, partial(self._take, topic)
            )
        except MessageTypeError as error:
            raise SamplingError(f"{topic}: {error}") from error
        self.kinds[topic] = kind

    def _kind(self, topic: str, name: str, kinds: set[str]) -> str:
        """The type of a topic: as configured, or else the only one that is published.

        Raises:
            SamplingError: it is published with several types.
        """
        given_kind = self._types.get(name)
        if given_kind is not None:
            return given_kind
        if len(kinds) > 1:
            raise SamplingError(
                f"{topic} is published as {' and '.join(sorted(kinds))}; choose one with types:="
                f"'{topic} {min(kinds)}'"
            )
        return self.kinds.get(topic) or next(iter(kinds))
