"""HTTP requests that no browser sends, in part hardly HTTP."""

from __future__ import annotations

import random
from collections.abc import Iterator

METHODS = (
    "GET",
    "GET",
    "GET",
    "HEAD",
    "POST",
    "OPTIONS",
    "PUT",
    "TRACE",
    "get",
    "\x16\x03",
    "",
)
PATHS = (
    "/", "/ws", "/metadata", "/autoload.js", "/static/js/bokeh.min.js", "/favicon.ico", "*", "", "//", "/..",
    "/static/js/%00", "/static/%2e%2e/%2e%2e/etc/passwd", "/static/extensions/x", "/static//etc/passwd",
    "/static/" + "a" * 5000, "/%ff%fe", "/ws?%00", "/?bokeh-token=x", "/?bokeh-session-id=%00", "/?a=%ff",
    "http://other.example/", "/static/js", "/static/\x1b[2J", "/?bokeh-autoload-element=1", "/static/é",
)  # fmt: skip
VERSIONS = ("HTTP/1.1", "HTTP/1.1", "HTTP/1.0", "HTTP/9", "")
HOSTS = (
    "127.0.0.1", "localhost", "evil.example", "", "[::1", "127.0.0.1:99999999", "a b", "127.0.0.1, evil",
    "\x00", "localhost:x", "[::1]", "user@localhost", "localhost/..", "127.0.0.1\r\nHost: evil.example", "é",
    "9" * 9000,
)  # fmt: skip
HEADERS = (
    "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: eA==",
    "Sec-WebSocket-Protocol: bokeh, x", "Sec-WebSocket-Protocol: bokeh, eyJ4IjoxfQ.x", ": y",
    "Sec-WebSocket-Protocol: ,", "Content-Length: -1", "Content-Length: 99999999999", " folded: yes",
    "Transfer-Encoding: chunked", "Expect: 100-continue", "Origin: http://evil.example", "Origin: null",
    "Origin: \x1b]0;x\x07", "Bokeh-Session-Id: x", "no colon", "Cookie: a=\x01; b", "X: " + "x" * 70_000,
    "Range: bytes=9-1", "If-Modified-Since: x", "Sec-Fetch-Site: cross-site", "Accept-Encoding: gzip;q=x",
    "Content-Type: multipart/form-data",
)  # fmt: skip


def odd_requests(seed: int, count: int) -> Iterator[bytes]:
    """Draw requests; the same seed gives the same ones."""
    draw = random.Random(seed)
    for _ in range(count):
        lines = [" ".join(map(draw.choice, (METHODS, PATHS, VERSIONS)))]
        lines += [f"Host: {draw.choice(HOSTS)}"] * draw.choice((0, 1, 1, 1, 2))
        lines += draw.choices(HEADERS, k=draw.randint(0, 4))
        whole = bytearray(("\r\n".join(lines) + "\r\n\r\n").encode())
        kind = draw.random()
        if kind < 0.1:
            whole = whole[: draw.randrange(len(whole))]
        elif kind < 0.2:
            for _ in range(3):
                whole[draw.randrange(len(whole))] = draw.randrange(256)
        yield bytes(whole) + draw.randbytes(draw.choice((0, 0, 0, 40)))
