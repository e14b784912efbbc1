"""The WebSocket server of the Foxglove SDK, with one channel per topic, and its time; without ROS."""

from __future__ import annotations

import logging
import re
import time
from typing import NamedTuple

from foxglove import Channel, Context, Schema, set_log_level, start_server
from foxglove.websocket import Capability, ChannelView, Client, ServerListener

from twinmatch.showing.serving import unusable

BACKLOG = 1024
"""Queue length per viewer; the oldest messages are dropped for a slow viewer. A thermal image has 77 kB."""
LARGEST_KEPT = 4_000_000
"""Largest message that is kept for late subscribers, bytes."""
GRACE = 5.0
"""Seconds without /clock after which a sample counts as one of a graph without it."""


class _Last(NamedTuple):
    """The newest message of a topic."""

    channel: Channel
    data: bytes
    at: int


class GraphServer:
    """Channels in CDR with `ros2msg` schemas, as in sessions; viewers cannot send anything.

    A new subscriber receives the newest message of the topic at once, so that it shows the current verdict
    although the next may be minutes away.
    """

    def __init__(self, name: str, address: str, port: int) -> None:
        """Serve on this address; port 0 takes any free port.

        Raises:
            ServingError: the address or port cannot be used.
        """
        set_log_level(logging.ERROR)  # a viewer that disconnects abruptly is not an error here
        self._context = Context()
        self._channels: dict[str, Channel] = {}
        self._last: dict[int, _Last] = {}
        self._viewers: dict[int, set[int]] = {}
        try:
            self._server = start_server(
                name=name,
                host=address,
                port=port,
                context=self._context,
                capabilities=[Capability.Time],
                server_listener=_Listener(self),
                message_backlog_size=BACKLOG,
            )
        except RuntimeError as error:
            cause = re.sub(r"^.*Failed to bind port: | \(os error \d+\)$", "", str(error))
            raise unusable("foxglove", address, port, cause) from error
        host = f"[{address}]" if ":" in address else address
        self.url = f"ws://{host}:{self._server.port}"
        """Address to open in the viewer."""

    @property
    def viewers(self) -> int:
        """Number of viewers with a subscription."""
        return sum(1 for topics in tuple(self._viewers.values()) if topics)

    def offers(self, topic: str) -> bool:
        """Whether a topic is advertised."""
        return topic in self._channels

    def advertise(self, topic: str, kind: str, schema: str) -> None:
        """Advertise a topic: full name, `package/msg/Type`, and its definition with those of nested types."""
        made = Schema(name=kind, encoding="ros2msg", data=schema.encode())
        self._channels[topic] = Channel(topic, schema=made, message_encoding="cdr", context=self._context)

    def send(self, topic: str, data: bytes, at: int) -> None:
        """Forward a message, CDR with its encapsulation header; `at` is the time of reception, ns."""
        channel = self._channels[topic]
        if len(data) <= LARGEST_KEPT:
            self._last[channel.id()] = _Last(channel, data, at)
        channel.log(data, log_time=at)

    def send_time(self, now: int) -> None:
        """Send the current time (ns) to the viewers."""
        self._server.broadcast_time(now)

    def forget(self, topic: str) -> None:
        """Drop the kept message of a topic that no longer has a publisher."""
        self._last.pop(self._channels[topic].id(), None)

    def reset(self, now: int) -> None:
        """Clear the viewers, because the kind of time changes; `now` is the new time, ns."""
        self._server.clear_session()
        self.send_time(now)

    def repeat(self, now: int) -> None:
        """Send the newest message of every topic again, at the time `now` (ns).

        Needed after `reset`, but not immediately: the reset and the messages go through two queues, and a
        message may overtake the reset.
        """
        for number, last in tuple(self._last.items()):
            self._last[number] = last._replace(at=now)
            last.channel.log(last.data, log_time=now)

    def close(self) -> None:
        """Stop; viewers reconnect automatically."""
        self._server.stop()

    def joined(self, viewer: int, channel: int) -> None:
        """Send a viewer the newest message of a channel that it has subscribed to."""
        self._viewers.setdefault(viewer, set()).add(channel)
        last = self._last.get(channel)
        if last is not None:
            last.channel.log(last.data, log_time=last.at, sink_id=viewer)

    def left(self, viewer: int, channel: int) -> None:
        """Note that a viewer has unsubscribed from a channel."""
        channels = self._viewers.get(viewer, set())
        channels.discard(channel)
        if not channels:
            self._viewers.pop(viewer, None)


class _Listener(ServerListener):
    """Called by a thread of the SDK."""

    def __init__(self, server: GraphServer) -> None:
        self._server = server

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        self._server.joined(client.id, channel.id)

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        self._server.left(client.id, channel.id)


class StreamTime:
    """Follows /clock while it is published, then stops until a graph without /clock has samples.

    A replay can therefore still be viewed after its end. Every change between the two kinds of time is
    reported, because viewers must then be reset.
    """

    def __init__(self) -> None:
        """Start with wall time."""
        self._plant: int | None = None
        self._received = 0.0

    @property
    def now(self) -> int:
        """Time, ns since the epoch of its clock."""
        return time.time_ns() if self._plant is None else self._plant

    def on_clock(self, stamp: int, at: float) -> bool:
        """Take the time of /clock (ns), received at a monotonic time (s); returns whether the kind of time
        has changed."""
        changed = self._plant is None
        self._plant, self._received = stamp, at
        return changed

    def on_sample(self, at: float, *, clock: bool) -> bool:
        """Note a sample, and whether /clock has a publisher; returns whether the kind of time has changed."""
        if self._plant is None or clock or at - self._received < GRACE:
            return False
        self._plant = None
        return True
