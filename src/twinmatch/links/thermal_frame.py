"""Thermal frames, and their wire format: one CBOR map per frame, frame after frame (RFC 8742).

A camera yields an `Exposure`; a `ThermalFrame` is an exposure that a server has numbered. The image is a
typed array of RFC 8746 (tag 40 with the shape around tag 69, little-endian uint16). CBOR has no checksum, so
the last entry of the map is one: `crc` is the CRC-32 (as in zlib) of all bytes of the item before its own
four, big-endian. docs/rig/camera.md specifies the format, with an example. This module imports nothing but
numpy and cbor2, because the program on the Raspberry Pi uses it too.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import IntEnum, IntFlag
from typing import IO, Final, cast

import cbor2
import numpy as np
from numpy.typing import NDArray

from twinmatch.errors import TwinmatchError


class ThermalLinkError(TwinmatchError):
    """The thermal stream is not usable right now; the client reconnects automatically."""


class ThermalConnectError(ThermalLinkError):
    """No server at the address: is it running, is the port right?"""


class ThermalStallError(ThermalLinkError):
    """Connected, but no complete frame in time: camera or network hangs."""


class ThermalEndError(ThermalLinkError):
    """The server closed the connection, perhaps in the middle of a frame."""


class ThermalOrderError(ThermalLinkError):
    """The frames of one server are out of order: two programs on one port?"""


class FrameError(ThermalLinkError):
    """The bytes are not a valid frame."""


class FrameSyntaxError(FrameError):
    """Not CBOR, or not one map."""


class FrameTooLongError(FrameError):
    """Longer than the limit."""


class FrameVersionError(FrameError):
    """A frame of another version of the format."""


class FrameFieldError(FrameError):
    """A field is missing, surplus, of the wrong type or out of range."""


class FrameChecksumError(FrameError):
    """The bytes were corrupted in transit."""


CountArray = NDArray[np.uint16]

DEFAULT_PORT = 5580
"""TCP port of a camera server."""

LEPTON_SHAPE = (60, 80)
"""Rows and columns of a FLIR Lepton 2.5."""

MAX_SIDE = 1024
"""Most rows or columns an image may have."""

BOOT_ID_LENGTH = 16
"""Length of the identifier of a server's run, bytes."""


class FlatField(IntEnum):
    """State of the flat-field correction, numbered as in the Lepton's telemetry."""

    NEVER = 0
    IMMINENT = 1
    RUNNING = 2
    COMPLETE = 3


class FrameFlags(IntFlag):
    """Further properties of a frame."""

    NONE = 0
    FLAT_FIELD_DESIRED = 1
    """The camera requests a flat-field correction."""
    GAIN_CONTROL = 2
    """Automatic gain control is on: counts are a picture, not temperatures."""
    SHUTTER_LOCKED = 4
    """Too hot or too cold for the shutter; no flat-field correction is possible."""
    OVERHEATING = 8
    """The camera will switch itself off within ten seconds."""
    NOT_RADIOMETRIC = 16
    """Counts are not linear in temperature."""
    EMULATED = 32
    """The image is from an emulator."""
    RECORDED = 64
    """Played from a file."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Exposure:
    """One image and the camera's state while it was taken.

    Raises:
        FrameFieldError: a field is of the wrong type or out of range.
    """

    image: CountArray
    """Counts, shape (rows, columns); made read-only. Absolute temperature is count times resolution."""
    stamp: int
    """Time when the image was complete, on the monotonic clock of the camera's computer, ns.

    Comparable only between frames of one boot id."""
    resolution: float
    """Kelvin per count."""
    frame_counter: int
    """The camera's own count of images, 32 bits; a frame with the same count is a repetition."""
    flat_field: FlatField | None = None
    """State of the flat-field correction; None if the camera does not report it."""
    flat_field_age: int | None = None
    """Time since the last flat-field correction, ms; None if unknown or never made."""
    sensor_temperature: int | None = None
    """Temperature of the focal plane array, hundredths of a kelvin; None if unknown."""
    flags: FrameFlags = FrameFlags.NONE

    def __post_init__(self) -> None:
        _check_image(self.image)
        self.image.flags.writeable = False
        _check_integer("stamp", self.stamp, 2**63)
        _check_integer("frame_counter", self.frame_counter, 2**32)
        _check_integer("flags", self.flags, 2**16)
        if self.flat_field_age is not None:
            _check_integer("flat_field_age", self.flat_field_age, 2**32)
        if self.sensor_temperature is not None:
            _check_integer("sensor_temperature", self.sensor_temperature, 2**16)
        if self.flat_field is not None and not isinstance(self.flat_field, FlatField):
            msg = f"thermal frame: flat_field is {self.flat_field!r}; give a FlatField or None"
            raise FrameFieldError(msg)
        resolution = self.resolution
        if not (
            isinstance(resolution, float)
            and math.isfinite(resolution)
            and 0 < resolution <= 1
        ):
            msg = f"thermal frame: resolution is {resolution!r}; it must lie in (0, 1] K per count"
            raise FrameFieldError(msg)

    @property
    def frozen(self) -> bool:
        """Whether the shutter was closed, so that the image is repeated or meaningless."""
        return self.flat_field is FlatField.RUNNING

    @property
    def radiometric(self) -> bool:
        """Whether counts are temperatures."""
        return not self.flags & (FrameFlags.NOT_RADIOMETRIC | FrameFlags.GAIN_CONTROL)

    def numbered(self, sequence: int, boot_id: bytes) -> ThermalFrame:
        """This exposure as frame `sequence` of the server run `boot_id`."""
        values = {field.name: getattr(self, field.name) for field in fields(Exposure)}
        return ThermalFrame(sequence=sequence, boot_id=boot_id, **values)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ThermalFrame(Exposure):
    """An exposure with its place in the stream of one run of a server.

    Raises:
        FrameFieldError: a field is of the wrong type or out of range.
    """

    sequence: int
    """Count of frames since the server started."""
    boot_id: bytes
    """Identifies the run of the server; a new one means that all counters and clocks restarted."""

    def __post_init__(self) -> None:
        # super() without arguments does not find its class under slots
        Exposure.__post_init__(self)
        _check_integer("sequence", self.sequence, 2**63)
        if not isinstance(self.boot_id, bytes) or len(self.boot_id) != BOOT_ID_LENGTH:
            raise FrameFieldError(
                f"thermal frame: boot_id is {self.boot_id!r}; give {BOOT_ID_LENGTH} bytes"
            )


def _check_integer(name: str, value: object, limit: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < limit:
        msg = f"thermal frame: {name} is {value!r:.40}; give an integer from 0 to {limit - 1}"
        raise FrameFieldError(msg)


def _check_image(image: object) -> None:
    if not isinstance(image, np.ndarray):
        raise FrameFieldError(
            f"thermal frame: the image is a {type(image).__name__}; give an array"
        )
    if image.dtype != np.uint16 or image.ndim != 2:
        layout = f"{image.dtype} of shape {image.shape}"
        raise FrameFieldError(
            f"thermal frame: the image is {layout}; give uint16 counts in rows and columns"
        )
    if not all(1 <= side <= MAX_SIDE for side in image.shape):
        msg = f"thermal frame: the image has shape {image.shape}; each side must be 1 to {MAX_SIDE}"
        raise FrameFieldError(msg)


WIRE_VERSION: Final = 1

MAX_FRAME_BYTES: Final = 65_536
"""Longest frame accepted; a Lepton 2.5 needs 9.7 kB, a Lepton 3.5 needs 38.5 kB."""


class _ArrayTag(IntEnum):
    """Tags of CBOR for arrays (RFC 8746)."""

    TWO_DIMENSIONS = 40
    """A shape, and the values row by row."""
    UINT16_LITTLE_ENDIAN = 69


_CRC_LENGTH: Final = 4
_CRC_KEY: Final = b"\x63crc\x44"
_FIELDS: Final = {
    "seq": "sequence",
    "t_ns": "stamp",
    "boot_id": "boot_id",
    "res_k": "resolution",
    "img": "image",
    "ffc": "flat_field",
    "ffc_age_ms": "flat_field_age",
    "fpa_ck": "sensor_temperature",
    "frame_counter": "frame_counter",
    "flags": "flags",
}
"""The fields of a frame by their keys in the map, in its order; `v` precedes and `crc` follows them."""
_KEYS: Final = ("v", *_FIELDS, "crc")


def encode_frame(frame: ThermalFrame) -> bytes:
    """The frame as one CBOR item."""
    pixels = frame.image.astype("<u2", copy=False).tobytes()
    values = {key: getattr(frame, name) for key, name in _FIELDS.items()}
    typed_pixels = cbor2.CBORTag(_ArrayTag.UINT16_LITTLE_ENDIAN, pixels)
    values["img"] = cbor2.CBORTag(
        _ArrayTag.TWO_DIMENSIONS, [list(frame.image.shape), typed_pixels]
    )
    values["ffc"] = None if frame.flat_field is None else int(frame.flat_field)
    values["flags"] = int(frame.flags)
    item: bytes = cbor2.dumps({"v": WIRE_VERSION, **values, "crc": bytes(_CRC_LENGTH)})
    body = item[:-_CRC_LENGTH]
    return body + zlib.crc32(body).to_bytes(_CRC_LENGTH, "big")


def read_frame(read: Callable[[int], bytes]) -> ThermalFrame:
    """Read exactly one frame from a stream, and not a byte past the longest frame.

    `read` returns exactly the requested number of bytes, or raises; its exceptions are passed on.

    Raises:
        FrameError: one of its subclasses. The stream is then out of step and must be closed.
    """
    tap = _Tap(read)
    try:
        value = cbor2.load(cast(IO[bytes], tap))
    except Exception as error:  # a CBOR library may raise anything on hostile bytes
        # Some releases of cbor2 recurse per level of nesting, and the limit may strike within our read.
        if tap.failure is not None and not isinstance(tap.failure, RecursionError):
            raise tap.failure from None
        raise FrameSyntaxError(
            f"thermal frame: not CBOR after {len(tap.taken)} bytes ({error})"
        ) from error
    return _frame(value, bytes(tap.taken))


class _Tap:
    """A file for the CBOR decoder that keeps the bytes read and stops at the limit.

    It reports that it cannot seek, because only then does cbor2 not read ahead into the next frame.
    """

    def __init__(self, read: Callable[[int], bytes]) -> None:
        self._read = read
        self.taken = bytearray()
        self.failure: Exception | None = None

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return False

    def read(self, count: int) -> bytes:
        try:
            if len(self.taken) + count > MAX_FRAME_BYTES:
                msg = f"thermal frame: longer than the {MAX_FRAME_BYTES} bytes that a frame may have"
                raise FrameTooLongError(msg)
            piece = self._read(count)
        except Exception as error:
            self.failure = error
            raise
        self.taken += piece
        return piece


def _frame(value: object, raw: bytes) -> ThermalFrame:
    if not isinstance(value, dict):
        raise FrameSyntaxError(
            f"thermal frame: a CBOR {type(value).__name__} instead of a map"
        )
    version = value.get("v")
    if type(version) is int and version != WIRE_VERSION:
        msg = f"thermal frame: format version {version}; this program reads version {WIRE_VERSION}"
        raise FrameVersionError(msg)
    if tuple(value) != _KEYS:
        msg = f"thermal frame: the map's keys are {list(value)!r:.200}; they must be {', '.join(_KEYS)}"
        raise FrameFieldError(msg)
    _check_crc(value["crc"], raw)
    values = {name: value[key] for key, name in _FIELDS.items()}
    if value["ffc"] is not None:
        _check_integer("ffc", value["ffc"], len(FlatField))
        values["flat_field"] = FlatField(value["ffc"])
    _check_integer("flags", value["flags"], 2**16)
    values |= {"image": _image(value["img"]), "flags": FrameFlags(value["flags"])}
    return ThermalFrame(**values)


def _check_crc(crc: object, raw: bytes) -> None:
    body = raw[:-_CRC_LENGTH]
    tail = raw[-_CRC_LENGTH:]
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
        case cbor2.CBORTag(
            tag=_ArrayTag.TWO_DIMENSIONS,
            value=[
                [int() as rows, int() as columns],
                cbor2.CBORTag(
                    tag=_ArrayTag.UINT16_LITTLE_ENDIAN, value=bytes() as pixels
                ),
            ],
        ) if rows >= 0 and columns >= 0:
            pass
        case _:
            msg = "thermal frame: img is not a two-dimensional RFC 8746 array of little-endian uint16"
            raise FrameFieldError(msg)
    if len(pixels) != 2 * rows * columns:
        msg = f"thermal frame: img has {len(pixels)} bytes for {rows} by {columns} pixels of two bytes"
        raise FrameFieldError(msg)
    # the exposure checks its sides
    return np.frombuffer(pixels, dtype="<u2").reshape(rows, columns)
