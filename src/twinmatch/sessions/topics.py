"""Topics of a session: name, message type, quality of service; and the plant topics of its samples."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from typing import NamedTuple

from twinmatch.sessions.cdr import encode_float64, encode_sample, encode_temperature
from twinmatch.sessions.definitions import FLOAT64, LOOP_SAMPLE, TEMPERATURE, MessageType
from twinmatch.signals import Sample

__all__ = ["PLANT_TOPICS", "Message", "Qos", "Topic", "plant_messages", "plant_topics"]

FOREVER = {"sec": 9223372036, "nsec": 854775807}
"""An infinite duration in ROS 2."""


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
    """Its definition and those of nested types as one `ros2msg` text."""
    type_hash: str
    """RIHS01 hash of the type; empty where it is not known."""
    qos: Qos = Qos()
    """Profile offered by the publisher."""

    @classmethod
    def of(cls, name: str, message: MessageType, qos: Qos) -> Topic:
        """A topic of one of the types in `definitions`."""
        return cls(name, message.name, message.schema, message.type_hash, qos)


class Message(NamedTuple):
    """A stored message: serialised, with the two times of MCAP."""

    topic: Topic
    log_time: int
    """Time of recording, ns since the epoch of its clock."""
    publish_time: int
    """Time of publication, ns; equal to `log_time` if not known."""
    data: bytes
    """The CDR bytes, including the encapsulation header."""


SAMPLE = Topic.of("/plant/sample", LOOP_SAMPLE, Qos("reliable", "volatile", 100))
TEMPERATURE_READING = Topic.of("/plant/temperature", TEMPERATURE, Qos("best_effort", "volatile", 5))
# The reference is published when it changes, so it is latched for late subscribers.
REFERENCE = Topic.of("/plant/reference", FLOAT64, Qos("reliable", "transient_local", 1))

PLANT_TOPICS = (SAMPLE, TEMPERATURE_READING, REFERENCE)
"""Topics that follow from the samples alone; the *applied* PWM does not."""


def plant_topics(output_unit: str, *, has_reference: bool) -> tuple[Topic, ...]:
    """Topics of a plant whose output has this unit; only °C is a temperature, only a loop has a reference."""
    left_out = ([] if output_unit == "°C" else [TEMPERATURE_READING]) + ([] if has_reference else [REFERENCE])
    return tuple(topic for topic in PLANT_TOPICS if topic not in left_out)


def plant_messages(samples: Iterable[Sample], topics: Collection[Topic] = PLANT_TOPICS) -> Iterator[Message]:
    """The messages that the plant publishes for these samples, in the order of a live loop.

    The reference comes first (only when it changed), then the temperature, then the sample.

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
