"""CDR, the bytes of a message: written by the definition of its type, and read.

A CDR message begins with four bytes that name the encoding (here little-endian CDR, 00 01 00 00), and
every field is aligned to its own size, **counted from after those four bytes**. The position of the
fields after a string therefore depends on the string's length. A sequence is its length and its elements.

`encode` and `decoded` do this for every type by its definition. The messages of which a session has one for
each sample have code of their own, which is ten times as fast: an hour of samples is decoded in milliseconds.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import redirect_stderr
from functools import cache, lru_cache
from io import StringIO
from itertools import accumulate
from typing import TYPE_CHECKING, Any, Final

from twinmatch.sessions.files import SessionError
from twinmatch.sessions.messages import (
    PLANT_TOPICS,
    REFERENCE,
    SAMPLE,
    TEMPERATURE_READING,
    Message,
    Topic,
    current_topic,
    fields_of,
)
from twinmatch.signals import NANOSECONDS, Sample, incomplete

if TYPE_CHECKING:
    from twinmatch.record import Tree


def encode(topic: Topic, tree: Tree, stamp: int | None = None) -> bytes:
    """Encode a record of `twinmatch.record`; `stamp` (ns) is that of the sample behind it, if it has one."""
    encoder, numbers = _encoder(topic)
    whole = dict(tree)
    for name in [name for name in tree if name.endswith("_name")]:
        # a word, beside its number
        whole[name.removesuffix("_name")] = numbers[tree[name].upper()]
    if stamp is not None:
        seconds, nanoseconds = divmod(stamp, NANOSECONDS)
        whole["header"] = {
            "stamp": {"sec": seconds, "nanosec": nanoseconds},
            "frame_id": "",
        }
    return encoder(whole)


@cache
def _encoder(topic: Topic) -> tuple[Callable[[Any], bytes], Mapping[str, int]]:
    """Encodes messages of a topic, and the numbers of its words."""
    from mcap_ros2._dynamic import serialize_dynamic  # noqa: PLC0415

    matches = map(_CONSTANT.fullmatch, fields_of(topic.schema))
    numbers = {match[1]: int(match[2]) for match in matches if match}
    return serialize_dynamic(topic.type, topic.schema)[topic.type], numbers


_CONSTANT: Final = re.compile(r"uint8 ([A-Z_]+) ?= ?(\d+)")


def plant_messages(
    samples: Iterable[Sample], topics: Collection[Topic] = PLANT_TOPICS
) -> Iterator[Message]:
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
            yield Message(
                TEMPERATURE_READING,
                stamp,
                stamp,
                encode_temperature(stamp, sample.output),
            )
        yield Message(SAMPLE, stamp, stamp, encode_sample(sample))


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
    return message._replace(
        topic=topic, data=encode_sample(sample, old.header.frame_id)
    )


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
    from mcap.records import Schema  # noqa: PLC0415
    from mcap_ros2.decoder import DecoderFactory  # noqa: PLC0415

    schema = Schema(
        id=1, name=topic.type, encoding="ros2msg", data=topic.schema.encode()
    )
    with redirect_stderr(StringIO()):
        # the library prints a damaged definition before it raises
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
        raise SessionError(
            f"session: the stamp {stamp} ns is outside 1970 to 2038, the range of ROS time"
        )
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


def encode_temperature(
    stamp: int, temperature: float, variance: float = 0.0, frame: str = FRAME
) -> bytes:
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
        index, *_ = values = struct.unpack_from(
            order + _arrays(lengths), data, position
        )
    except struct.error:
        msg = f"session: a LoopSample of {len(data)} bytes is too short for its fields"
        raise SessionError(msg) from None
    if missing := incomplete(index, lengths[:3]):
        raise SessionError(f"session: {missing}")
    _, outputs, inputs, behind = accumulate(
        (length + 1 for length in lengths[:3]), initial=2
    )
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
        position = (
            4 + (position + 7) // 8 * 8 + 8 * lengths[-1]
            if lengths[-1]
            else position + 4
        )
    return tuple(lengths)
