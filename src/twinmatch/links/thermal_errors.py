"""What can go wrong between a thermal camera's server and us, one class per remedy.

ThermalLinkError              the stream is not usable right now; the client reconnects by itself
├── ThermalConnectError       nobody answers at the address: is the server running, is the port right
├── ThermalStallError         connected, but no whole frame in time: camera or network hangs
├── ThermalEndError           the server closed the connection, perhaps in the middle of a frame
├── ThermalOrderError         the frames of one server go backwards: two programs on one port
└── FrameError                the bytes are no frame of ours
    ├── FrameSyntaxError      not CBOR, or not one map
    ├── FrameTooLongError     longer than the agreed cap
    ├── FrameVersionError     a frame of another version of the format
    ├── FrameFieldError       a field is missing, surplus, of the wrong type or out of range
    └── FrameChecksumError    the bytes changed on their way
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
    """The connection stands, but no whole frame came in time."""


class ThermalEndError(ThermalLinkError):
    """The server closed the connection."""


class ThermalOrderError(ThermalLinkError):
    """A frame's sequence number does not follow the one before."""


class FrameError(ThermalLinkError):
    """Bytes that are no thermal frame."""


class FrameSyntaxError(FrameError):
    """Bytes that are not one CBOR map."""


class FrameTooLongError(FrameError):
    """A frame longer than the cap on a message."""


class FrameVersionError(FrameError):
    """A frame of another version of the wire format."""


class FrameFieldError(FrameError):
    """A field that is missing, surplus, of the wrong type or out of range."""


class FrameChecksumError(FrameError):
    """The checksum does not fit the bytes in front of it."""
