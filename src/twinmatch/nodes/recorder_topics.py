"""The topics a recorder takes, and the QoS with which it receives all their messages."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from twinmatch.sessions import Qos

__all__ = ["offered", "reader_profile", "wanted"]

ELSEWHERE = ("/clock", "/diagnostics", "/parameter_events", "/rosout")
"""Topics that belong to no rig: recorded only on request."""

DEPTH = 1000
"""Queue of the recorder in the middleware, messages per topic; it never applies back-pressure."""


def wanted(name: str, namespace: str, also: Collection[str] = (), leave_out: Sequence[str] = ()) -> bool:
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


def reader_profile(qos: Qos) -> QoSProfile:
    """The profile with which a recorder receives everything that is offered with this QoS."""
    reliable, latched = qos.reliability == "reliable", qos.durability == "transient_local"
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
