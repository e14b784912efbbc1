"""The WebSocket server of the Foxglove SDK, with a channel for each topic; knows no ROS."""

from __future__ import annotations

import logging
import re
from typing import NamedTuple

from foxglove import Channel, Context, Schema, set_log_level, start_server
from foxglove.websocket import Capability, ChannelView, Client, ServerListener

from twinmatch.foxglove.errors import FoxgloveError

__all__ = ["GraphServer"]

BACKLOG = 1024
"""Messages that wait for a slow viewer before its oldest are dropped; a thermal image has 77 kB."""
LARGEST_KEPT = 4_000_000
"""Bytes of a message that is kept for whoever comes later."""


class _Last(NamedTuple):
    """The newest message of a topic."""

    channel: Channel
    data: bytes
    at: int


class GraphServer:
    """Channels in CDR with `ros2msg` schemas, as sessions have them; nothing can be sent to it.

    Whoever subscribes is given the newest message of the topic at once, so that a verdict is seen
    though the next is minutes away.
    """

    def __init__(self, name: str, address: str, port: int) -> None:
        """Serve on this address; port 0 takes any that is free.

        Raises:
            FoxgloveError: the address or port cannot be used.
        """
        set_log_level(logging.ERROR)  # a viewer that leaves without a word is none of ours
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
            msg = (
                f"foxglove: {address}:{port} cannot be used: {cause}; "
                "give another with --port (0: any that is free) or --address"
            )
            raise FoxgloveError(msg) from error
        host = f"[{address}]" if ":" in address else address
        self.url = f"ws://{host}:{self._server.port}"
        """What has to be opened in the viewer."""

    @property
    def viewers(self) -> int:
        """How many look at something."""
        return sum(1 for topics in tuple(self._viewers.values()) if topics)

    def offers(self, topic: str) -> bool:
        """Whether a topic is offered."""
        return topic in self._channels

    def advertise(self, topic: str, kind: str, schema: str) -> None:
        """Offer a topic: full name, `package/msg/Type`, and its definition with those of its parts."""
        made = Schema(name=kind, encoding="ros2msg", data=schema.encode())
        self._channels[topic] = Channel(topic, schema=made, message_encoding="cdr", context=self._context)

    def send(self, topic: str, data: bytes, at: int) -> None:
        """Hand on a message, CDR with its encapsulation header; `at` is when it came, ns."""
        channel = self._channels[topic]
        if len(data) <= LARGEST_KEPT:
            self._last[channel.id()] = _Last(channel, data, at)
        channel.log(data, log_time=at)

    def tell_time(self, now: int) -> None:
        """Tell the viewers what time it is, ns."""
        self._server.broadcast_time(now)

    def forget(self, topic: str) -> None:
        """Keep no message of a topic that nobody publishes any more."""
        self._last.pop(self._channels[topic].id(), None)

    def begin_anew(self, now: int) -> None:
        """Have the viewers forget what they were shown, because another time begins (ns)."""
        self._server.clear_session()
        self.tell_time(now)

    def repeat(self, now: int) -> None:
        """Send the newest message of every topic again, as of now (ns).

        After `begin_anew`, but not at once: what begins a session and what is sent in it go through two
        queues, and the second may overtake the first.
        """
        for number, last in tuple(self._last.items()):
            self._last[number] = last._replace(at=now)
            last.channel.log(last.data, log_time=now)

    def close(self) -> None:
        """End; the viewers try again by themselves."""
        self._server.stop()

    def joined(self, viewer: int, channel: int) -> None:
        """Give a viewer the newest message of what it has subscribed to."""
        self._viewers.setdefault(viewer, set()).add(channel)
        last = self._last.get(channel)
        if last is not None:
            last.channel.log(last.data, log_time=last.at, sink_id=viewer)

    def left(self, viewer: int, channel: int) -> None:
        """Note that a viewer looks at something no more."""
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
