"""The TCP side: every client gets the newest message, and none is waited for.

A client has at most one message on its way and one that follows. A newer message replaces the one that
follows; a client that does not take a whole message in time is dropped. One thread does all of it with
non-blocking sockets; `publish` may be called from another.
"""

from __future__ import annotations

import logging
import selectors
import socket
import threading
import time

from twinmatch_camera.errors import ListenError

_log = logging.getLogger(__name__)

_SEND_BUFFER = 16_384
"""Small, so that what the kernel holds for a slow client is at most a few messages old."""
_POLL = 0.25


class _Client:
    """One connection: what is on its way to it and what follows."""

    def __init__(self, connection: socket.socket, name: str) -> None:
        self.connection = connection
        self.name = name
        self.rest = memoryview(b"")
        self.following: bytes | None = None
        self.since = 0.0

    def offer(self, message: bytes, now: float) -> None:
        if self.rest:
            self.following = message
        else:
            self.rest = memoryview(message)
            self.since = now
            self.push(now)

    def push(self, now: float) -> None:
        """Send what the socket takes. Raises OSError when the connection is gone."""
        while self.rest:
            try:
                self.rest = self.rest[self.connection.send(self.rest) :]
            except BlockingIOError:
                return
            if not self.rest and self.following is not None:
                self.rest = memoryview(self.following)
                self.since = now
                self.following = None


class Broadcast:
    """Listens, and sends each published message to every client.

    Raises:
        ListenError: the address is not ours or taken.
    """

    def __init__(
        self, host: str, port: int, *, max_clients: int = 8, patience: float = 1.0
    ) -> None:
        self._max_clients = max_clients
        self._patience = patience
        self._clients: dict[socket.socket, _Client] = {}
        self._lock = threading.Lock()
        self._newest: bytes | None = None
        self._stopping = False
        try:
            family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
            self._listener = socket.create_server(
                (host, port), family=family, backlog=16
            )
        except OSError as error:
            msg = (
                f"cannot listen on {host}:{port}: {error}; choose another with --listen"
            )
            raise ListenError(msg) from error
        self._listener.setblocking(False)
        self._wake_out, self._wake_in = socket.socketpair()
        self._wake_out.setblocking(False)
        self._wake_in.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._wake_out, selectors.EVENT_READ)

    @property
    def address(self) -> tuple[str, int]:
        """Host and port listened on."""
        host, port = self._listener.getsockname()[:2]
        return str(host), int(port)

    def publish(self, message: bytes) -> None:
        """Make this the newest message. From any thread; never blocks."""
        with self._lock:
            self._newest = message
        self._wake()

    def stop(self) -> None:
        """Make `serve` return. From any thread or signal handler."""
        self._stopping = True
        self._wake()

    def serve(self) -> None:
        """Serve clients until `stop`; then close everything."""
        try:
            while not self._stopping:
                for key, events in self._selector.select(_POLL):
                    if key.fileobj is self._listener:
                        self._accept()
                    elif key.fileobj is self._wake_out:
                        self._distribute()
                    else:
                        self._attend(key.data, events)
                self._drop_slow()
        finally:
            self.close()

    def close(self) -> None:
        """Close every socket."""
        for client in list(self._clients.values()):
            self._remove(client)
        self._selector.close()
        for ours in (self._listener, self._wake_out, self._wake_in):
            ours.close()

    def _wake(self) -> None:
        try:
            self._wake_in.send(b"\0")
        except OSError:
            return  # full: it will wake anyway; closed: nobody sleeps

    def _accept(self) -> None:
        try:
            connection, peer = self._listener.accept()
        except OSError as error:
            _log.warning("a client could not be accepted: %s", error)
            return
        name = f"{peer[0]}:{peer[1]}"
        if len(self._clients) >= self._max_clients:
            _log.warning(
                "client %s refused: %d are connected already", name, len(self._clients)
            )
            connection.close()
            return
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
        client = _Client(connection, name)
        self._clients[connection] = client
        self._selector.register(connection, selectors.EVENT_READ, client)
        _log.info("client %s connected", name)

    def _distribute(self) -> None:
        try:
            self._wake_out.recv(4096)
        except BlockingIOError:
            return
        with self._lock:
            message = self._newest
            self._newest = None
        if message is None:
            return
        now = time.monotonic()
        for client in list(self._clients.values()):
            try:
                client.offer(message, now)
            except OSError as error:
                self._leave(client, str(error))
            else:
                self._watch(client)

    def _attend(self, client: _Client, events: int) -> None:
        if client.connection not in self._clients:
            return  # dropped while this round of events was handled
        try:
            # Readers have nothing to say; what they say anyway is read only to learn when they leave.
            if events & selectors.EVENT_READ and not client.connection.recv(4096):
                self._leave(client, "closed by the client")
                return
            if events & selectors.EVENT_WRITE:
                client.push(time.monotonic())
        except BlockingIOError:
            return
        except OSError as error:
            self._leave(client, str(error))
            return
        self._watch(client)

    def _watch(self, client: _Client) -> None:
        wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if client.rest else 0)
        if self._selector.get_key(client.connection).events != wanted:
            self._selector.modify(client.connection, wanted, client)

    def _drop_slow(self) -> None:
        now = time.monotonic()
        for client in list(self._clients.values()):
            if client.rest and now - client.since > self._patience:
                _log.warning(
                    "client %s dropped: took no whole frame in %g s",
                    client.name,
                    self._patience,
                )
                self._remove(client)

    def _leave(self, client: _Client, why: str) -> None:
        _log.info("client %s left: %s", client.name, why)
        self._remove(client)

    def _remove(self, client: _Client) -> None:
        del self._clients[client.connection]
        self._selector.unregister(client.connection)
        client.connection.close()
