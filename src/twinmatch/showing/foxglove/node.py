"""The WebSocket server of the Foxglove SDK, with one channel per topic, its time, and the node behind it,
which subscribes to every topic of its namespace and forwards the bytes."""

from __future__ import annotations

import logging
import time
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple

from foxglove import Channel, Context, Schema, set_log_level, start_server
from foxglove.websocket import Capability, ChannelView, Client, ServerListener
from rclpy.clock import Clock, ClockType
from rosgraph_msgs.msg import Clock as ClockMessage

from twinmatch.description import Description
from twinmatch.ending import end_in_order
from twinmatch.nodes.health import Level, Report
from twinmatch.nodes.messages import record_of
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.nodes.topics import LATCHED, NEWEST, Following, wanted
from twinmatch.parameters.declared import Setting
from twinmatch.sessions import SessionError
from twinmatch.sessions.messages import schema_of
from twinmatch.settings import Rule
from twinmatch.showing.foxglove.layout import (
    APPLIED,
    IMAGE,
    OUTSIDE,
    TOPICS,
    layout,
    write_layout,
)
from twinmatch.showing.foxglove.relay import Relay, hidden_address
from twinmatch.showing.serving import (
    Hosts,
    ServingError,
    listen,
    place_settings,
    warn_if_open,
)
from twinmatch_msgs.msg import PlantDescription

BACKLOG = 1024
"""Queue length per viewer; the oldest messages are dropped for a slow viewer. A thermal image has 77 kB."""
LARGEST_KEPT = 4_000_000
"""Largest message that is kept for late subscribers, bytes."""


class _Times(Rule):
    """Times of the server, s."""

    grace: float = 5.0
    """Time without /clock after which a sample counts as one of a graph without it."""
    poll: float = 0.2
    """Time between checks for new topics."""
    tick: float = 0.05
    """Time between updates of the viewers' time."""


_TIMES: Final = _Times()


class _Last(NamedTuple):
    """The newest message of a topic."""

    channel: Channel
    data: bytes
    at: int
    """Time at which it was received or sent again, ns."""


class GraphServer(ServerListener):
    """Channels in CDR with `ros2msg` schemas, as in sessions; viewers cannot send anything.

    A new subscriber receives the newest message of the topic at once, so that it shows the current verdict
    although the next may be minutes away.
    """

    def __init__(
        self, name: str, address: str, port: int, hosts: Hosts | None = None
    ) -> None:
        """Serve on this address; port 0 takes any free port.

        `hosts` are the names that it answers to; None: those of the address alone.

        Raises:
            ServingError: the address or port cannot be used.
        """
        # a viewer that disconnects abruptly is not an error here
        set_log_level(logging.ERROR)
        self._context = Context()
        self._channels: dict[str, Channel] = {}
        self._last: dict[int, _Last] = {}
        self._viewers: dict[int, set[int]] = {}
        bound, place = listen("foxglove", address, port)
        inner: dict[str, Any] = {
            "name": name,
            "host": hidden_address(),
            "port": 0,
            "context": self._context,
        }
        able: dict[str, Any] = {
            "capabilities": [Capability.Time],
            "message_backlog_size": BACKLOG,
        }
        self._server = start_server(**inner, **able, server_listener=self)
        self._relay = Relay(
            bound, hosts or Hosts.of(address), (inner["host"], self._server.port)
        )
        self.url = f"ws://{place}"
        """Address to open in the viewer."""

    @property
    def viewers(self) -> int:
        """Number of viewers with a subscription."""
        return sum(bool(topics) for topics in tuple(self._viewers.values()))

    def offers(self, topic: str, kind: str) -> bool:
        """Whether a topic is advertised with this type."""
        return topic in self._channels and self._channels[topic].schema_name() == kind

    def advertise(self, topic: str, kind: str, schema: str) -> None:
        """Advertise a topic: full name, `package/msg/Type`, and its definition with those of nested types.

        The SDK tells the viewers of a channel before it knows the channel itself, and refuses a viewer that
        subscribes in between: so what it says is passed on once the channel is made.
        """
        if topic in self._channels:
            closed = self._channels.pop(topic)
            self._last.pop(closed.id(), None)
            closed.close()
        declared = Schema(name=kind, encoding="ros2msg", data=schema.encode())
        with self._relay.holding_back():
            self._channels[topic] = Channel(
                topic, schema=declared, message_encoding="cdr", context=self._context
            )

    def send(self, topic: str, data: bytes, received: int) -> None:
        """Forward a message, CDR with its encapsulation header; `received` is the time of reception, ns."""
        channel = self._channels[topic]
        if len(data) <= LARGEST_KEPT:
            self._last[channel.id()] = _Last(channel, data, received)
        channel.log(data, log_time=received)

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

    def close(self) -> bool:
        """Stop; viewers reconnect automatically. Returns whether the threads have ended."""
        return end_in_order(self._server.stop, self._relay.close)

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Send a viewer the newest message of a channel; called by a thread of the SDK."""
        self._viewers.setdefault(client.id, set()).add(channel.id)
        last = self._last.get(channel.id)
        if last is not None:
            last.channel.log(last.data, log_time=last.at, sink_id=client.id)

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        """Note that a viewer has unsubscribed from a channel; called by a thread of the SDK."""
        self._viewers.get(client.id, set()).discard(channel.id)


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

    def on_clock(self, stamp: int, received: float) -> bool:
        """Take the time of /clock (ns), received at a monotonic time (s); returns whether the kind of time
        has changed."""
        changed = self._plant is None
        self._plant = stamp
        self._received = received
        return changed

    def on_sample(self, received: float, *, clock: bool) -> bool:
        """Note a sample, and whether /clock has a publisher; returns whether the kind of time has changed."""
        if self._plant is None or clock or received - self._received < _TIMES.grace:
            return False
        self._plant = None
        return True


LEFT_OUT = ("parameter_events",)


class Foxglove(TwinmatchNode):
    """Shows the graph of its namespace to viewers; publishes only its health.

    It keeps running when the graph ends, and serves the next one.
    """

    NAME = "foxglove"
    PARAMETERS: ClassVar = (
        *place_settings(8765),
        Setting(
            "layout",
            "",
            "File for the layout of the graph's plant; empty: none is written.",
        ),
    )

    _serving = False

    def open(self) -> None:
        """Start the server, and watch for topics."""
        address = self.values["address"]
        hosts = Hosts.of(address, self.values["hosts"])
        self._server = GraphServer("twinmatch", address, self.values["port"], hosts)
        self._serving = True
        self._time = StreamTime()
        self._following = Following(self, raw=True)
        self._types: dict[str, str] = {}
        self._unknown: set[str] = set()
        rig = self.get_namespace().rstrip("/")
        for name, kind in (
            {f"{rig}/{name}": kind for name, kind in TOPICS.items()} | OUTSIDE
        ).items():
            self._advertise(name, kind)
        # publishers decide: set-points of several loops have another one
        self._types.clear()
        self._has_clock = self._to_repeat = False
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._described: Description | None = None
        self._laid_out: tuple[Description, frozenset[str]] | None = None
        if self.values["layout"]:
            self.create_subscription(
                PlantDescription, "plant/description", self._on_description, LATCHED
            )
        self.create_subscription(ClockMessage, "/clock", self._on_clock, NEWEST)
        self.create_timer(_TIMES.poll, self._find_topics, clock=steady)
        self.create_timer(_TIMES.tick, self._send_time, clock=steady)
        warn_if_open("FOXGLOVE", address, "read this graph")
        print(f"foxglove: {self._server.url}", flush=True)
        self.report_on()

    def report(self) -> Report:
        """Report the address and the numbers of viewers and topics."""
        self.health.set("address", self._server.url)
        self.health.set("viewers", self._server.viewers)
        self.health.set("topics", len(self._following))
        return super().report()

    def close(self) -> bool:
        """Stop the server."""
        servers = [self._server.close] if self._serving else []
        return end_in_order(*servers, super().close)

    def _find_topics(self) -> None:
        self._has_clock = self.count_publishers("/clock") > 0
        for name, _ in self.get_topic_names_and_types():
            if name not in self._unknown and wanted(
                name, self.get_namespace(), OUTSIDE, LEFT_OUT
            ):
                self._subscribe(name)
        self._lay_out()

    def _on_description(self, message: PlantDescription) -> None:
        self._described = record_of(message)

    def _lay_out(self) -> None:
        """Write the layout once the plant is described, and again if its description or topics change."""
        if self._described is None:
            return
        rig = self.get_namespace().rstrip("/")
        present = frozenset(
            topic for topic in (APPLIED, IMAGE) if f"{rig}/{topic}" in self._following
        )
        if self._laid_out == (self._described, present):
            return
        self._laid_out = self._described, present
        path = Path(self.values["layout"])
        try:
            write_layout(path, layout(self._described, present, rig))
            print(f"layout for {self._described.title}: {path}", flush=True)
        except ServingError as error:
            self.health.flag("layout", Level.WARN, str(error))

    def _subscribe(self, name: str) -> None:
        """Subscribe to a topic, or again if its publishers now offer another QoS."""
        publishers = self._following.news(name)
        if publishers:
            kind = publishers[0].topic_type
            if name in self._following or self._advertise(name, kind):
                self._following.subscribe(
                    name, kind, publishers, partial(self._on_message, name)
                )
        elif publishers is not None:
            self._server.forget(name)

    def _advertise(self, name: str, kind: str) -> bool:
        """Advertise a topic to viewers, once; returns whether it can be shown."""
        before = self._types.setdefault(name, kind)
        try:
            if before != kind:
                raise SessionError(
                    f"its type changed from {before} to {kind}; restart twinmatch foxglove"
                )
            if not self._server.offers(name, kind):
                self._server.advertise(name, kind, schema_of(kind))
        except SessionError as error:
            self._unknown.add(name)
            self.health.flag(name, Level.WARN, f"{name} is not shown: {error}")
            return False
        return True

    def _on_clock(self, message: ClockMessage) -> None:
        stamp = message.clock.sec * 10**9 + message.clock.nanosec
        self._reset_if(self._time.on_clock(stamp, time.monotonic()))

    def _on_message(self, name: str, data: bytes) -> None:
        if name.endswith("plant/sample"):
            self._reset_if(
                self._time.on_sample(time.monotonic(), clock=self._has_clock)
            )
        self._server.send(name, data, self._time.now)

    def _reset_if(self, changed: bool) -> None:
        """Clear the viewers if the kind of time has changed; the newest messages are sent again after
        that."""
        if changed:
            self._server.reset(self._time.now)
            self._to_repeat = True

    def _send_time(self) -> None:
        self._server.send_time(self._time.now)
        if self._to_repeat:
            self._to_repeat = False
            self._server.repeat(self._time.now)
