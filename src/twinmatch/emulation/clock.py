"""Plant time over a loopback TCP stream: one line per update, nanoseconds as text.

The rig sends plant time; a slow reader misses updates. A reader keeps only the newest. One that keeps step
answers with lines, and a plant faster than real time waits for it:

    drive NS     the process that commands the plant lets it continue up to this time
    breathe NS   the same, while it waits for an answer of the plant's board and not for the time
    follow NS    another process does
    image NS     the newest image that was taken from the camera
"""

from __future__ import annotations

import contextlib
import math
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

from twinmatch.errors import TwinmatchError
from twinmatch.links import Background

_MAX_NUMBER = 32
_PATIENCE = 30.0
"""Wall time for which a plant waits for one reader, s; then it continues without it until it speaks again."""


class ClockError(TwinmatchError):
    """An invalid address, or a stream that is not a clock."""


def parse_address(text: str) -> tuple[str, int]:
    """Host and port from `HOST:PORT`.

    Raises:
        ClockError: the text is not an address.
    """
    host, _, port = text.rpartition(":")
    if not (host and port.isascii() and port.isdecimal() and 0 < int(port) < 65536):
        raise ClockError(
            f"clock address {text!r}: give HOST:PORT, as the virtual rig prints it"
        )
    return host.strip("[]"), int(port)


@dataclass
class _ClockReader:
    """One connection, and what it lets the plant do."""

    drives: bool = False
    breathes: bool = False
    until: int | None = None
    """Time up to which the plant may go, ns; None: it does not keep step."""
    image: int | None = None
    awaited: float | None = None
    """Wall time since which the plant waits for it, s."""
    given_up: bool = False

    def take(self, line: bytes) -> None:
        kind, _, number = line.partition(b" ")
        if not (number.isdigit() and len(line) < _MAX_NUMBER):
            return
        if kind == b"image":
            self.image = int(number)
        elif kind in (b"drive", b"breathe", b"follow"):
            self.drives = kind != b"follow"
            self.breathes = kind == b"breathe"
            self.until = int(number)
        self.awaited = None
        self.given_up = False

    def awaits(self, now: float) -> bool:
        """Note that the plant waits for it; whether it is still worth it."""
        self.awaited = now if self.awaited is None else self.awaited
        self.given_up = self.given_up or now - self.awaited > _PATIENCE
        return not self.given_up


class LineServer:
    """A listening socket, without a thread, whose clients send lines: its owner's loop calls it."""

    _MAX_HEARD: Final = 256
    """Longest line, bytes; who sends a longer one is dropped."""

    def __init__(self, listener: socket.socket) -> None:
        self._listener = listener
        self._listener.setblocking(False)
        self._clients: dict[socket.socket, bytes] = {}  # with the beginning of a line

    def accept(self) -> None:
        """Accept waiting clients."""
        with contextlib.suppress(BlockingIOError):
            while True:
                client, _ = self._listener.accept()
                client.setblocking(False)
                self._clients[client] = b""

    def hear(self, seconds: float = 0.0) -> Iterator[tuple[socket.socket, bytes]]:
        """The lines that clients have sent; waits for one at most this long."""
        ready = select.select([self._listener, *self._clients], [], [], seconds)[0]
        self.accept()
        for client in ready:
            if client is self._listener:
                continue
            try:
                received = client.recv(4096)
            except OSError:
                received = b""
            *lines, unfinished = (self._clients[client] + received).split(b"\n")
            if not received or max(map(len, (*lines, unfinished))) > self._MAX_HEARD:
                self._drop(client)
                continue
            self._clients[client] = unfinished
            for line in lines:
                yield client, line

    def put(self, client: socket.socket, data: bytes) -> None:
        """Send without waiting: a client that has not read what was sent before misses it."""
        try:
            whole = client.send(data) == len(data)
        except BlockingIOError:
            return
        except OSError:
            whole = False
        if not whole:
            self._drop(client)

    def close(self) -> None:
        """Close everything."""
        for ours in (*self._clients, self._listener):
            ours.close()
        self._clients.clear()

    def _drop(self, client: socket.socket) -> None:
        self._clients.pop(client, None)
        client.close()


class ClockServer(LineServer):
    """The rig's side."""

    def __init__(self, host: str = "127.0.0.1", port: int = 0) -> None:
        super().__init__(socket.create_server((host, port), backlog=8))
        self._readers: dict[socket.socket, _ClockReader] = {}

    @property
    def address(self) -> tuple[str, int]:
        """Host and port."""
        host, port = self._listener.getsockname()[:2]
        return str(host), int(port)

    def accept(self) -> None:
        """Accept waiting clients, to whom everything is sent at once."""
        super().accept()
        for client in self._clients.keys() - self._readers.keys():
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
            self._readers[client] = _ClockReader()

    def send(self, stamp: int) -> None:
        """Send plant time, ns, to all clients."""
        self.accept()
        for client in list(self._clients):
            self.put(client, b"%d\n" % stamp)

    def listen(self, seconds: float = 0.0) -> None:
        """Take what the readers say; wait for it at most this long."""
        for client, line in self.hear(seconds):
            if client in self._readers:
                self._readers[client].take(line)

    def _drop(self, client: socket.socket) -> None:
        super()._drop(client)
        self._readers.pop(client, None)

    @property
    def driven(self) -> bool:
        """Whether a process that commands the plant keeps step."""
        return any(
            reader.drives and not reader.given_up for reader in self._readers.values()
        )

    @property
    def breathing(self) -> bool:
        """Whether the process that commands the plant waits for its board, and not for the time."""
        return any(reader.breathes for reader in self._readers.values())

    def limit(self, stamp: int) -> float:
        """The time, ns, up to which all readers that keep step let the plant go, which is at `stamp` now."""
        wall_now = time.monotonic()
        lowest = math.inf
        for reader in self._readers.values():
            if reader.until is None or (
                reader.until <= stamp and not reader.awaits(wall_now)
            ):
                continue
            lowest = min(lowest, reader.until)
        return lowest

    def lacks(self, image: int) -> bool:
        """Whether a reader that takes images has not taken the one of this time, ns, yet."""
        wall_now = time.monotonic()
        return any(
            reader.image is not None
            and reader.image < image
            and reader.awaits(wall_now)
            for reader in self._readers.values()
        )


class ClockClient(Background):
    """A reader's side: a thread that calls `tell` with the newest time, and reconnects when necessary."""

    _FIRST_PAUSE: Final = 0.1
    _MAX_PAUSE: Final = 2.0

    def __init__(self, address: tuple[str, int], tell: Callable[[int], None]) -> None:
        super().__init__("plant clock", self._keep_following, 3.0)
        self.address = address
        self.error: str = "not connected yet"
        """Why there is no connection; empty while there is one."""
        self._tell = tell
        self._connection: socket.socket | None = None
        self._newest_stamps: dict[str, int] = {}
        self._lock = threading.Lock()

    def say(self, kind: str, stamp: int) -> None:
        """Tell the rig one of the words above, and a plant time, ns; repeated after a reconnection."""
        with self._lock:
            self._newest_stamps[kind] = stamp
            self._send(kind)

    def _send(self, kind: str) -> None:
        if self._connection is not None:
            with contextlib.suppress(OSError):
                self._connection.sendall(
                    b"%s %d\n" % (kind.encode(), self._newest_stamps[kind])
                )

    def _keep_following(self) -> None:
        pause = self._FIRST_PAUSE
        while not self.ending.is_set():
            try:
                with socket.create_connection(self.address, timeout=1.0) as connection:
                    # Or a word would wait 40 ms for the acknowledgement of the one before.
                    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    self.error = ""
                    pause = self._FIRST_PAUSE
                    with self._lock:
                        self._connection = connection
                        for kind in self._newest_stamps:
                            self._send(kind)
                    self._follow(connection)
            except (OSError, ClockError) as error:
                self.error = str(error)
            self._connection = None
            self.ending.wait(pause)
            pause = min(2 * pause, self._MAX_PAUSE)

    def _follow(self, connection: socket.socket) -> None:
        connection.settimeout(0.2)
        unfinished = b""
        while not self.ending.is_set():
            try:
                piece = connection.recv(4096)
            except TimeoutError:
                continue  # a stopped clock is not an error of the connection
            if not piece:
                raise ClockError("the virtual rig has ended")
            *lines, unfinished = (unfinished + piece).split(b"\n")
            if len(unfinished) > _MAX_NUMBER or any(
                not line.isdigit() for line in lines[-1:]
            ):
                raise ClockError(
                    "the stream is not the clock of a virtual rig; is the address right?"
                )
            if lines:
                self._tell(int(lines[-1]))


class Stillness:
    """Detects that a clock is silent. A rig that waits for its readers repeats the time."""

    def __init__(self, patience: float = 1.0) -> None:
        self._patience = patience
        self._last: int | None = None
        self._heard = time.monotonic()
        self.set_backs = 0
        """Number of times that the clock was set back, because the rig was restarted."""

    def tell(self, stamp: int) -> None:
        """Take an update."""
        if self._last is not None and stamp < self._last:
            self.set_backs += 1
        self._last = stamp
        self._heard = time.monotonic()

    def seconds(self) -> float:
        """Wall time for which it was silent, s; 0 up to the patience."""
        still = time.monotonic() - self._heard
        return still if still > self._patience else 0.0
