"""Who may open the page and from where, without a graph."""

from __future__ import annotations

import asyncio
import socket
import urllib.request
from collections.abc import Iterator

import pytest

pytest.importorskip("bokeh", reason="bokeh is not installed; it is in the extra 'dashboard'")

from bokeh.document import Document
from bokeh.models import Div
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

from twinmatch.showing.page.tab import PageServer
from twinmatch.showing.serving import ServingError, is_loopback


def fill(document: Document) -> None:
    document.add_root(Div(text="here"))


@pytest.fixture
def server() -> Iterator[PageServer]:
    made = PageServer("127.0.0.1", 0, fill)
    yield made
    assert made.close()
    assert made.failure is None


def test_the_page_and_all_it_loads_come_from_here(server: PageServer) -> None:
    with urllib.request.urlopen(server.url) as answer:
        text = answer.read().decode()
    assert "static/js/bokeh.min.js" in text
    assert "cdn.bokeh.org" not in text
    with urllib.request.urlopen(server.url + "static/js/bokeh.min.js") as answer:
        assert answer.status == 200


def test_it_listens_on_this_machine_only(server: PageServer) -> None:
    port = int(server.url.rsplit(":", 1)[1].strip("/"))
    with socket.socket() as elsewhere:  # the port is free on every other address
        elsewhere.bind(("127.0.0.2", port))


@pytest.mark.parametrize(
    ("origin", "let_in"), [("OWN", True), ("http://evil.example", False), ("http://127.0.0.1:1", False)]
)
def test_pages_of_other_sites_may_not_speak_to_it(server: PageServer, origin: str, let_in: bool) -> None:
    own = server.url.rstrip("/")

    async def knock() -> int:
        request = HTTPRequest(
            own.replace("http", "ws") + "/ws", headers={"Origin": own if origin == "OWN" else origin}
        )
        try:
            connection = await websocket_connect(request, subprotocols=["bokeh", "no-token"])
        except HTTPClientError as error:
            return error.code
        connection.close()
        while await connection.read_message() is not None:  # until the other side has closed too
            pass
        return 101

    # A client that is let in still needs the token that only the page itself has.
    assert (asyncio.run(knock()) != 403) == let_in


def test_a_port_that_is_taken_is_one_clear_line(server: PageServer) -> None:
    port = int(server.url.rsplit(":", 1)[1].strip("/"))
    with pytest.raises(ServingError, match=f"127.0.0.1:{port} cannot be used: .*choose another with --port"):
        PageServer("127.0.0.1", port, fill)


@pytest.mark.parametrize(
    ("address", "loopback"),
    [
        *((one, True) for one in ("127.0.0.1", "localhost", "::1")),
        *((one, False) for one in ("0.0.0.0", "192.0.2.1", "rig")),
    ],
)
def test_which_addresses_are_this_machines_own(address: str, loopback: bool) -> None:
    assert is_loopback(address) == loopback
