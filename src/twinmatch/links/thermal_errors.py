"""Errors of the link to a thermal camera's server, one class per remedy.

ThermalLinkError              the stream is not usable right now; the client reconnects automatically
├── ThermalConnectError       no server at the address: is it running, is the port right
├── ThermalStallError         connected, but no complete frame in time: camera or network hangs
├── ThermalEndError           the server closed the connection, perhaps in the middle of a frame
├── ThermalOrderError         the frames of one server are out of order: two programs on one port
└── FrameError                the bytes are not a valid frame
    ├── FrameSyntaxError      not CBOR, or not one map
    ├── FrameTooLongError     longer than the limit
    ├── FrameVersionError     a frame of another version of the format
    ├── FrameFieldError       a field is missing, surplus, of the wrong type or out of range
    └── FrameChecksumError    the bytes were corrupted in transit
"""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = [
    "FrameChecksumError",
    "FrameError",
    "FrameFieldError",
    "FrameSyntaxError",
    "FrameTooLongError",
    "FrameVersionError",
    "ThermalConnectError",
    "ThermalEndError",
    "ThermalLinkError",
    "ThermalOrderError",
    "ThermalStallError",
]


class ThermalLinkError(TwinmatchError):
    """The thermal stream is not usable."""


class ThermalConnectError(ThermalLinkError):
    """No connection to the camera server could be made."""


class ThermalStallError(ThermalLinkError):
    """The connection is up, but no complete frame arrived in time."""


class ThermalEndError(ThermalLinkError):
    """The server closed the connection."""


class ThermalOrderError(ThermalLinkError):
    """A frame's sequence number is not above that of the frame before."""


class FrameError(ThermalLinkError):
    """Bytes are not a thermal frame."""


class FrameSyntaxError(FrameError):
    """Bytes are not one CBOR map."""


class FrameTooLongError(FrameError):
    """A frame is longer than the limit."""


class FrameVersionError(FrameError):
    """A frame has another version of the wire format."""


class FrameFieldError(FrameError):
    """A field is missing, surplus, of the wrong type or out of range."""


class FrameChecksumError(FrameError):
    """The checksum does not match the bytes before it."""
