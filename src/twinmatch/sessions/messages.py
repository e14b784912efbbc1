"""Topics and messages of a session: definitions and quality of service; their bytes are those of `cdr`.

The types of plant topics are in `definitions`, so that no ROS installation is needed. The texts are those of
the installed `.msg` files, including comments, because readers show them; the hashes are the RIHS01 type
hashes that ROS 2 computes from the fields. Tests compare both with an installed ROS 2, and the hashes with an
independent implementation. Header, Time, Temperature and Float64 are definitions of the ROS 2 common
interfaces (Apache-2.0).

Samples recorded with the first definition of `LoopSample` are converted: playing or judging a session needs
nothing else. Recorded verdicts and matches are decoded with the definitions in the file where they are
compared.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, lru_cache
from pathlib import Path
from typing import Final, NamedTuple

from twinmatch.sessions.files import SessionError
from twinmatch.signals import Sample


def fields_of(schema: str) -> list[str]:
    """The field lines of a schema's first type, without comments and extra spaces."""
    first_type = schema.split("=" * 80, maxsplit=1)[0]
    lines = (
        " ".join(line.split("#", 1)[0].split()) for line in first_type.splitlines()
    )
    return [line for line in lines if line]


SCALAR_SAMPLE = [
    "std_msgs/Header header",
    "uint64 index",
    "float64 reference",
    "float64 temperature",
    "float64 pwm",
]
"""Fields of the first definition of LoopSample; sessions recorded with it are converted when read."""


def schema_of(kind: str, environment: Mapping[str, str] = os.environ) -> str:
    """The `ros2msg` schema of an installed type: its definition, then those of its nested types.

    Args:
        kind: full name, `package/msg/Type`.
        environment: its AMENT_PREFIX_PATH lists where packages are; Python's prefix is searched last.

    Raises:
        SessionError: the type or a nested one is not installed, or `kind` is not such a name.
    """
    prefixes = [
        *filter(None, environment.get("AMENT_PREFIX_PATH", "").split(":")),
        sys.prefix,
    ]

    def text(part: str) -> str:
        match = re.fullmatch(r"(\w+)/msg/(\w+)", part)
        if match is None:
            raise SessionError(
                f"session: {part!r} is not a message type; give package/msg/Type"
            )
        for prefix in prefixes:
            path = Path(prefix) / "share" / match[1] / "msg" / f"{match[2]}.msg"
            if path.is_file():
                return path.read_text("utf-8")
        looked = ", ".join(prefixes)
        raise SessionError(
            f"session: the definition of {part} is not installed; looked in {looked}"
        )

    return _schema(kind, text)


def _schema(kind: str, text: Callable[[str], str]) -> str:
    """The definition, then those of the nested types in breadth-first order, each after its name."""
    texts = {kind: text(kind)}
    todo = [kind]
    while todo:
        owner = todo.pop(0)
        for part in _parts(owner, texts[owner]):
            if part not in texts:
                texts[part] = text(part)
                todo.append(part)
    blocks = [texts.pop(kind)]
    for name, nested in texts.items():
        package, _, short = name.split("/")
        blocks.append(f"{'=' * 80}\nMSG: {package}/{short}\n{nested}")
    return "\n".join(blocks)


def _parts(owner: str, text: str) -> Iterator[str]:
    for field in fields_of(text):
        kind = re.split(r"[\[<\s]", field)[0]
        package, *_, name = (
            kind.split("/") if "/" in kind else (owner.split("/", 1)[0], kind)
        )
        if name[0].isupper():  # not a number or text, perhaps a constant
            yield f"{package}/msg/{name}"


_FOREVER = {"sec": 9223372036, "nsec": 854775807}
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
            "deadline": dict(_FOREVER),
            "lifespan": dict(_FOREVER),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(_FOREVER),
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
    encoding: str = "cdr"
    """Of its messages; ours are `cdr`."""
    language: str = "ros2msg"
    """Of its definition; empty if the file has none."""


class Message(NamedTuple):
    """A stored message: serialised, with the two times of MCAP."""

    topic: Topic
    log_time: int
    """Time of recording, ns since the epoch of its clock."""
    publish_time: int
    """Time of publication, ns; equal to `log_time` if not known."""
    data: bytes
    """The CDR bytes, including the encapsulation header."""
    is_sound: bool = True
    """False if it was read from a damaged part of its file, and its content may be wrong."""


def topic_of(name: str, kind: str, type_hash: str, qos: Qos) -> Topic:
    """A topic of one of the types in `definitions`."""
    folder = Path(__file__).with_name("definitions")
    schema = _schema(
        kind,
        lambda part: (folder / f"{part.rpartition('/')[2]}.msg").read_text("utf-8"),
    )
    return Topic(name, kind, schema, type_hash, qos)


SAMPLE = topic_of(
    "/plant/sample",
    "twinmatch_msgs/msg/LoopSample",
    "RIHS01_29aed8c2ef7b66a60fb7166b3918f2b3b9606a5b297e5fd222d2c049b2df8cb0",
    Qos("reliable", "volatile", 100),
)
TEMPERATURE_READING = topic_of(
    "/plant/temperature",
    "sensor_msgs/msg/Temperature",
    "RIHS01_72514a14126ab9f8a9abec974c78e5610a367b59db5da355ff1fb982d5bad4b8",
    Qos("best_effort", "volatile", 5),
)
# The reference is published when it changes, so it is latched for late subscribers.
REFERENCE = topic_of(
    "/plant/reference",
    "std_msgs/msg/Float64",
    "RIHS01_705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a",
    Qos("reliable", "transient_local", 1),
)

PLANT_TOPICS = (SAMPLE, TEMPERATURE_READING, REFERENCE)
"""Topics that follow from the samples alone; the *applied* PWM does not."""


def plant_topics(
    output_units: Sequence[str], *, has_reference: bool
) -> tuple[Topic, ...]:
    """Topics of a plant whose outputs have these units; only °C is a temperature, only a loop has set-points.

    Of several outputs there are samples only.
    """
    unit = output_units[0] if len(output_units) == 1 else None
    wanted = (True, unit == "°C", has_reference and unit is not None)
    return tuple(
        topic
        for topic, is_wanted in zip(PLANT_TOPICS, wanted, strict=True)
        if is_wanted
    )


def topics_of(samples: Sequence[Sample]) -> tuple[Topic, ...]:
    """All plant topics, if the samples are those of a single loop; otherwise the samples alone."""
    return PLANT_TOPICS if samples[0].shape[:3] == (1, 1, 1) else (SAMPLE,)


@lru_cache(maxsize=64)
def current_topic(topic: Topic) -> Topic:
    """The topic with the current definition of its messages; unchanged if it is current or unknown."""
    if topic.type == SAMPLE.type and fields_of(topic.schema) == SCALAR_SAMPLE:
        return SAMPLE._replace(name=topic.name, qos=topic.qos)
    return topic


_KINDS: Final = {
    "/twin/match": ("Match", Qos(depth=1000)),
    "/twin/model_score": ("ModelScore", Qos(depth=1000)),
    "/plant/description": (
        "PlantDescription",
        Qos(durability="transient_local", depth=1),
    ),
}


@cache
def topic_named(name: str) -> Topic:
    """The topic of this name with its definition; one of `/twin/match`, `/twin/model_score` and
    `/plant/description`."""
    kind, qos = _KINDS[name]
    return topic_of(name, f"twinmatch_msgs/msg/{kind}", "", qos)
