"""Topics and messages of a session: definitions, quality of service, the CDR bytes of our own types.

The types of plant topics are in `definitions`, so that no ROS installation is needed. The texts are those of
the installed `.msg` files, including comments, because readers show them; the hashes are the RIHS01 type
hashes that ROS 2 computes from the fields. Tests compare both with an installed ROS 2, and the hashes with an
independent implementation. Header, Time, Temperature and Float64 are definitions of the ROS 2 common
interfaces (Apache-2.0).

A CDR message begins with four bytes that name the encoding (here little-endian CDR, 00 01 00 00), and
every field is aligned to its own size, **counted from after those four bytes**. The position of the
fields after a string therefore depends on the string's length. A sequence is its length and its elements.
The code for these few types is short, needs no library, and decodes an hour of samples in milliseconds.

Samples recorded with the first definition of `LoopSample` are converted: playing or judging a session needs
nothing else. Recorded verdicts and matches are decoded with the definitions in the file where they are
compared.
"""

from __future__ import annotations

import os
import re
import struct
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import redirect_stderr
from functools import lru_cache
from io import StringIO
from itertools import accumulate
from pathlib import Path
from typing import Any, NamedTuple

from twinmatch.sessions.files import SessionError
from twinmatch.signals import NANOSECONDS, Sample, incomplete


def fields_of(schema: str) -> list[str]:
    """The field lines of a schema's first type, without comments and extra spaces."""
    first_type = schema.split("=" * 80, maxsplit=1)[0]
    lines = (" ".join(line.split("#", 1)[0].split()) for line in first_type.splitlines())
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
    prefixes = [*filter(None, environment.get("AMENT_PREFIX_PATH", "").split(":")), sys.prefix]

    def text(part: str) -> str:
        match = re.fullmatch(r"(\w+)/msg/(\w+)", part)
        if match is None:
            raise SessionError(f"session: {part!r} is not a message type; give package/msg/Type")
        for prefix in prefixes:
            path = Path(prefix) / "share" / match[1] / "msg" / f"{match[2]}.msg"
            if path.is_file():
                return path.read_text("utf-8")
        looked = ", ".join(prefixes)
        raise SessionError(f"session: the definition of {part} is not installed; looked in {looked}")

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
        package, *_, name = kind.split("/") if "/" in kind else (owner.split("/", 1)[0], kind)
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
    schema = _schema(kind, lambda part: (folder / f"{part.rpartition('/')[2]}.msg").read_text("utf-8"))
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


def plant_topics(output_units: Sequence[str], *, has_reference: bool) -> tuple[Topic, ...]:
    """Topics of a plant whose outputs have these units; only °C is a temperature, only a loop has set-points.

    Of several outputs there are samples only.
    """
    unit = output_units[0] if len(output_units) == 1 else None
    wanted = (True, unit == "°C", has_reference and unit is not None)
    return tuple(topic for topic, is_wanted in zip(PLANT_TOPICS, wanted, strict=True) if is_wanted)


def topics_of(samples: Sequence[Sample]) -> tuple[Topic, ...]:
    """All plant topics, if the samples are those of a single loop; otherwise the samples alone."""
    return PLANT_TOPICS if samples[0].shape[:3] == (1, 1, 1) else (SAMPLE,)


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
        stamp = sample.stamp
        if REFERENCE in topics and sample.reference != reference:
            reference = sample.reference
            yield Message(REFERENCE, stamp, stamp, encode_float64(reference))
        if TEMPERATURE_READING in topics:
            yield Message(TEMPERATURE_READING, stamp, stamp, encode_temperature(stamp, sample.output))
        yield Message(SAMPLE, stamp, stamp, encode_sample(sample))


@lru_cache(maxsize=64)
def current_topic(topic: Topic) -> Topic:
    """The topic with the current definition of its messages; unchanged if it is current or unknown."""
    if topic.type == SAMPLE.type and fields_of(topic.schema) == SCALAR_SAMPLE:
        return SAMPLE._replace(name=topic.name, qos=topic.qos)
    return topic


def current(message: Message) -> Message:
    """Convert a message to the current definition.

    Raises:
        SessionError: the message does not match the definition in its file.
    """
    topic = current_topic(message.topic)
    if topic == message.topic:
        return message
    old = decoded(message)
    stamp = old.header.stamp.sec * NANOSECONDS + old.header.stamp.nanosec
    sample = Sample(old.index, stamp, old.reference, old.temperature, old.pwm)
    return message._replace(topic=topic, data=encode_sample(sample, old.header.frame_id))


def decoded(message: Message) -> Any:
    """The fields of a message, by the definition in its file.

    Raises:
        SessionError: the message does not match it.
    """
    name = message.topic.type.rsplit("/", 1)[-1]
    try:
        return _decoder(message.topic)(message.data)
    except Exception as error:  # the library raises many kinds for damaged bytes
        msg = f"session: a {name} of {len(message.data)} bytes does not match its definition ({error})"
        raise SessionError(msg) from error


@lru_cache(maxsize=16)
def _decoder(topic: Topic) -> Callable[[bytes], Any]:
    """Decodes messages by the definition in their file."""
    from mcap.records import Schema  # noqa: PLC0415 - only old sessions need it
    from mcap_ros2.decoder import DecoderFactory  # noqa: PLC0415

    schema = Schema(id=1, name=topic.type, encoding="ros2msg", data=topic.schema.encode())
    with redirect_stderr(StringIO()):  # the library prints a damaged definition before it raises
        decoder: Callable[[bytes], Any] = DecoderFactory().decoder_for("cdr", schema)
    return decoder


FRAME = "plate"
"""`header.frame_id` of everything measured at the plate."""


_LITTLE = b"\x00\x01\x00\x00"
_ORDER = {b"\x00\x00": ">", b"\x00\x01": "<"}
_HEADER = {order: struct.Struct(order + "iII") for order in "<>"}
_LENGTH = {order: struct.Struct(order + "I") for order in "<>"}
_FLOAT64 = struct.Struct("<4sd")


@lru_cache(maxsize=16)
def _stamped(frame: bytes, fields: str) -> struct.Struct:
    """Layout of a header with this frame (including its final NUL), followed by 8-byte fields."""
    padding = -(12 + len(frame)) % 8
    return struct.Struct(f"<4siII{len(frame)}s{padding}x{fields}")


def _header(stamp: int, frame: str) -> tuple[bytes, int, int, int, bytes]:
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    if not 0 <= seconds < 2**31:
        raise SessionError(f"session: the stamp {stamp} ns is outside 1970 to 2038, the range of ROS time")
    raw = frame.encode() + b"\0"
    return _LITTLE, seconds, nanoseconds, len(raw), raw


def encode_sample(sample: Sample, frame: str = FRAME) -> bytes:
    """Encode a sample as `twinmatch_msgs/msg/LoopSample`.

    Raises:
        SessionError: the stamp is negative or past 2038.
    """
    head = _header(sample.stamp, frame)
    r = sample.references
    y = sample.outputs
    u = sample.inputs
    d = sample.disturbances
    signals = len(r), *r, len(y), *y, len(u), *u, len(d), *d
    return _stamped(head[-1], _arrays(sample.shape)).pack(*head, sample.index, *signals)


@lru_cache(maxsize=16)
def _arrays(lengths: tuple[int, ...]) -> str:
    """Layout of an index and of sequences of float64 with these lengths."""
    fields = "Q"
    whole = True
    for length in lengths:
        if not length:
            fields += "I"
            whole = not whole
        else:
            fields += f"I4x{length}d" if whole else f"I{length}d"
            whole = True
    return fields


def encode_temperature(stamp: int, temperature: float, variance: float = 0.0, frame: str = FRAME) -> bytes:
    """Encode a `sensor_msgs/msg/Temperature`, °C and °C²; a variance of 0 means unknown.

    Raises:
        SessionError: the stamp is negative or past 2038.
    """
    head = _header(stamp, frame)
    return _stamped(head[-1], "dd").pack(*head, temperature, variance)


def encode_float64(value: float) -> bytes:
    """Encode a `std_msgs/msg/Float64`."""
    return _FLOAT64.pack(_LITTLE, value)


def decode_sample(data: bytes) -> Sample:
    """Decode the sample of a `twinmatch_msgs/msg/LoopSample`, in either byte order.

    Raises:
        SessionError: another encoding than CDR, too few bytes, or no reference, output or input.
    """
    order = _ORDER.get(bytes(data[:2]))
    if order is None:
        msg = f"session: a LoopSample is encoded as {bytes(data[:4]).hex(' ')!r}; only plain CDR is read"
        raise SessionError(msg)
    try:
        seconds, nanoseconds, length = _HEADER[order].unpack_from(data, 4)
        position = 4 + (12 + length + 7) // 8 * 8
        lengths = _lengths(order, data, position + 8)
        index, *_ = values = struct.unpack_from(order + _arrays(lengths), data, position)
    except struct.error:
        msg = f"session: a LoopSample of {len(data)} bytes is too short for its fields"
        raise SessionError(msg) from None
    if missing := incomplete(index, lengths[:3]):
        raise SessionError(f"session: {missing}")
    _, outputs, inputs, behind = accumulate((length + 1 for length in lengths[:3]), initial=2)
    return Sample(
        index,
        seconds * NANOSECONDS + nanoseconds,
        values[2 : outputs - 1],
        values[outputs : inputs - 1],
        values[inputs : behind - 1],
        values[behind:],
    )


def _lengths(order: str, data: bytes, position: int) -> tuple[int, ...]:
    """Lengths of the four sequences of float64; `position` is that of the first."""
    lengths = []
    for _ in range(4):
        lengths.append(_LENGTH[order].unpack_from(data, position)[0])
        position = 4 + (position + 7) // 8 * 8 + 8 * lengths[-1] if lengths[-1] else position + 4
    return tuple(lengths)
