"""The Bokeh server of the page, in a thread: who may ask it, and for what. The browser loads nothing from the
internet."""

from __future__ import annotations

import asyncio
import logging
import re
import secrets
import threading
import time
from collections.abc import Callable
from http import HTTPStatus
from typing import Any, Final

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.document import Document
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.settings import settings
from bokeh.util.token import check_token_signature, get_token_payload
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPServerRequest
from tornado.ioloop import IOLoop
from tornado.web import RequestHandler

from twinmatch.showing.serving import Hosts, ServingError, listen

PATIENCE = 20.0
"""Time limit for the server to start, s."""
LARGEST_MESSAGE = 1 << 20
"""Most bytes of a message of the websocket; a click has a few hundred."""


LARGEST_REQUEST: Final = 1 << 16
"""Most bytes of a request's header, and of its body; a browser sends a few hundred."""
PATHS: Final = re.compile(r"/|/ws|/favicon\.ico|/metrics|/static/[\w./-]+", re.ASCII)
"""Paths that a browser or Prometheus asks for; Bokeh's own for pages of other sites are not among them."""


class PageServer:
    """Serves one page; every tab has its own document."""

    def __init__(
        self,
        address: str,
        port: int,
        fill: Callable[[Document], None],
        hosts: Hosts | None = None,
        metrics: Callable[[], bytes] = bytes,
    ) -> None:
        """Serve on this address; port 0 takes any free port. `fill` builds the document of a tab.

        `hosts` are the names that it answers to; None: those of the address alone. `metrics` is the text at
        /metrics; a `ServingError` says why there is none.

        Raises:
            ServingError: the address or port cannot be used, or the server does not start.
        """
        self._socket, self._place = listen("dashboard", address, port)
        self._fill = fill
        self._hosts = hosts or Hosts.of(address)
        self._metrics = metrics
        self._server: BaseServer | None = None
        self._ready = threading.Event()
        self.failure: Exception | None = None
        """The error that ended the thread."""
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._thread.start()
        if not self._ready.wait(PATIENCE):
            raise ServingError(
                f"dashboard: the page's server did not start within {PATIENCE:g} s; try again"
            )

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{self._place}/"

    @property
    def tabs(self) -> int:
        """Number of open tabs."""
        return 0 if self._server is None else len(self._server.get_sessions("/"))

    def close(self) -> bool:
        """Stop the server; returns whether its thread has ended."""
        server = self._server
        if server is not None and self._thread.is_alive():
            for end in (server.unlisten, server.stop, server.io_loop.stop):
                server.io_loop.add_callback(end)
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
        logging.getLogger("bokeh").setLevel(logging.WARNING)
        for name in ("tornado.access", "tornado.general"):
            # requests of others do not belong into this log
            logging.getLogger(name).setLevel(logging.CRITICAL)
        settings.resources = "server"  # whatever BOKEH_RESOURCES says
        settings.allowed_ws_origin = None  # nor does BOKEH_ALLOW_WS_ORIGIN
        application = Application(FunctionHandler(self._fill))
        tornado = _Guarded(self._hosts, application, self.url, self._metrics)
        http = HTTPServer(
            tornado, max_header_size=LARGEST_REQUEST, max_body_size=LARGEST_REQUEST
        )
        http.add_socket(self._socket)
        self._server = BaseServer(loop, tornado, http)
        self._server.start()
        self._ready.set()
        loop.start()


class _Guarded(BokehTornado):  # type: ignore[misc]  # Bokeh has no types
    """Bokeh's application behind a check of every request: of page, websocket and what they load."""

    def __init__(
        self,
        hosts: Hosts,
        application: Application,
        url: str,
        metrics: Callable[[], bytes],
    ) -> None:
        """Answer to these hosts. A websocket needs a token that this server has signed."""
        self._hosts = hosts
        self._key = secrets.token_bytes(32)
        super().__init__(
            {"/": application},
            extra_patterns=[("/metrics", _Scrape, {"metrics": metrics})],
            extra_websocket_origins=["*:*"],  # `find_handler` has checked them
            absolute_url=url,
            sign_sessions=True,
            secret_key=self._key,
            include_headers=[],
            include_cookies=[],
            websocket_max_message_size_bytes=LARGEST_MESSAGE,
        )

    def find_handler(self, request: HTTPServerRequest, **_: Any) -> Any:
        """The handler of a request, or of its refusal."""
        refused = self._refusal(request)
        if refused is None:
            return super().find_handler(request)
        status, why = refused
        return self.get_handler_delegate(
            request, _Refusal, {"status": status, "why": why}
        )

    def _refusal(self, request: HTTPServerRequest) -> tuple[HTTPStatus, str] | None:
        """Status and sentence with which a request is refused; None if it is answered."""
        headers = request.headers
        why = self._hosts.refusal(headers.get("Host"), headers.get("Origin"))
        if why:
            return HTTPStatus.FORBIDDEN, why
        if (
            headers.get("Sec-Fetch-Site") == "cross-site"
            and headers.get("Sec-Fetch-Dest") != "document"
        ):
            return (
                HTTPStatus.FORBIDDEN,
                "a page of another site may not use this one; open it in a tab",
            )
        if PATHS.fullmatch(request.path) is None:
            return (
                HTTPStatus.NOT_FOUND,
                "there is nothing of this name here; the page is at /",
            )
        if "Bokeh-Session-Id" in headers or any(
            name.startswith("bokeh-") for name in request.arguments
        ):
            return (
                HTTPStatus.FORBIDDEN,
                "a session cannot be chosen here; the page is at /",
            )
        if request.path == "/ws" and not self._has_token(
            headers.get("Sec-WebSocket-Protocol", "")
        ):
            return (
                HTTPStatus.FORBIDDEN,
                "this needs the token of a page that was loaded from here; reload it",
            )
        return None

    def _has_token(self, protocols: str) -> bool:
        """Whether a websocket is asked for with a token of this server that has not expired."""
        kind, _, token = protocols.partition(",")
        try:
            good = check_token_signature(
                token.strip(), secret_key=self._key, signed=True
            )
            return (
                kind == "bokeh"
                and good
                and get_token_payload(token.strip())["session_expiry"] > time.time()
            )
        except Exception:  # Bokeh decodes the token before it looks at the signature
            return False


class _Scrape(RequestHandler):  # type: ignore[misc]  # nor has Tornado
    """Answers with metrics in the text format of Prometheus."""

    def initialize(self, metrics: Callable[[], bytes]) -> None:
        """Take the function that returns the metrics."""
        self._metrics = metrics

    def get(self) -> None:
        """Answer."""
        self.set_header("Content-Type", "text/plain; version=0.0.4; charset=utf-8")
        try:
            self.finish(self._metrics())
        except ServingError as error:
            self.set_status(HTTPStatus.NOT_FOUND)
            self.finish(f"{error}\n")


class _Refusal(RequestHandler):  # type: ignore[misc]
    """Refuses a request, with the reason."""

    def initialize(self, status: HTTPStatus, why: str) -> None:
        """Answer with this status and sentence."""
        self._why = why
        self.set_status(status)

    def prepare(self) -> None:
        """Answer, whatever the method."""
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{self._why}\n")
