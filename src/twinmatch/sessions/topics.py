"""Topics of a session: name, message type, quality of service, and the plant topics of a sample."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from typing import NamedTuple

from twinmatch.sessions.cdr import encode_float64, encode_sample, encode_temperature
from twinmatch.sessions.definitions import FLOAT64, LOOP_SAMPLE, TEMPERATURE, MessageType
from twinmatch.signals import Sample

__all__ = ["PLANT_TOPICS", "Message", "Qos", "Topic", "plant_messages", "plant_topics"]

FOREVER = {"sec": 9223372036, "nsec": 854775807}
"""How ROS 2 writes a duration without end."""


class Qos(NamedTuple):
    """The part of a quality-of-service profile that a player has to repeat."""

    reliability: str = "reliable"
    """`reliable` or `best_effort`."""
    durability: str = "volatile"
    """`volatile` or `transient_local`."""
    depth: int = 10
    """Messages kept for a slow reader."""

    def profile(self) -> dict[str, object]:
        """The profile as rosbag2 metadata of version 9 writes it."""
        return {
            "history": "keep_last",
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": dict(FOREVER),
            "lifespan": dict(FOREVER),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(FOREVER),
            "avoid_ros_namespace_conventions": False,
        }


class Topic(NamedTuple):
    """A topic of a session."""

    name: str
    """Full name, such as `/plant/sample`."""
    type: str
    """Message type, `package/msg/Type`."""
    schema: str
    """Its definition and those of its parts as one `ros2msg` text."""
    type_hash: str
    """RIHS01 hash of the type; empty where it is not known."""
    qos: Qos = Qos()
    """What the publisher offered."""

    @classmethod
    def of(cls, name: str, message: MessageType, qos: Qos) -> Topic:
        """A topic of one of the types in `definitions`."""
        return cls(name, message.name, message.schema, message.type_hash, qos)


class Message(NamedTuple):
    """A message as it is stored: serialised, with the two times of MCAP."""

    topic: Topic
    log_time: int
    """When it was recorded, ns since the epoch of its clock."""
    publish_time: int
    """When it was published, ns; equal to `log_time` where it is not known."""
    data: bytes
    """The CDR bytes, encapsulation header included."""


SAMPLE = Topic.of("/plant/sample", LOOP_SAMPLE, Qos("reliable", "volatile", 100))
TEMPERATURE_READING = Topic.of("/plant/temperature", TEMPERATURE, Qos("best_effort", "volatile", 5))
# The reference is published when it changes, so a late reader has to be given the last one.
REFERENCE = Topic.of("/plant/reference", FLOAT64, Qos("reliable", "transient_local", 1))

PLANT_TOPICS = (SAMPLE, TEMPERATURE_READING, REFERENCE)
"""What is known of the plant from its samples alone; the PWM that was *applied* is not."""


def plant_topics(output_unit: str, *, has_reference: bool) -> tuple[Topic, ...]:
    """Topics of a plant whose output has this unit; only °C is a temperature, only a loop has a reference."""
    left_out = ([] if output_unit == "°C" else [TEMPERATURE_READING]) + ([] if has_reference else [REFERENCE])
    return tuple(topic for topic in PLANT_TOPICS if topic not in left_out)


def plant_messages(samples: Iterable[Sample], topics: Collection[Topic] = PLANT_TOPICS) -> Iterator[Message]:
    """The messages that the plant would have published at these samples, in the order of a live loop.

    The reference comes first (only when it changed), then the temperature, then the sample made of both.

    Args:
        samples: in order.
        topics: which of `PLANT_TOPICS` are wanted.

    Raises:
        SessionError: a stamp is negative or past 2038.
    """
    reference: float | None = None
    for sample in samples:
        at = sample.stamp
        if REFERENCE in topics and sample.reference != reference:
            reference = sample.reference
            yield Message(REFERENCE, at, at, encode_float64(reference))
        if TEMPERATURE_READING in topics:
            yield Message(TEMPERATURE_READING, at, at, encode_temperature(at, sample.output))
        yield Message(SAMPLE, at, at, encode_sample(sample))
