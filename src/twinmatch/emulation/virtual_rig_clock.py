"""Plant time over a loopback TCP stream: one line per update, nanoseconds as text.

The rig sends plant time; a slow reader misses updates. A reader keeps only the newest. It may report back, in
the same form, up to which time it has processed everything: when plant time runs faster than the wall clock,
the rig does not run far ahead of such readers.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable

from twinmatch.errors import TwinmatchError

__all__ = ["ClockClient", "ClockError", "ClockServer", "Stillness", "parse_address"]

_LONGEST = 32
_FIRST_PAUSE, _LONGEST_PAUSE = 0.1, 2.0


class ClockError(TwinmatchError):
    """An invalid address, or a stream that is not a clock."""


def parse_address(text: str) -> tuple[str, int]:
    """Host and port from `HOST:PORT`.

    Raises:
        ClockError: the text is not an address.
    """
    host, _, port = text.rpartition(":")
    if not (host and port.isascii() and port.isdecimal() and 0 < int(port) < 65536):
        raise ClockError(f"clock address {text!r}: give HOST:PORT, as the virtual rig prints it")
    return host.strip("[]"), int(port)


class ClockServer:
    """The rig's side. It has no thread: the rig's loop calls `accept` and `send`."""

    def __init__(self, host: str = "127.0.0.1", port: int = 0) -> None:
        self._listener = socket.create_server((host, port), backlog=8)
        self._listener.setblocking(False)
        self._clients: list[socket.socket] = []
        self._done: dict[socket.socket, tuple[int, float]] = {}

    @property
    def address(self) -> tuple[str, int]:
        """Host and port."""
        host, port = self._listener.getsockname()[:2]
        return str(host), int(port)

    def accept(self) -> None:
        """Accept waiting clients."""
        with contextlib.suppress(BlockingIOError):
            while True:
                client, _ = self._listener.accept()
                client.setblocking(False)
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
                self._clients.append(client)

    def send(self, stamp: int) -> None:
        """Send plant time, ns, to all clients."""
        self.accept()
        line = b"%d\n" % stamp
        for client in list(self._clients):
            try:
                whole = client.send(line) == len(line)
            except BlockingIOError:
                continue  # it has not read earlier updates: it may miss this one
            except OSError:
                whole = False
            if not whole:
                self._drop(client)

    def slowest(self, patience: float) -> int | None:
        """The progress of the slowest client that reports it, ns; None if none does.

        Clients without a report for `patience` (wall s) are not counted.
        """
        now = time.monotonic()
        for client in list(self._clients):
            self._listen(client, now)
        lively = [done for done, at in self._done.values() if now - at < patience]
        return min(lively, default=None)

    def _listen(self, client: socket.socket, now: float) -> None:
        try:
            said = client.recv(4096)
        except BlockingIOError:
            return
        except OSError:
            said = b""
        if not said:
            self._drop(client)
            return
        lines = [line for line in said.split(b"\n") if line.isdigit() and len(line) < _LONGEST]
        if lines:
            self._done[client] = (int(lines[-1]), now)

    def _drop(self, client: socket.socket) -> None:
        self._clients.remove(client)
        self._done.pop(client, None)
        client.close()

    def close(self) -> None:
        """Close everything."""
        for client in (*self._clients, self._listener):
            client.close()
        self._clients.clear()
        self._done.clear()


class ClockClient:
    """A reader's side: a thread that calls `tell` with the newest time, and reconnects when necessary."""

    def __init__(self, address: tuple[str, int], tell: Callable[[int], None]) -> None:
        self.address = address
        self.error: str = "not connected yet"
        """Why there is no connection; empty while there is one."""
        self.failure: Exception | None = None
        """The error that ended the thread, if any."""
        self._tell = tell
        self._connection: socket.socket | None = None
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="plant clock", daemon=True)

    def start(self) -> None:
        """Start the thread; returns at once."""
        self._thread.start()

    def close(self) -> bool:
        """End the thread; returns whether it ended."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join(3.0)
        return not self._thread.is_alive()

    def done(self, stamp: int) -> None:
        """Report that everything up to this time, ns, is processed; lost without a connection."""
        connection = self._connection
        if connection is not None:
            with contextlib.suppress(OSError):
                connection.sendall(b"%d\n" % stamp)

    def _run(self) -> None:
        try:
            self._keep_following()
        except Exception as error:  # checked by the owner
            self.failure = error

    def _keep_following(self) -> None:
        pause = _FIRST_PAUSE
        while not self._stopping.is_set():
            try:
                with socket.create_connection(self.address, timeout=1.0) as connection:
                    self.error = ""
                    pause = _FIRST_PAUSE
                    self._connection = connection
                    self._follow(connection)
            except (OSError, ClockError) as error:
                self.error = str(error)
            self._connection = None
            self._stopping.wait(pause)
            pause = min(2 * pause, _LONGEST_PAUSE)

    def _follow(self, connection: socket.socket) -> None:
        connection.settimeout(0.2)
        rest = b""
        while not self._stopping.is_set():
            try:
                piece = connection.recv(4096)
            except TimeoutError:
                continue  # a stopped clock is not an error of the connection
            if not piece:
                raise ClockError("the virtual rig has ended")
            *lines, rest = (rest + piece).split(b"\n")
            if len(rest) > _LONGEST or any(not line.isdigit() for line in lines[-1:]):
                raise ClockError("the stream is not the clock of a virtual rig; is the address right?")
            if lines:
                self._tell(int(lines[-1]))


class Stillness:
    """Detects that a clock stands still."""

    def __init__(self, patience: float = 1.0) -> None:
        self._patience = patience
        self._last: int | None = None
        self._moved = time.monotonic()
        self.set_backs = 0
        """Number of times that the clock was set back, because the rig was restarted."""

    def tell(self, stamp: int) -> None:
        """Take an update."""
        if self._last is not None and stamp < self._last:
            self.set_backs += 1
        if stamp != self._last:
            self._last, self._moved = stamp, time.monotonic()

    def seconds(self) -> float:
        """Wall time for which the clock has stood still, s; 0 up to the patience."""
        still = time.monotonic() - self._moved
        return still if still > self._patience else 0.0
