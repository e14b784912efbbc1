"""The CDR encoding of the few message types that sessions are written with and read from.

A message begins with four bytes that name the encoding (here little-endian CDR, 00 01 00 00), and
every field is aligned to its own size, **counted from after those four bytes**. The position of the
fields after a string therefore depends on the string's length. A sequence is its length and its elements.
The code for these few types is short, needs no library, and decodes an hour of samples in milliseconds.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import lru_cache

from twinmatch.sessions.errors import SessionError
from twinmatch.signals import Sample, not_one_loop

__all__ = [
    "FRAME",
    "decode_sample",
    "decode_scalar_sample",
    "encode_float64",
    "encode_sample",
    "encode_temperature",
]

FRAME = "plate"
"""`header.frame_id` of everything measured at the plate."""

NANOSECONDS = 1_000_000_000

_LITTLE = b"\x00\x01\x00\x00"
_ORDER = {b"\x00\x00": ">", b"\x00\x01": "<"}
_HEADER = {order: struct.Struct(order + "iII") for order in "<>"}
_SCALARS = {order: struct.Struct(order + "Qddd") for order in "<>"}
_ARRAYS = {order: struct.Struct(order + "QI4xdI4xdI4xdI") for order in "<>"}
"""One reference, one output, one input, and the number of disturbances that follow."""
_INDEX = {order: struct.Struct(order + "Q") for order in "<>"}
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
        msg = f"session: the stamp {stamp} ns is outside 1970 to 2038, the range of ROS time"
        raise SessionError(msg)
    raw = frame.encode() + b"\0"
    return _LITTLE, seconds, nanoseconds, len(raw), raw


def encode_sample(sample: Sample, frame: str = FRAME) -> bytes:
    """Encode a sample as `twinmatch_msgs/msg/LoopSample`.

    Raises:
        SessionError: the stamp is negative or past 2038.
    """
    head = _header(sample.stamp, frame)
    number = len(sample.disturbances)
    fields = "QI4xdI4xdI4xdI" + (f"4x{number}d" if number else "")
    signals = 1, sample.reference, 1, sample.output, 1, sample.input, number, *sample.disturbances
    return _stamped(head[-1], fields).pack(*head, sample.index, *signals)


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
        SessionError: another encoding than CDR, too few bytes, or not one reference, output and input.
    """
    return _decoded(data, _arrays)


def decode_scalar_sample(data: bytes) -> tuple[Sample, str]:
    """Decode a `LoopSample` of the first definition (reference, temperature and PWM as numbers): the sample,
    and the frame it was measured in.

    Raises:
        SessionError: another encoding than CDR, or too few bytes.
    """
    sample = _decoded(data, lambda order, _, at: (*_SCALARS[order].unpack_from(data, at), ()))
    (length,) = _LENGTH[_ORDER[bytes(data[:2])]].unpack_from(data, 12)
    return sample, data[16 : 16 + length - 1].decode()


_Fields = tuple[int, float, float, float, tuple[float, ...]]


def _decoded(data: bytes, body: Callable[[str, bytes, int], _Fields]) -> Sample:
    order = _ORDER.get(bytes(data[:2]))
    if order is None:
        msg = f"session: a LoopSample is encoded as {bytes(data[:4]).hex(' ')!r}; only plain CDR is read"
        raise SessionError(msg)
    try:
        seconds, nanoseconds, length = _HEADER[order].unpack_from(data, 4)
        index, reference, output, computed, disturbances = body(order, data, 4 + (12 + length + 7) // 8 * 8)
    except struct.error:
        msg = f"session: a LoopSample of {len(data)} bytes is too short for its fields"
        raise SessionError(msg) from None
    stamp = seconds * NANOSECONDS + nanoseconds
    return Sample(index, stamp, reference, output, computed, disturbances)


def _arrays(order: str, data: bytes, at: int) -> _Fields:
    layout = _ARRAYS[order]
    lengths = _lengths(order, data, at + 8)
    if lengths != [1, 1, 1]:
        (index,) = _INDEX[order].unpack_from(data, at)
        raise SessionError(f"session: {not_one_loop(index, lengths)}")
    index, _, reference, _, output, _, computed, number = layout.unpack_from(data, at)
    if not number:
        return index, reference, output, computed, ()
    disturbances = struct.unpack_from(f"{order}{number}d", data, at + layout.size + 4)
    return index, reference, output, computed, disturbances


def _lengths(order: str, data: bytes, at: int) -> list[int]:
    """Lengths of the first three sequences of float64; `at` is the position of the first."""
    found = []
    for _ in range(3):
        found.append(_LENGTH[order].unpack_from(data, at)[0])
        at = 4 + (at + 7) // 8 * 8 + 8 * found[-1] if found[-1] else at + 4
    return found
