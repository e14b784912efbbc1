"""Checks viewers' requests before they reach the SDK's server, which takes every Host and Origin."""

from __future__ import annotations

import asyncio
import secrets
import socket
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from typing import Final

from twinmatch.settings import Rule
from twinmatch.showing.serving import Hosts

REQUEST: Final = 1 << 14
"""Most bytes of a request."""


class _Connections(Rule):
    """Limits of the connections to a server."""

    patience: float = 10.0
    """Time for a request to arrive, s."""
    leave: float = 0.5
    """Time for them to end when the server ends, s."""
    most: int = 200
    """Most of them at once."""


_CONNECTIONS: Final = _Connections()


MAX_TOLD: Final = 8
"""Most reasons of refusals that are printed."""


def hidden_address() -> str:
    """A loopback address that no page can guess; with the port there are 2³⁸ of them."""
    return f"127.{secrets.randbelow(254) + 1}.{secrets.randbelow(256)}.{secrets.randbelow(254) + 1}"


class Relay:
    """Reads the request of each connection, answers 403 or passes it and all that follows on, in a thread."""

    def __init__(
        self, bound: socket.socket, hosts: Hosts, inner: tuple[str, int]
    ) -> None:
        """Take the connections of a listening socket, and let those of `hosts` reach the server `inner`."""
        self._bound = bound
        self._hosts = hosts
        self._inner = inner
        self._open: set[asyncio.Task[None]] = set()
        self._told: set[str] = set()
        self._passage = threading.Lock()
        self._loop = asyncio.new_event_loop()
        self._over = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="relay", daemon=True)
        self._thread.start()

    @contextmanager
    def holding_back(self) -> Iterator[None]:
        """Hold back what the server says to its viewers meanwhile; it reaches them afterwards.

        Connections stand still as long, so this is for what takes milliseconds.
        """
        with self._passage:
            yield

    def close(self) -> bool:
        """End all connections; what their server has said before its end is passed on first.

        Returns:
            Whether the thread has ended.
        """
        self._loop.call_soon_threadsafe(self._over.set)
        self._thread.join(3.0)
        return not self._thread.is_alive()

    def _run(self) -> None:
        self._loop.run_until_complete(self._serve())
        self._loop.close()

    async def _serve(self) -> None:
        server = await asyncio.start_server(
            self._accept, sock=self._bound, limit=REQUEST
        )
        await self._over.wait()
        server.close()
        if self._open:
            _, late = await asyncio.wait(self._open, timeout=_CONNECTIONS.leave)
            for task in late:
                task.cancel()
            await asyncio.gather(*late, return_exceptions=True)

    def _accept(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        if len(self._open) >= _CONNECTIONS.most:
            writer.close()
            return
        task = self._loop.create_task(self._take(reader, writer))
        self._open.add(task)
        task.add_done_callback(self._open.discard)

    async def _take(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        try:
            request = await asyncio.wait_for(
                reader.readuntil(b"\r\n\r\n"), _CONNECTIONS.patience
            )
            why = self._refusal(request)
            if why:
                await _refuse(writer, why)
                return
            await self._pass_on(request, reader, writer)
        except (OSError, EOFError, asyncio.LimitOverrunError, asyncio.TimeoutError):
            return  # it has gone, sends something else, or too slowly
        finally:
            writer.close()

    async def _pass_on(
        self, request: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        from_server, to_server = await asyncio.open_connection(*self._inner)
        ways = [
            self._loop.create_task(_copy(reader, to_server, nullcontext())),
            self._loop.create_task(_copy(from_server, writer, self._passage)),
        ]
        try:
            to_server.write(request)
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            to_server.close()

    def _refusal(self, request: bytes) -> str:
        """Why a request is refused; empty if it is not."""
        headers: dict[str, str] = {}
        for line in request.decode("latin-1").split("\r\n")[1:]:
            name, _, value = line.partition(":")
            name = name.strip().lower()
            headers[name] = (
                f"{headers[name]}, {value.strip()}"
                if name in headers
                else value.strip()
            )
        why = self._hosts.refusal(
            headers.get("host"), headers.get("origin"), beside=True
        )
        if why and why not in self._told and len(self._told) < MAX_TOLD:
            self._told.add(why)
            print(f"foxglove: refused: {why}", flush=True)
        return why


async def _refuse(writer: asyncio.StreamWriter, why: str) -> None:
    body = f"{why}\n".encode()
    head = "HTTP/1.1 403 Forbidden\r\nContent-Type: text/plain; charset=utf-8\r\nConnection: close\r\n"
    writer.write(f"{head}Content-Length: {len(body)}\r\n\r\n".encode() + body)
    await writer.drain()


async def _copy(
    source: asyncio.StreamReader,
    sink: asyncio.StreamWriter,
    passage: AbstractContextManager[object],
) -> None:
    """Pass bytes on until one side ends, each time within `passage`; a side that does not read holds back
    only its own."""
    with suppress(OSError):
        while data := await source.read(1 << 16):
            with passage:
                sink.write(data)
            await sink.drain()
