"""A browser to which a foreign name resolves to this machine, as after DNS rebinding."""

from __future__ import annotations

from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from typing import Any
from urllib.parse import urlsplit

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip(
    "bokeh", reason="bokeh is not installed; it is in the extra 'dashboard'"
)
pytest.importorskip(
    "foxglove", reason="foxglove-sdk is not installed; it is in the extra 'foxglove'"
)

from tests.showing.page.conftest import FOREIGN
from tests.support.processes import Process
from tests.support.sockets import page_token
from twinmatch.showing.foxglove.node import GraphServer

pytestmark = pytest.mark.ros

STATUS = "return performance.getEntriesByType('navigation')[0].responseStatus"
SOCKET = """
const [url, protocols, done] = arguments;
const made = new WebSocket(url, protocols);
made.onopen = () => { made.close(); done('open') };
made.onerror = () => done('refused');
"""
FETCH = "const done = arguments[1]; fetch(arguments[0]).then(async (a) => done(await a.text()), () => done(null))"


@pytest.fixture(scope="module")
def elsewhere() -> Iterator[str]:
    """A page of somebody else, under the foreign name."""

    class Answer(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            self.wfile.write(b"<title>elsewhere</title>")

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Answer)
    Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://{FOREIGN}:{server.server_port}/"
    server.shutdown()
    server.server_close()


def named(url: str, name: str) -> str:
    return url.replace("127.0.0.1", name)


def test_a_foreign_name_gets_403_and_nothing_of_the_page(
    commanding: Process, browser: Any
) -> None:
    foreign = named(commanding.url, FOREIGN)
    for path in ("", "static/js/bokeh.min.js"):
        browser.driver.get(foreign + path)
        assert browser.run(STATUS) == 403
        assert f"does not answer under the name '{FOREIGN}'" in browser.text
        assert "Bokeh" not in browser.driver.page_source
    # The same origin, as the browser sees it, so that only the server can refuse it.
    socket = foreign.replace("http", "ws") + "ws"
    assert (
        browser.driver.execute_async_script(
            SOCKET, socket, ["bokeh", page_token(commanding.url)]
        )
        == "refused"
    )
    text = browser.driver.execute_async_script(FETCH, foreign)
    assert "does not answer under the name" in text


def test_a_page_of_another_site_gets_neither_token_nor_websocket(
    commanding: Process, browser: Any, elsewhere: str
) -> None:
    browser.driver.get(elsewhere)
    assert browser.driver.title == "elsewhere"
    assert browser.driver.execute_async_script(FETCH, commanding.url) is None
    for name in ("127.0.0.1", FOREIGN):
        socket = named(commanding.url, name).replace("http", "ws") + "ws"
        assert (
            browser.driver.execute_async_script(
                SOCKET, socket, ["bokeh", page_token(commanding.url)]
            )
            == "refused"
        )


def test_this_machine_gets_the_page_and_its_websocket_by_name_too(
    commanding: Process, browser: Any
) -> None:
    """By its address 127.0.0.1 all other tests in a browser open it."""
    browser.open(named(commanding.url, "localhost"))
    socket = named(commanding.url, "localhost").replace("http", "ws") + "ws"
    protocols = ["bokeh", page_token(commanding.url)]
    assert browser.driver.execute_async_script(SOCKET, socket, protocols) == "open"
    assert browser.run(STATUS) == 200
    assert browser.button("Output off") is not None
    browser.wait_for(
        lambda: "waiting for the first sample" in browser.text,
        "what comes by the websocket",
    )


def test_the_viewers_server_opens_for_local_pages_alone(
    commanding: Process, browser: Any, elsewhere: str
) -> None:
    server = GraphServer("rig", "127.0.0.1", 0)
    viewer = ["foxglove.sdk.v1"]
    outcomes = {}
    for place in (commanding.url + "metrics", elsewhere):
        # a text of the same server, which is loaded sooner
        browser.driver.get(place)
        for name in ("127.0.0.1", FOREIGN):
            outcome = browser.driver.execute_async_script(
                SOCKET, named(server.url, name), viewer
            )
            outcomes[urlsplit(place).hostname, name] = outcome
    server.close()
    assert [key for key, outcome in outcomes.items() if outcome == "open"] == [
        ("127.0.0.1", "127.0.0.1")
    ]
    assert len(outcomes) == 4
