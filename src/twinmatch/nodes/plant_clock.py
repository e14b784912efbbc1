"""Publishes the plant time of a virtual rig on /clock."""

from __future__ import annotations

from typing import ClassVar

from rclpy.time import Time
from rosgraph_msgs.msg import Clock

from twinmatch.emulation.clock import ClockClient, Stillness, parse_address
from twinmatch.nodes.health import Level, Report
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.nodes.topics import NEWEST
from twinmatch.parameters.declared import Setting


class PlantClock(TwinmatchNode):
    """Publishes the rig's stream of plant time; when that stops, so does /clock, and an error is reported."""

    NAME = "plant_clock"
    PARAMETERS: ClassVar = (
        Setting(
            "address",
            "",
            "HOST:PORT of the clock, as the virtual rig prints it; required.",
        ),
        Setting(
            "patience",
            1.0,
            "Wall time after which a stopped clock is an error.",
            "s",
            0.1,
            60.0,
        ),
    )

    def read_parameters(self) -> None:
        """Parse the address."""
        self._stillness = Stillness(self.values["patience"])
        self._client = ClockClient(parse_address(self.values["address"]), self._on_time)

    def open(self) -> None:
        """Start to follow the rig."""
        self._publisher = self.create_publisher(Clock, "/clock", NEWEST)
        self._client.start()
        self.beside.append(self._client)
        self.report_on()

    def report(self) -> Report:
        """Whether time passes."""
        still = self._stillness.seconds()
        why = f" ({self._client.error})" if self._client.error else ""
        text = f"plant time has stood still for {still:.0f} s{why}"
        self.health.flag_if(still > 0, "still", Level.ERROR, text)
        self.health.set("set back", self._stillness.set_backs)
        return super().report()

    def _on_time(self, stamp: int) -> None:
        self._stillness.tell(stamp)
        self._publisher.publish(Clock(clock=Time(nanoseconds=stamp).to_msg()))
