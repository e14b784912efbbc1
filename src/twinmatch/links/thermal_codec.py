"""The wire format of thermal frames: one CBOR map per frame, frame after frame (RFC 8742).

The image is a typed array of RFC 8746 (tag 40 with the shape around tag 69, little-endian uint16).
CBOR has no checksum, so the last entry of the map is one: `crc` is the CRC-32 (as in zlib) of all bytes of
the item before its own four, big-endian. docs/rig/camera.md specifies the format, with an example.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import IO, Final, cast

import cbor2
import numpy as np

from twinmatch.links.thermal_errors import (
    FrameChecksumError,
    FrameFieldError,
    FrameSyntaxError,
    FrameTooLongError,
    FrameVersionError,
)
from twinmatch.links.thermal_frame import MAX_SIDE, CountArray, FlatField, FrameFlags, ThermalFrame

__all__ = ["MAX_FRAME_BYTES", "WIRE_VERSION", "decode_frame", "encode_frame", "read_frame"]

WIRE_VERSION: Final = 1

MAX_FRAME_BYTES: Final = 65_536
"""Longest frame accepted; a Lepton 2.5 needs 9.7 kB, a Lepton 3.5 needs 38.5 kB."""

_ARRAY_TAG: Final = 40
_UINT16_LE_TAG: Final = 69
_CRC_LENGTH: Final = 4
_CRC_KEY: Final = b"\x63crc\x44"
_KEYS: Final = (
    "v",
    "seq",
    "t_ns",
    "boot_id",
    "res_k",
    "img",
    "ffc",
    "ffc_age_ms",
    "fpa_ck",
    "frame_counter",
    "flags",
    "crc",
)


def encode_frame(frame: ThermalFrame) -> bytes:
    """The frame as one CBOR item."""
    rows, columns = frame.image.shape
    pixels = frame.image.astype("<u2", copy=False).tobytes()
    item: bytes = cbor2.dumps(
        {
            "v": WIRE_VERSION,
            "seq": frame.sequence,
            "t_ns": frame.stamp,
            "boot_id": frame.boot_id,
            "res_k": frame.resolution,
            "img": cbor2.CBORTag(_ARRAY_TAG, [[rows, columns], cbor2.CBORTag(_UINT16_LE_TAG, pixels)]),
            "ffc": None if frame.flat_field is None else int(frame.flat_field),
            "ffc_age_ms": frame.flat_field_age,
            "fpa_ck": frame.sensor_temperature,
            "frame_counter": frame.frame_counter,
            "flags": int(frame.flags),
            "crc": bytes(_CRC_LENGTH),
        }
    )
    body = item[:-_CRC_LENGTH]
    return body + zlib.crc32(body).to_bytes(_CRC_LENGTH, "big")


def decode_frame(data: bytes) -> ThermalFrame:
    """The frame in `data`, which must be one CBOR item and nothing after it.

    Raises:
        FrameError: one of its subclasses, see `twinmatch.links.thermal_errors`.
    """
    position = 0

    def read(count: int) -> bytes:
        nonlocal position
        piece = data[position : position + count]
        position += len(piece)
        if len(piece) < count:
            msg = f"thermal frame: the bytes end at {len(data)}, in the middle of the frame"
            raise FrameSyntaxError(msg)
        return piece

    frame = read_frame(read, limit=max(MAX_FRAME_BYTES, len(data)))
    if position != len(data):
        msg = f"thermal frame: {len(data) - position} bytes follow the end of the frame"
        raise FrameSyntaxError(msg)
    return frame


def read_frame(read: Callable[[int], bytes], limit: int = MAX_FRAME_BYTES) -> ThermalFrame:
    """Read exactly one frame from a stream.

    Args:
        read: returns exactly the requested number of bytes, or raises; its exceptions are passed on.
        limit: most bytes of a frame. The stream is not read past it.

    Raises:
        FrameError: one of its subclasses. The stream is then out of step and must be closed.
    """
    tap = _Tap(read, limit)
    try:
        value = cbor2.load(cast(IO[bytes], tap))
    except Exception as error:  # a CBOR library may raise anything on hostile bytes
        # Some releases of cbor2 recurse per level of nesting, and the limit may strike within our read.
        if tap.failure is not None and not isinstance(tap.failure, RecursionError):
            raise tap.failure from None
        msg = f"thermal frame: not CBOR after {len(tap.taken)} bytes ({error})"
        raise FrameSyntaxError(msg) from error
    return _frame(value, bytes(tap.taken))


class _Tap:
    """A file for the CBOR decoder that keeps the bytes read and stops at the limit.

    It reports that it cannot seek, because only then does cbor2 not read ahead into the next frame.
    """

    def __init__(self, read: Callable[[int], bytes], limit: int) -> None:
        self._read = read
        self._limit = limit
        self.taken = bytearray()
        self.failure: Exception | None = None

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return False

    def read(self, count: int) -> bytes:
        try:
            if len(self.taken) + count > self._limit:
                msg = f"thermal frame: longer than the {self._limit} bytes that a frame may have"
                raise FrameTooLongError(msg)
            piece = self._read(count)
        except Exception as error:
            self.failure = error
            raise
        self.taken += piece
        return piece


def _frame(value: object, raw: bytes) -> ThermalFrame:
    if not isinstance(value, dict):
        msg = f"thermal frame: a CBOR {type(value).__name__} instead of a map"
        raise FrameSyntaxError(msg)
    version = value.get("v")
    if type(version) is int and version != WIRE_VERSION:
        msg = f"thermal frame: format version {version}; this program reads version {WIRE_VERSION}"
        raise FrameVersionError(msg)
    if tuple(value) != _KEYS:
        msg = f"thermal frame: the map's keys are {list(value)!r:.200}; they must be {', '.join(_KEYS)}"
        raise FrameFieldError(msg)
    _check_crc(value["crc"], raw)
    flat_field = value["ffc"]
    if flat_field is not None and not (type(flat_field) is int and 0 <= flat_field <= max(FlatField)):
        msg = f"thermal frame: ffc is {flat_field!r:.40}; it must be 0 to {int(max(FlatField))} or null"
        raise FrameFieldError(msg)
    flags = value["flags"]
    if type(flags) is not int or not 0 <= flags < 2**16:
        msg = f"thermal frame: flags is {flags!r:.40}; it must be an integer below 65536"
        raise FrameFieldError(msg)
    return ThermalFrame(
        sequence=value["seq"],
        boot_id=value["boot_id"],
        stamp=value["t_ns"],
        resolution=value["res_k"],
        image=_image(value["img"]),
        flat_field=None if flat_field is None else FlatField(flat_field),
        flat_field_age=value["ffc_age_ms"],
        sensor_temperature=value["fpa_ck"],
        frame_counter=value["frame_counter"],
        flags=FrameFlags(flags),
    )


def _check_crc(crc: object, raw: bytes) -> None:
    body, tail = raw[:-_CRC_LENGTH], raw[-_CRC_LENGTH:]
    if crc != tail or not body.endswith(_CRC_KEY):
        msg = f"thermal frame: crc is {crc!r:.40}; it must be the frame's last {_CRC_LENGTH} bytes"
        raise FrameFieldError(msg)
    computed = zlib.crc32(body).to_bytes(_CRC_LENGTH, "big")
    if computed != tail:
        msg = f"thermal frame: checksum {tail.hex()} but {computed.hex()} computed; the bytes were corrupted"
        raise FrameChecksumError(msg)


def _image(value: object) -> CountArray:
    """The pixels of an RFC 8746 array: tag 40 around a shape and a tag 69."""
    match value:
        case cbor2.CBORTag(tag=40, value=[[int() as rows, int() as columns], cbor2.CBORTag(tag=69) as array]):
            pixels = array.value
        case _:
            msg = "thermal frame: img is not a two-dimensional RFC 8746 array of little-endian uint16"
            raise FrameFieldError(msg)
    if not isinstance(pixels, bytes) or not (0 < rows <= MAX_SIDE and 0 < columns <= MAX_SIDE):
        msg = f"thermal frame: img has shape {rows} by {columns}; each side must be 1 to {MAX_SIDE}"
        raise FrameFieldError(msg)
    if len(pixels) != 2 * rows * columns:
        msg = f"thermal frame: img has {len(pixels)} bytes for {rows} by {columns} pixels of two bytes"
        raise FrameFieldError(msg)
    return np.frombuffer(pixels, dtype="<u2").reshape(rows, columns)
