"""The node behind the server: subscribes to every topic of its namespace and forwards the bytes."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import ClassVar

from rclpy.clock import Clock, ClockType
from rosgraph_msgs.msg import Clock as ClockMessage

from twinmatch.description import Description
from twinmatch.nodes.health import Level, Report
from twinmatch.nodes.messages import description_from
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.nodes.plant_clock import CLOCK
from twinmatch.nodes.topics import LATCHED, Following, wanted
from twinmatch.parameters.declared import Setting
from twinmatch.sessions import SessionError
from twinmatch.sessions.messages import schema_of
from twinmatch.showing.foxglove.layout import APPLIED, IMAGE, OUTSIDE, TOPICS, layout, write_layout
from twinmatch.showing.foxglove.server import GraphServer, StreamTime
from twinmatch.showing.serving import ServingError, place_settings, warn_if_open
from twinmatch_msgs.msg import PlantDescription

POLL = 0.2
"""Seconds between checks for new topics."""
TICK = 0.05
"""Seconds between updates of the viewers' time."""
LEFT_OUT = ("parameter_events",)


class Foxglove(TwinmatchNode):
    """Shows the graph of its namespace to viewers; publishes only its health.

    It keeps running when the graph ends, and serves the next one.
    """

    NAME = "foxglove"
    PARAMETERS: ClassVar = (
        *place_settings(8765),
        Setting("layout", "", "File for the layout of the graph's plant; empty: none is written."),
    )

    _serving = False

    def open(self) -> None:
        """Start the server, and watch for topics."""
        address = self.values["address"]
        self._server = GraphServer("twinmatch", address, self.values["port"])
        self._serving = True
        self._time = StreamTime()
        self._following = Following(self, raw=True)
        self._types: dict[str, str] = {}
        self._unknown: set[str] = set()
        rig = self.get_namespace().rstrip("/")
        for name, kind in ({f"{rig}/{name}": kind for name, kind in TOPICS.items()} | OUTSIDE).items():
            self._advertise(name, kind)
        self._has_clock = self._to_repeat = False
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._described: Description | None = None
        self._laid_out: tuple[Description, frozenset[str]] | None = None
        if self.values["layout"]:
            self.create_subscription(PlantDescription, "plant/description", self._on_description, LATCHED)
        self.create_subscription(ClockMessage, "/clock", self._on_clock, CLOCK)
        self.create_timer(POLL, self._find_topics, clock=steady)
        self.create_timer(TICK, self._send_time, clock=steady)
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
        if self._serving:
            self._server.close()
        return True

    def _find_topics(self) -> None:
        self._has_clock = self.count_publishers("/clock") > 0
        for name, _ in self.get_topic_names_and_types():
            if name not in self._unknown and wanted(name, self.get_namespace(), OUTSIDE, LEFT_OUT):
                self._subscribe(name)
        self._lay_out()

    def _on_description(self, message: PlantDescription) -> None:
        self._described = description_from(message)

    def _lay_out(self) -> None:
        """Write the layout once the plant is described, and again if its description or topics change."""
        if self._described is None:
            return
        rig = self.get_namespace().rstrip("/")
        present = frozenset(topic for topic in (APPLIED, IMAGE) if f"{rig}/{topic}" in self._following)
        if self._laid_out == (self._described, present):
            return
        self._laid_out = self._described, present
        path = Path(self.values["layout"])
        try:
            write_layout(path, layout(self._described, present, rig))
        except ServingError as error:
            self.health.flag("layout", Level.WARN, str(error))
            return
        print(f"layout for {self._described.title}: {path}", flush=True)

    def _subscribe(self, name: str) -> None:
        """Subscribe to a topic, or again if its publishers now offer another QoS."""
        publishers = self._following.news(name)
        if publishers is None:
            return
        if not publishers:
            self._server.forget(name)
            return
        kind = publishers[0].topic_type
        if name in self._following or self._advertise(name, kind):
            self._following.subscribe(name, kind, publishers, partial(self._on_message, name))

    def _advertise(self, name: str, kind: str) -> bool:
        """Advertise a topic to viewers, once; returns whether it can be shown."""
        before = self._types.setdefault(name, kind)
        try:
            if before != kind:
                raise SessionError(f"its type changed from {before} to {kind}; restart twinmatch foxglove")
            if not self._server.offers(name):
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
            self._reset_if(self._time.on_sample(time.monotonic(), clock=self._has_clock))
        self._server.send(name, data, self._time.now)

    def _reset_if(self, changed: bool) -> None:
        if changed:
            self._server.reset(self._time.now)
            self._to_repeat = True

    def _send_time(self) -> None:
        self._server.send_time(self._time.now)
        if self._to_repeat:
            self._to_repeat = False
            self._server.repeat(self._time.now)
