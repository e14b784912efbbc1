"""Who may open the page and from where, without a graph."""

from __future__ import annotations

import base64
import socket
import urllib.request
from collections.abc import Iterator

import pytest

pytest.importorskip(
    "bokeh", reason="bokeh is not installed; it is in the extra 'dashboard'"
)

from bokeh.document import Document
from bokeh.models import Div

from tests.support.odd_requests import odd_requests
from tests.support.sockets import UPGRADE, ask, exchange, page_token
from twinmatch.showing.page.server import PageServer
from twinmatch.showing.serving import ServingError, is_loopback


def fill(document: Document) -> None:
    document.add_root(Div(text="here"))


@pytest.fixture
def server() -> Iterator[PageServer]:
    opened = PageServer("127.0.0.1", 0, fill)
    yield opened
    assert opened.close()
    assert opened.failure is None


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
    ("origin", "let_in"),
    [
        ("OWN", True),
        ("http://evil.example", False),
        ("http://127.0.0.1:1", False),
        ("null", False),
    ],
)
def test_pages_of_other_sites_may_not_speak_to_it(
    server: PageServer, origin: str, let_in: bool
) -> None:
    asked = f"Origin: {server.url.rstrip('/') if origin == 'OWN' else origin}"
    protocol = f"Sec-WebSocket-Protocol: bokeh, {page_token(server.url)}"
    assert ask(server.url, "/ws", *UPGRADE, protocol, asked)[0] == (
        101 if let_in else 403
    )


def test_a_websocket_needs_the_token_of_a_page_that_was_loaded(
    server: PageServer,
) -> None:
    good = page_token(server.url)
    base, signature = good.split(".", 1)
    forged = base64.urlsafe_b64encode(
        b'{"session_id": "x", "session_expiry": 99999999999}'
    ).decode()
    for token in (
        "",
        "x",
        "é",
        f"{base}.x",
        f"{forged}.{signature}",
        forged,
        f"{good},{good}",
    ):
        status, why = ask(
            server.url, "/ws", *UPGRADE, f"Sec-WebSocket-Protocol: bokeh, {token}"
        )
        assert (status, "needs the token" in why) == (403, True), token
    assert ask(server.url, "/ws", *UPGRADE)[0] == 403
    assert (
        ask(server.url, "/ws", *UPGRADE, f"Sec-WebSocket-Protocol: bokeh, {good}")[0]
        == 101
    )


@pytest.mark.parametrize(
    "path", ["/", "/ws", "/static/js/bokeh.min.js", "/favicon.ico", "/nothing"]
)
def test_under_a_foreign_name_there_is_nothing(server: PageServer, path: str) -> None:
    port = server.url.rsplit(":", 1)[1].strip("/")
    for name in (
        f"evil.example:{port}",
        "evil.example",
        f"127.0.0.1.evil.example:{port}",
        "192.0.2.1",
        "",
    ):
        status, why = ask(server.url, path, host=name)
        assert status == 403, name
        assert why.startswith("this server does not answer")
        assert why.count("\n") == 1
    for name in (f"localhost:{port}", "localhost:1", f"[::1]:{port}", "127.0.0.1"):
        assert (ask(server.url, path, host=name)[0] == 200) == (
            path not in ("/ws", "/nothing")
        )


@pytest.mark.parametrize(
    "path",
    [
        "/static/js/%00",
        "/static/",
        "/metadata",
        "/autoload.js?bokeh-autoload-element=1",
    ],
)
def test_other_paths_are_not_found(server: PageServer, path: str) -> None:
    assert ask(server.url, path)[0] == 404


def test_a_page_of_another_site_may_link_to_it_but_not_show_it_inside_itself(
    server: PageServer,
) -> None:
    def status(kind: str) -> int:
        return ask(
            server.url, "/", "Sec-Fetch-Site: cross-site", f"Sec-Fetch-Dest: {kind}"
        )[0]

    assert {kind: status(kind) for kind in ("document", "iframe", "image")} == {
        "document": 200,
        "iframe": 403,
        "image": 403,
    }


def test_odd_requests_end_nothing_and_print_nothing(
    server: PageServer,
    capfd: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    for k, request in enumerate(odd_requests(seed=27, count=1000)):
        answer = exchange(server.url, request)
        assert answer == b"" or answer[9:10] in b"1234", (k, request, answer)
    assert ask(server.url)[0] == 200
    assert server.failure is None
    assert capfd.readouterr() == ("", "")
    assert [record.getMessage() for record in caplog.records if record.exc_info] == []


def test_a_port_that_is_taken_is_one_clear_line(server: PageServer) -> None:
    port = int(server.url.rsplit(":", 1)[1].strip("/"))
    with pytest.raises(
        ServingError,
        match=f"127.0.0.1:{port} cannot be used: .*choose another with --port",
    ):
        PageServer("127.0.0.1", port, fill)


@pytest.mark.parametrize(
    ("address", "loopback"),
    [
        *((address, True) for address in ("127.0.0.1", "localhost", "::1")),
        *((address, False) for address in ("0.0.0.0", "192.0.2.1", "rig")),
    ],
)
def test_which_addresses_are_this_machines_own(address: str, loopback: bool) -> None:
    assert is_loopback(address) == loopback
