"""Settings of a thermal client, the frames it receives, and the state of its link."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType

from twinmatch.links.thermal_codec import MAX_FRAME_BYTES
from twinmatch.links.thermal_errors import ThermalLinkError
from twinmatch.links.thermal_frame import ThermalFrame

__all__ = ["ClientSettings", "LinkState", "LinkStatus", "Received", "back_off"]


@dataclass(frozen=True, slots=True)
class ClientSettings:
    """Times in seconds, and the limit on a frame in bytes.

    Raises:
        ThermalLinkError: a value is not positive, or the longest wait is shorter than the first.
    """

    connect_timeout: float = 2.0
    stall_timeout: float = 2.0
    """Time without a complete message after which a connection is dropped."""
    first_wait: float = 0.1
    """Pause before the first retry; doubles with each further attempt that yields no frame."""
    longest_wait: float = 5.0
    frame_limit: int = MAX_FRAME_BYTES

    def __post_init__(self) -> None:
        for name in ("connect_timeout", "stall_timeout", "first_wait", "longest_wait", "frame_limit"):
            if not getattr(self, name) > 0:
                msg = f"thermal client: {name} is {getattr(self, name)}; it must be positive"
                raise ThermalLinkError(msg)
        if self.longest_wait < self.first_wait:
            msg = (
                f"thermal client: longest_wait {self.longest_wait} s is below first_wait {self.first_wait} s"
            )
            raise ThermalLinkError(msg)


def back_off(failures: int, settings: ClientSettings = ClientSettings()) -> float:
    """Time to wait after this many failures in a row (1, 2, …), s: doubling, capped, without jitter."""
    return float(min(settings.first_wait * 2.0 ** min(failures - 1, 60), settings.longest_wait))


class LinkState(Enum):
    """State of the reader thread."""

    IDLE = "idle"
    CONNECTING = "connecting"
    STREAMING = "streaming"
    WAITING = "waiting"
    """Between two attempts to connect."""
    CLOSED = "closed"


@dataclass(frozen=True, slots=True, eq=False)
class Received:
    """A frame and its times."""

    frame: ThermalFrame
    number: int
    """Count of frames this client has received, from 1, over all connections."""
    received: int
    """Our monotonic clock when the frame's last byte was read, ns."""
    received_realtime: int
    """Our wall clock at the same moment, ns since 1970."""
    taken: int
    """Our monotonic clock when the image was taken, ns: exact except for the shortest transit time."""
    news: bool
    """Whether the image is new: the shutter is open, and the camera's frame counter has advanced."""

    def age(self, now: int | None = None) -> float:
        """Time since the image was taken, s, at `now` (ns, our monotonic clock; default: the present)."""
        return ((time.monotonic_ns() if now is None else now) - self.taken) / 1e9


@dataclass(frozen=True, slots=True)
class LinkStatus:
    """The state of the link and its counters since the client was started."""

    state: LinkState = LinkState.IDLE
    connections: int = 0
    frames: int = 0
    frozen: int = 0
    """Frames without a new image."""
    missed: int = 0
    """Frames that the server did not send because this client or the network was slow."""
    restarts: int = 0
    """Changes of the server's boot id."""
    failures: int = 0
    """Consecutive attempts without a frame."""
    errors: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    """Failed attempts and lost connections, by class name of the error."""
    last_error: ThermalLinkError | None = None
