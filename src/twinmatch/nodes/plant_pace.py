"""Reports the progress of this process to the virtual rig, so that plant time does not run ahead of it.

When plant time runs many times faster than the wall clock, a delay of a tenth of a second on a busy machine
is seconds on the plant. This node runs in the controller's process: it receives /clock through the same
executor, so when it acknowledges a time, everything before it has been processed.
"""

from __future__ import annotations

from typing import Any, ClassVar

from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from twinmatch.emulation.virtual_rig_clock import ClockClient, parse_address
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.parameters.declared import Parameter

__all__ = ["PlantPace"]

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class PlantPace(TwinmatchNode):
    """Answers every /clock with a line to the rig; without an address it does nothing."""

    NAME = "plant_pace"
    PARAMETERS: ClassVar = (Parameter("address", "", "HOST:PORT of the virtual rig's clock; empty: none."),)

    _client: ClockClient | None = None

    def open(self) -> None:
        """Connect and subscribe.

        Raises:
            ClockError: the address is invalid.
        """
        if not self.values["address"]:
            return
        self._client = ClockClient(parse_address(self.values["address"]), lambda _: None)
        self._client.start()
        self.create_subscription(Clock, "/clock", self._on_clock, NEWEST)

    @property
    def failure(self) -> Exception | None:
        """The error that ended the client's thread, if any."""
        return None if self._client is None else self._client.failure

    def close(self) -> bool:
        """Close the connection."""
        return self._client is None or self._client.close()

    def _on_clock(self, message: Any) -> None:
        if self._client is not None:
            self._client.done(message.clock.sec * 1_000_000_000 + message.clock.nanosec)
