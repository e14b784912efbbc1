"""A Bokeh server in a thread; the browser loads everything from it, nothing from the internet."""

from __future__ import annotations

import asyncio
import logging
import socket
import threading
from collections.abc import Callable
from contextlib import suppress

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.document import Document
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.settings import settings
from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop

from twinmatch.showing.serving import ServingError, is_loopback, unusable

PATIENCE = 20.0
"""Time limit for the server to start, s."""
LARGEST_MESSAGE = 1 << 20
"""Bytes a browser may send at once; clicks are a few hundred."""


class PageServer:
    """Serves one page; every tab has its own document."""

    def __init__(self, address: str, port: int, fill: Callable[[Document], None]) -> None:
        """Serve on this address; port 0 takes any free port. `fill` builds the document of a tab.

        Raises:
            ServingError: the address or port cannot be used, or the server does not start.
        """
        try:
            self._socket = _bind(address, port)
        except OSError as error:
            raise unusable("dashboard", address, port, error.strerror or error) from error
        self._address, self._port, self._fill = address, self._socket.getsockname()[1], fill
        self._server: BaseServer | None = None
        self._ready = threading.Event()
        self.failure: Exception | None = None
        """The error that ended the thread."""
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._thread.start()
        if not self._ready.wait(PATIENCE):
            raise ServingError(f"dashboard: the page's server did not start within {PATIENCE:g} s; try again")

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{_host(self._address)}:{self._port}/"

    @property
    def tabs(self) -> int:
        """Number of open tabs."""
        return 0 if self._server is None else len(self._server.get_sessions("/"))

    def close(self) -> bool:
        """Stop the server; returns whether its thread has ended."""
        server = self._server
        if server is not None and self._thread.is_alive():
            loop = server.io_loop

            def end() -> None:
                server.unlisten()
                server.stop()
                loop.stop()

            loop.add_callback(end)
        self._thread.join(3.0)
        return not self._thread.is_alive()

    def _run(self) -> None:
        loop = asyncio.new_event_loop()
        asyncio.set_event_loop(loop)
        try:
            self._serve(IOLoop.current())
        except Exception as error:  # read by the node
            self.failure = error
        finally:
            self._ready.set()
            loop.close()

    def _serve(self, loop: IOLoop) -> None:
        for name in ("bokeh", "tornado.access"):
            logging.getLogger(name).setLevel(logging.WARNING)
        settings.resources = "server"  # whatever BOKEH_RESOURCES says
        application = Application(FunctionHandler(self._fill))
        tornado = BokehTornado(
            {"/": application},
            extra_websocket_origins=[f"{host}:{self._port}" for host in self._hosts()],
            absolute_url=self.url,
            websocket_max_message_size_bytes=LARGEST_MESSAGE,
        )
        http = HTTPServer(tornado)
        http.add_socket(self._socket)
        self._server = BaseServer(loop, tornado, http)
        self._server.start()
        self._ready.set()
        loop.start()

    def _hosts(self) -> list[str]:
        """Host names that websocket connections may come from: those of this server only."""
        if is_loopback(self._address):
            return sorted({_host(self._address), "localhost", "127.0.0.1"})
        hosts = {_host(self._address), socket.gethostname(), socket.getfqdn()}
        with suppress(OSError):
            hosts |= {_host(str(info[4][0])) for info in socket.getaddrinfo(socket.gethostname(), None)}
        return sorted(hosts)


def _bind(address: str, port: int) -> socket.socket:
    family, kind, number, _, place = socket.getaddrinfo(address, port, type=socket.SOCK_STREAM)[0]
    bound = socket.socket(family, kind, number)
    try:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.setblocking(False)
        bound.bind(place)
        bound.listen(128)
    except OSError:
        bound.close()
        raise
    return bound


def _host(address: str) -> str:
    return f"[{address}]" if ":" in address else address
