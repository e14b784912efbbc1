"""What a thermal client is told, and what it tells: settings, received frames, the state of the link."""

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
    """Times in seconds and the cap on a frame in bytes.

    Raises:
        ThermalLinkError: a value is not positive, or the longest wait is shorter than the first.
    """

    connect_timeout: float = 2.0
    stall_timeout: float = 2.0
    """A connection without a whole new message for this long is given up."""
    first_wait: float = 0.1
    """Pause before the first new attempt; doubles with each attempt in a row that yields no frame."""
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
    """Seconds to wait after this many failures in a row (1, 2, …): doubling, capped, without chance."""
    return float(min(settings.first_wait * 2.0 ** min(failures - 1, 60), settings.longest_wait))


class LinkState(Enum):
    """What the reader thread is doing."""

    IDLE = "idle"
    CONNECTING = "connecting"
    STREAMING = "streaming"
    WAITING = "waiting"
    """Between two attempts to connect."""
    CLOSED = "closed"


@dataclass(frozen=True, slots=True, eq=False)
class Received:
    """A frame and when it came."""

    frame: ThermalFrame
    number: int
    """Count of frames this client has received, from 1, over all connections."""
    received: int
    """Our monotonic clock when the frame's last byte was read, ns."""
    received_realtime: int
    """Our wall clock at the same moment, ns since 1970."""
    taken: int
    """Our monotonic clock when the image was taken, ns: exact but for the shortest transit."""
    news: bool
    """Whether the image is a new one: shutter open, and the camera's frame counter has moved."""

    def age(self, now: int | None = None) -> float:
        """Seconds since the image was taken, now or at `now` (our monotonic clock, ns)."""
        return ((time.monotonic_ns() if now is None else now) - self.taken) / 1e9


@dataclass(frozen=True, slots=True)
class LinkStatus:
    """The state of the link and its counters since the client was started."""

    state: LinkState = LinkState.IDLE
    connections: int = 0
    frames: int = 0
    frozen: int = 0
    """Frames that were no news."""
    missed: int = 0
    """Frames the server numbered but did not send us, because we or the network were slow."""
    restarts: int = 0
    """Changes of the server's boot id."""
    failures: int = 0
    """Attempts in a row that have yielded no frame."""
    errors: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    """Failed attempts and lost connections by the name of their error's class."""
    last_error: ThermalLinkError | None = None
