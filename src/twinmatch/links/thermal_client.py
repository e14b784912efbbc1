"""The client of a thermal stream: one thread that connects, reconnects and keeps the newest frame.

Only `wait` blocks its caller. Each frame replaces the one before, read or not, so a slow consumer sees gaps
but never old images. Any error in the stream ends the connection; the thread then pauses, longer each time,
and reconnects.
"""

from __future__ import annotations

import socket
import threading
import time
from collections import Counter
from dataclasses import replace
from types import MappingProxyType

from twinmatch.links.thermal_clock import StampMapper
from twinmatch.links.thermal_codec import read_frame
from twinmatch.links.thermal_errors import (
    ThermalConnectError,
    ThermalEndError,
    ThermalLinkError,
    ThermalOrderError,
    ThermalStallError,
)
from twinmatch.links.thermal_frame import DEFAULT_PORT, ThermalFrame
from twinmatch.links.thermal_status import ClientSettings, LinkState, LinkStatus, Received, back_off

__all__ = ["ThermalClient"]

_DEFAULTS = ClientSettings()
_RECEIVE_BUFFER = 32_768


class ThermalClient:
    """Receives the stream of one camera server in its own thread.

    Use as a context manager, or call `start` and `close`. `newest` and `status` never block.
    """

    def __init__(
        self, host: str = "127.0.0.1", port: int = DEFAULT_PORT, settings: ClientSettings = _DEFAULTS
    ) -> None:
        self.address = (host, port)
        self.settings = settings
        self._stopping = threading.Event()
        self._arrived = threading.Condition()
        self._thread = threading.Thread(target=self._run, name=f"thermal {host}:{port}", daemon=True)
        self._socket: socket.socket | None = None
        self._newest: Received | None = None
        self._news: Received | None = None
        self._status = LinkStatus()
        self._errors: Counter[str] = Counter()
        self._mapper = StampMapper()

    def start(self) -> ThermalClient:
        """Start the reader thread; returns at once, even if there is no server."""
        self._thread.start()
        return self

    def close(self, timeout: float = 3.0) -> None:
        """End the connection and the thread, waiting at most `timeout` seconds for it."""
        self._stopping.set()
        connection = self._socket
        if connection is not None:
            _shut(connection)
        with self._arrived:
            self._arrived.notify_all()
        if self._thread.is_alive():
            self._thread.join(timeout)

    def __enter__(self) -> ThermalClient:
        return self.start()

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
            return self._stopping.is_set() or (newest is not None and newest.number > after)

        with self._arrived:
            self._arrived.wait_for(ready, timeout)
        newest = self._newest
        return newest if newest is not None and newest.number > after else None

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                try:
                    self._stream()
                except ThermalLinkError as error:
                    self._note(error)
                self._stopping.wait(back_off(max(1, self._status.failures), self.settings))
        finally:
            self._status = replace(self._status, state=LinkState.CLOSED)

    def _note(self, error: ThermalLinkError) -> None:
        if self._stopping.is_set():
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
            connection = socket.create_connection(self.address, timeout=self.settings.connect_timeout)
        except OSError as error:
            msg = f"thermal camera at {host}:{port}: {error}; is the camera server running there?"
            raise ThermalConnectError(msg) from error
        with connection:
            self._socket = connection
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
            self._status = replace(
                self._status, state=LinkState.STREAMING, connections=self._status.connections + 1
            )
            reader = _Reader(connection, f"thermal camera at {host}:{port}", self.settings.stall_timeout)
            previous: ThermalFrame | None = None
            while not self._stopping.is_set():
                reader.begin()
                frame = read_frame(reader.read, self.settings.frame_limit)
                self._accept(frame, previous)
                previous = frame
        self._socket = None

    def _accept(self, frame: ThermalFrame, previous: ThermalFrame | None) -> None:
        now, realtime = time.monotonic_ns(), time.time_ns()
        if previous is not None:
            if frame.boot_id != previous.boot_id:
                raise ThermalOrderError("thermal stream: the boot id changed within one connection")
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
        received = Received(frame, status.frames + 1, now, realtime, self._mapper.map(frame.stamp, now), news)
        self._status = replace(
            status,
            frames=status.frames + 1,
            frozen=status.frozen + (not news),
            missed=status.missed + (0 if previous is None else frame.sequence - previous.sequence - 1),
            restarts=status.restarts + restarted,
            failures=0,
        )
        with self._arrived:
            self._newest = received
            self._news = received if news else self._news
            self._arrived.notify_all()


class _Reader:
    """Exact reads from a socket, with one deadline for a whole frame."""

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
            piece = self._connection.recv(_RECEIVE_BUFFER)
        except TimeoutError as error:
            msg = f"{self._name}: no complete frame within {self._timeout} s; check camera and network"
            raise ThermalStallError(msg) from error
        except OSError as error:
            raise ThermalEndError(f"{self._name}: connection lost ({error})") from error
        if not piece:
            raise ThermalEndError(f"{self._name}: the server closed the connection")
        return piece


def _shut(connection: socket.socket) -> None:
    try:
        connection.shutdown(socket.SHUT_RDWR)
    except OSError:
        return  # already closed, as intended
