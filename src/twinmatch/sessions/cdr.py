"""The CDR encoding of the few messages that sessions are written with and read from.

A message begins with four bytes that name the encoding (here little-endian CDR, 00 01 00 00), and
every field is aligned to its own size **counted from behind those four bytes**. So the place of the
fields after a string depends on the string's length. Written out for these three types it is a few
lines, and an hour of samples decodes in milliseconds without a library to load first.
"""

from __future__ import annotations

import struct
from functools import lru_cache

from twinmatch.sessions.errors import SessionError
from twinmatch.signals import Sample

__all__ = ["FRAME", "decode_sample", "encode_float64", "encode_sample", "encode_temperature"]

FRAME = "plate"
"""`header.frame_id` of everything measured at the plate."""

NANOSECONDS = 1_000_000_000

_LITTLE = b"\x00\x01\x00\x00"
_ORDER = {b"\x00\x00": ">", b"\x00\x01": "<"}
_HEADER = {order: struct.Struct(order + "iII") for order in "<>"}
_BODY = {order: struct.Struct(order + "Qddd") for order in "<>"}
_FLOAT64 = struct.Struct("<4sd")


@lru_cache(maxsize=16)
def _stamped(frame: bytes, fields: str) -> struct.Struct:
    """Layout of a header with this frame (its closing NUL included) and 8-byte fields behind it."""
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
    """`twinmatch_msgs/msg/LoopSample` of a sample.

    Raises:
        SessionError: the stamp is negative or past 2038.
    """
    head = _header(sample.stamp, frame)
    return _stamped(head[-1], "Qddd").pack(*head, sample.index, sample.reference, sample.output, sample.input)


def encode_temperature(stamp: int, temperature: float, variance: float = 0.0, frame: str = FRAME) -> bytes:
    """`sensor_msgs/msg/Temperature`, °C and °C²; a variance of 0 means unknown.

    Raises:
        SessionError: the stamp is negative or past 2038.
    """
    head = _header(stamp, frame)
    return _stamped(head[-1], "dd").pack(*head, temperature, variance)


def encode_float64(value: float) -> bytes:
    """`std_msgs/msg/Float64`."""
    return _FLOAT64.pack(_LITTLE, value)


def decode_sample(data: bytes) -> Sample:
    """The sample in a `twinmatch_msgs/msg/LoopSample`, in either byte order.

    Raises:
        SessionError: another encoding than CDR, or too few bytes.
    """
    order = _ORDER.get(bytes(data[:2]))
    if order is None:
        msg = f"session: a LoopSample is encoded as {bytes(data[:4]).hex(' ')!r}; only plain CDR is read"
        raise SessionError(msg)
    try:
        seconds, nanoseconds, length = _HEADER[order].unpack_from(data, 4)
        body = 4 + (12 + length + 7) // 8 * 8
        index, reference, temperature, pwm = _BODY[order].unpack_from(data, body)
    except struct.error:
        msg = f"session: a LoopSample of {len(data)} bytes is too short for its fields"
        raise SessionError(msg) from None
    return Sample(index, seconds * NANOSECONDS + nanoseconds, reference, temperature, pwm)
