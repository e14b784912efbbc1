"""Thermal frames: an image in temperature counts, and the camera's state while taking it.

A camera yields an `Exposure`; a `ThermalFrame` is an exposure that a server has numbered. This module and the
codec import nothing but numpy and cbor2, because the program on the Raspberry Pi uses them too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from enum import IntEnum, IntFlag

import numpy as np
from numpy.typing import NDArray

from twinmatch.links.thermal_errors import FrameFieldError

__all__ = [
    "BOOT_ID_LENGTH",
    "DEFAULT_PORT",
    "LEPTON_SHAPE",
    "MAX_SIDE",
    "CountArray",
    "Exposure",
    "FlatField",
    "FrameFlags",
    "ThermalFrame",
]

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
        if not (isinstance(resolution, float) and math.isfinite(resolution) and 0 < resolution <= 1):
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
        Exposure.__post_init__(self)  # super() without arguments does not find its class under slots
        _check_integer("sequence", self.sequence, 2**63)
        if not isinstance(self.boot_id, bytes) or len(self.boot_id) != BOOT_ID_LENGTH:
            msg = f"thermal frame: boot_id is {self.boot_id!r}; give {BOOT_ID_LENGTH} bytes"
            raise FrameFieldError(msg)


def _check_integer(name: str, value: object, limit: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < limit:
        msg = f"thermal frame: {name} is {value!r}; give an integer from 0 to {limit - 1}"
        raise FrameFieldError(msg)


def _check_image(image: object) -> None:
    if not isinstance(image, np.ndarray) or image.dtype != np.uint16 or image.ndim != 2:
        found = (
            f"{image.dtype} of shape {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
        )
        msg = f"thermal frame: the image is {found}; give uint16 counts in rows and columns"
        raise FrameFieldError(msg)
    if not all(1 <= side <= MAX_SIDE for side in image.shape):
        msg = f"thermal frame: the image has shape {image.shape}; each side must be 1 to {MAX_SIDE}"
        raise FrameFieldError(msg)
