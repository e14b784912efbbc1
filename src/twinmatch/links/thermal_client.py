"""The client of a thermal stream: one thread that connects, reconnects and keeps the newest frame.

Only `wait` blocks its caller. Each frame replaces the one before, read or not, so a slow consumer sees gaps
but never old images. Any error in the stream ends the connection; the thread then pauses, longer each time,
and reconnects. `region` gives the temperatures of a rectangle of a frame.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from types import MappingProxyType
from typing import Final

import numpy as np

from twinmatch.links import Background
from twinmatch.links.thermal_frame import (
    DEFAULT_PORT,
    CountArray,
    Exposure,
    ThermalConnectError,
    ThermalEndError,
    ThermalFrame,
    ThermalLinkError,
    ThermalOrderError,
    ThermalStallError,
    read_frame,
)
from twinmatch.settings import setting
from twinmatch.signals import KELVIN, BoolArray, FloatArray


class StampMapper:
    """Maps stamps of a server's clock to ours; one object per run of a server.

    The difference between our time of receipt and a stamp of the server's monotonic clock is the offset of
    the clocks plus the transit time of the frame. Transit times are never negative, so the smallest recent
    difference is the offset plus the shortest transit time: converted stamps are late by that, about a
    millisecond on a quiet network, and never early. The memory is short, so that a relative clock drift of
    50 ppm costs milliseconds at most.
    """

    MEMORY: Final = 30_000_000_000
    """Length of the intervals for which the smallest difference is kept, ns; the last two intervals count."""

    def __init__(self, memory: int = MEMORY) -> None:
        self._memory = memory
        self._stretch_start: int | None = None
        self._current: int | None = None
        self._previous: int | None = None

    def map(self, stamp: int, received: int) -> int:
        """Time on our clock, ns, at which a frame stamped `stamp` and received at `received` was taken."""
        if (
            self._stretch_start is None
            or received - self._stretch_start >= self._memory
        ):
            self._stretch_start = received
            self._previous = self._current
            self._current = None
        difference = received - stamp
        self._current = (
            difference if self._current is None else min(self._current, difference)
        )
        return stamp + min(
            self._current, self._current if self._previous is None else self._previous
        )


@dataclass(frozen=True, slots=True)
class ClientSettings:
    """Times, s."""

    stall_timeout: float = setting(
        2.0, "A connection without a frame for this long is dropped.", "s", 0.1, 60.0
    )
    first_wait: float = 0.1
    """Pause before the first retry; doubles with each further attempt that yields no frame."""
    longest_wait: float = 5.0


_DEFAULTS = ClientSettings()


def back_off(failures: int, settings: ClientSettings = _DEFAULTS) -> float:
    """Time to wait after this many failures in a row (1, 2, …), s: doubling, capped, without jitter."""
    return float(
        min(settings.first_wait * 2.0 ** min(failures - 1, 60), settings.longest_wait)
    )


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


@dataclass(frozen=True)
class CountEnds:
    """Counts at the ends of their range: they stand for no temperature."""

    lowest: int = 0
    highest: int = 65535

    def include(self, counts: CountArray) -> BoolArray:
        """Whether each count is one of them."""
        return np.asarray((counts == self.lowest) | (counts == self.highest))


COUNT_ENDS: Final = CountEnds()


class RegionError(ThermalLinkError):
    """A rectangle is outside the frame, empty, or without a valid pixel."""


@dataclass(frozen=True, slots=True)
class Region:
    """A rectangle of pixels.

    Raises:
        RegionError: it starts before the first pixel, or is empty.
    """

    row: int
    """First row, 0 at the top."""
    column: int
    """First column, 0 at the left."""
    rows: int
    columns: int

    def __post_init__(self) -> None:
        if self.row < 0 or self.column < 0 or self.rows < 1 or self.columns < 1:
            raise RegionError(
                f"region: {self.rows} by {self.columns} pixels from row {self.row}, column {self.column}; "
                "it must start at 0 or later and contain a pixel"
            )


@dataclass(frozen=True, slots=True)
class RegionStatistics:
    """Temperatures over a rectangle."""

    mean: float
    """°C."""
    variance: float
    """Mean square deviation from the mean, °C²; 0 for a single pixel."""
    minimum: float
    """°C."""
    maximum: float
    """°C."""
    pixels: int
    """Number of pixels with a valid count."""

    @property
    def spread(self) -> float:
        """Hottest minus coldest pixel, °C: the non-uniformity of the plate."""
        return self.maximum - self.minimum


def celsius(exposure: Exposure) -> FloatArray:
    """The image in °C, shape (rows, columns); NaN where the count is at either end of its range.

    Raises:
        RegionError: the camera does not deliver temperatures (see `Exposure.radiometric`).
    """
    if not exposure.radiometric:
        msg = "region: the camera's counts are not temperatures; switch TLinear on and gain control off"
        raise RegionError(msg)
    counts = exposure.image
    degrees = counts * exposure.resolution - KELVIN
    degrees[COUNT_ENDS.include(counts)] = np.nan
    return np.asarray(degrees, dtype=np.float64)


def region(exposure: Exposure, roi: Region | None = None) -> RegionStatistics:
    """Statistics of the temperatures in a rectangle, or in the whole image.

    Raises:
        RegionError: the rectangle leaves the image, no pixel in it is valid, or the camera's counts
            are not temperatures.
    """
    degrees = celsius(exposure)
    if roi is not None:
        rows, columns = degrees.shape
        if roi.row + roi.rows > rows or roi.column + roi.columns > columns:
            raise RegionError(
                f"region: {roi.rows} by {roi.columns} pixels from row {roi.row}, column {roi.column} "
                f"leave the image of {rows} by {columns}"
            )
        degrees = degrees[
            roi.row : roi.row + roi.rows, roi.column : roi.column + roi.columns
        ]
    valid = degrees[np.isfinite(degrees)]
    if not valid.size:
        raise RegionError(
            "region: every pixel is outside the camera's range; point the camera at the plate"
        )
    return RegionStatistics(
        mean=float(valid.mean()),
        variance=float(valid.var()),
        minimum=float(valid.min()),
        maximum=float(valid.max()),
        pixels=int(valid.size),
    )


class ThermalClient(Background):
    """Receives the stream of one camera server in its own thread.

    Use as a context manager, or call `start` and `close`. `newest` and `status` never block.
    """

    _CONNECT_TIMEOUT: Final = 2.0

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = DEFAULT_PORT,
        settings: ClientSettings = _DEFAULTS,
    ) -> None:
        super().__init__(f"thermal {host}:{port}", self._keep_receiving, 3.0)
        self.address = (host, port)
        self.settings = settings
        self._arrived = threading.Condition()
        self._socket: socket.socket | None = None
        self._newest: Received | None = None
        self._news: Received | None = None
        self._status = LinkStatus()
        self._errors: Counter[str] = Counter()
        self._mapper = StampMapper()

    def close(self, timeout: float | None = None) -> bool:
        """End the connection and the thread; returns whether it ended within the timeout (s)."""
        self.ending.set()
        if (connection := self._socket) is not None:
            with contextlib.suppress(OSError):  # already closed, as intended
                connection.shutdown(socket.SHUT_RDWR)
        with self._arrived:
            self._arrived.notify_all()
        return super().close(timeout)

    def __enter__(self) -> ThermalClient:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def status(self) -> LinkStatus:
        """State and counters as of now."""
        return self._status

    def newest(self) -> Received | None:
        """The last frame received, or None before the first. Check its `age` before using it."""
        return self._newest

    def news(self) -> Received | None:
        """The last frame with a new image, or None before the first. Its `age` grows until the next one."""
        return self._news

    def wait(self, after: int = 0, timeout: float = 1.0) -> Received | None:
        """The newest frame once its number exceeds `after`; None if there is none within `timeout` (s)."""

        def ready() -> bool:
            newest = self._newest
            return self.ending.is_set() or (
                newest is not None and newest.number > after
            )

        with self._arrived:
            self._arrived.wait_for(ready, timeout)
        newest = self._newest
        return newest if newest is not None and newest.number > after else None

    def _keep_receiving(self) -> None:
        try:
            while not self.ending.is_set():
                try:
                    self._stream()
                except ThermalLinkError as error:
                    self._note(error)
                self.ending.wait(back_off(max(1, self._status.failures), self.settings))
        finally:
            self._status = replace(self._status, state=LinkState.CLOSED)

    def _note(self, error: ThermalLinkError) -> None:
        if self.ending.is_set():
            return
        self._errors[type(error).__name__] += 1
        self._status = replace(
            self._status,
            state=LinkState.WAITING,
            failures=self._status.failures + 1,
            errors=MappingProxyType(dict(self._errors)),
            last_error=error,
        )

    def _stream(self) -> None:
        """Run one connection until it ends, which is always with an error."""
        self._status = replace(self._status, state=LinkState.CONNECTING)
        host, port = self.address
        try:
            connection = socket.create_connection(self.address, self._CONNECT_TIMEOUT)
        except OSError as error:
            msg = f"thermal camera at {host}:{port}: {error}; is the camera server running there?"
            raise ThermalConnectError(msg) from error
        with connection:
            self._socket = connection
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _Reader.BUFFER)
            self._status = replace(
                self._status,
                state=LinkState.STREAMING,
                connections=self._status.connections + 1,
            )
            reader = _Reader(
                connection,
                f"thermal camera at {host}:{port}",
                self.settings.stall_timeout,
            )
            previous: ThermalFrame | None = None
            while not self.ending.is_set():
                reader.begin()
                frame = read_frame(reader.read)
                self._accept(frame, previous)
                previous = frame
        self._socket = None

    def _accept(self, frame: ThermalFrame, previous: ThermalFrame | None) -> None:
        received_at = time.monotonic_ns()
        if previous is not None:
            if frame.boot_id != previous.boot_id:
                raise ThermalOrderError(
                    "thermal stream: the boot id changed within one connection"
                )
            if frame.sequence <= previous.sequence:
                msg = f"thermal stream: frame {frame.sequence} follows frame {previous.sequence}"
                raise ThermalOrderError(msg)
        last = None if self._newest is None else self._newest.frame
        restarted = last is not None and last.boot_id != frame.boot_id
        if restarted:
            self._mapper = StampMapper()
        fresh = last is None or restarted or frame.frame_counter != last.frame_counter
        news = fresh and not frame.frozen
        status = self._status
        image_time = self._mapper.map(frame.stamp, received_at)
        received = Received(frame, status.frames + 1, received_at, image_time, news)
        self._status = replace(
            status,
            frames=status.frames + 1,
            frozen=status.frozen + (not news),
            missed=status.missed
            + (0 if previous is None else frame.sequence - previous.sequence - 1),
            restarts=status.restarts + restarted,
            failures=0,
        )
        with self._arrived:
            self._newest = received
            self._news = received if news else self._news
            self._arrived.notify_all()


class _Reader:
    """Exact reads from a socket, with one deadline for a whole frame."""

    BUFFER: Final = 32_768
    """Most bytes that are received at once."""

    def __init__(self, connection: socket.socket, name: str, timeout: float) -> None:
        self._connection = connection
        self._name = name
        self._timeout = timeout
        self._deadline = 0.0
        self._buffer = b""
        self._position = 0

    def begin(self) -> None:
        self._deadline = time.monotonic() + self._timeout

    def read(self, count: int) -> bytes:
        while len(self._buffer) - self._position < count:
            self._buffer = self._buffer[self._position :] + self._receive()
            self._position = 0
        piece = self._buffer[self._position : self._position + count]
        self._position += count
        return piece

    def _receive(self) -> bytes:
        remaining = self._deadline - time.monotonic()
        try:
            if remaining <= 0:
                raise TimeoutError
            self._connection.settimeout(remaining)
            piece = self._connection.recv(self.BUFFER)
        except TimeoutError as error:
            msg = f"{self._name}: no complete frame within {self._timeout} s; check camera and network"
            raise ThermalStallError(msg) from error
        except OSError as error:
            raise ThermalEndError(f"{self._name}: connection lost ({error})") from error
        if not piece:
            raise ThermalEndError(f"{self._name}: the server closed the connection")
        return piece
