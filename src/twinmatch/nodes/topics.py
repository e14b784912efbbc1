"""Topics and their QoS: ours, those that a recorder takes, and those of foreign programs."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, Final

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from twinmatch.errors import TwinmatchError
from twinmatch.sampling.channels import (
    Channel,
    Field,
    Followed,
    SamplingError,
    check_path,
)
from twinmatch.sampling.listener import Receive
from twinmatch.sessions import Qos
from twinmatch.signals import NANOSECONDS

EVERYTHING = QoSProfile(
    history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE
)
"""For readers that must not miss a message. Their queue has no limit where the network is restricted to this
machine; elsewhere that of the middleware applies, and a full queue makes the writer wait."""

DEPTH = 1000
"""Messages that a writer keeps for readers that are late, and queue of the recorder for each topic: at rate 0
a twin publishes some hundred states a second, and a reader may have to wait for the processor."""

RELIABLE = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE
)
"""For writers of samples, requests, matches and scores."""

LATCHED = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""For a value that holds until the next one: a late-joining subscriber gets it too."""

NEWEST = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.BEST_EFFORT
)
"""For readings and /clock, of which only the newest message counts."""

ELSEWHERE = ("/clock", "/diagnostics", "/parameter_events", "/rosout")
"""Topics that belong to no rig: recorded only on request."""


def wanted(
    name: str, namespace: str, also: Collection[str] = (), leave_out: Sequence[str] = ()
) -> bool:
    """Whether a topic is recorded: those of the namespace, unless hidden or left out, and `also` others.

    Args:
        name: full name.
        namespace: namespace of the rig, `/` for the root.
        also: full names of topics to record outside the namespace.
        leave_out: prefixes of names relative to the namespace that are not recorded.
    """
    if name in also:
        return True
    prefix = namespace.rstrip("/") + "/"
    if name in ELSEWHERE or not name.startswith(prefix) or "/_" in name:
        return False
    return not name.removeprefix(prefix).startswith(tuple(leave_out))


def offered(endpoints: Sequence[Any]) -> Qos:
    """The QoS that all publishers of a topic (`TopicEndpointInfo`) offer."""
    profiles = [endpoint.qos_profile for endpoint in endpoints]
    reliable = all(p.reliability == ReliabilityPolicy.RELIABLE for p in profiles)
    latched = all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
    depth = max((p.depth for p in profiles), default=0)
    usual = 1 if latched else Qos().depth  # discovery does not always report the depth
    return Qos(
        "reliable" if reliable else "best_effort",
        "transient_local" if latched else "volatile",
        depth if depth > 0 else usual,
    )


def profile_of(qos: Qos, depth: int = DEPTH) -> QoSProfile:
    """The profile of this QoS with a queue of `depth` messages; by default a recorder's."""
    reliability = ReliabilityPolicy.BEST_EFFORT
    if qos.reliability == "reliable":
        reliability = ReliabilityPolicy.RELIABLE
    durability = DurabilityPolicy.VOLATILE
    if qos.durability == "transient_local":
        durability = DurabilityPolicy.TRANSIENT_LOCAL
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=reliability,
        durability=durability,
    )


_KIND: Final = re.compile(
    r"(?:sequence<)?(?P<base>[\w/ ]+?)(?:<\d+>)?(?:\[(?P<length>\d+)\])?(?:, \d+)?>?$"
)


class MessageTypeError(TwinmatchError):
    """A message type is not installed here."""


def message_class(kind: str) -> Any:
    """The class of a type, `package/msg/Type`.

    Raises:
        MessageTypeError: it is not installed.
    """
    package, _, name = kind.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        msg = f"the type {kind} is not installed here; source the workspace with {package}, and restart"
        raise MessageTypeError(msg) from None


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


class Following:
    """Subscriptions that follow their publishers: made again where those now there offer a weaker QoS."""

    def __init__(self, node: Node, **options: Any) -> None:
        """`options` are those of every subscription."""
        self._node = node
        self._options = options
        self._counted: dict[str, int] = {}
        self._readers: dict[str, tuple[QoSProfile, Any]] = {}

    def __contains__(self, name: object) -> bool:
        return name in self._readers

    def __len__(self) -> int:
        return len(self._readers)

    def news(self, name: str) -> Sequence[Any] | None:
        """The publishers of a topic (`TopicEndpointInfo`); None while they are as many as before."""
        count = self._node.count_publishers(name)
        if count == self._counted.get(name, 0):
            return None  # querying their QoS is a hundred times as expensive
        publishers: Sequence[Any] = self._node.get_publishers_info_by_topic(name)
        if count and not publishers:
            return None
        self._counted[name] = count
        return publishers

    def subscribe(
        self,
        name: str,
        kind: str,
        publishers: Sequence[Any],
        take: Callable[[Any], None],
        **options: Any,
    ) -> Any:
        """The subscription with the QoS that all publishers offer, made unless it is there already.

        Raises:
            MessageTypeError: the type is not installed.
        """
        profile = profile_of(offered(publishers))
        used_profile, reader = self._readers.get(name, (None, None))
        if used_profile == profile:
            return reader
        sent = message_class(kind)
        if reader is not None:
            self._node.destroy_subscription(reader)
        reader = self._node.create_subscription(
            sent, name, take, profile, **self._options, **options
        )
        self._readers[name] = profile, reader
        return reader


_OURS: Final = ("/plant/", "/twin/", "/thermal/")
_MAX_LISTED: Final = 40
"""Most topics that an error lists."""


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
