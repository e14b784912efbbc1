"""The topics of a controller's readings and commands.

Every plant has `plant/reading` and `plant/command`. Only the Peltier rig has its own, older topics, which are
named for its temperature and its PWM.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Temperature

from twinmatch.dynamics import Plant
from twinmatch.plants import Peltier
from twinmatch_msgs.msg import PlantCommand, PlantReading, PwmCommand

__all__ = ["Take", "Wires", "wires_of"]

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""For readings, of which only the newest counts."""

Take = Callable[[Any, float, tuple[float, ...]], None]
"""Called with a reading: its stamp as a message, the output, the disturbances."""


class Wires(Protocol):
    """The two topics between a controller and the driver of its plant."""

    publisher: Any
    """Publisher of the commands."""

    def __init__(self, node: Node, take: Take) -> None:
        """Subscribe to readings and create the publisher of commands."""
        ...

    def command(self, value: float, index: int, stamp: Any) -> None:
        """Publish a command computed at sample `index`, sent at `stamp`."""
        ...


class PlantWires:
    """The topics of any plant."""

    def __init__(self, node: Node, take: Take) -> None:
        """Subscribe to readings and create the publisher of commands."""

        def on_reading(message: PlantReading) -> None:
            take(message.header.stamp, message.output, tuple(message.disturbances))

        node.create_subscription(PlantReading, "plant/reading", on_reading, NEWEST)
        self.publisher = node.create_publisher(PlantCommand, "plant/command", 10)

    def command(self, value: float, index: int, stamp: Any) -> None:
        """Publish a command computed at sample `index`, sent at `stamp`."""
        message = PlantCommand(index=index, input=value)
        message.header.stamp = stamp
        self.publisher.publish(message)


class PeltierWires:
    """The topics of the Peltier rig."""

    def __init__(self, node: Node, take: Take) -> None:
        """Subscribe to temperatures and create the publisher of commands."""

        def on_temperature(message: Temperature) -> None:
            take(message.header.stamp, message.temperature, ())

        node.create_subscription(Temperature, "plant/temperature", on_temperature, NEWEST)
        self.publisher = node.create_publisher(PwmCommand, "plant/pwm_command", 10)

    def command(self, value: float, index: int, stamp: Any) -> None:
        """Publish a command computed at sample `index`, sent at `stamp`."""
        message = PwmCommand(index=index, pwm=value)
        message.header.stamp = stamp
        self.publisher.publish(message)


def wires_of(plant: type[Plant]) -> type[Wires]:
    """The topics of a plant."""
    return PeltierWires if plant is Peltier else PlantWires
