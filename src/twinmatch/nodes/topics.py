"""Topics and their QoS: ours, and those that a recorder takes."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Collection, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from twinmatch.errors import TwinmatchError
from twinmatch.sessions import Qos

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
