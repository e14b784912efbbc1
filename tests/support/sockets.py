"""Requests as bytes over TCP, as no HTTP library would send them."""

from __future__ import annotations

import re
import socket
from contextlib import suppress
from urllib.parse import urlsplit

UPGRADE = (
    "Upgrade: websocket",
    "Connection: Upgrade",
    "Sec-WebSocket-Version: 13",
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
)
"""Headers of a websocket's handshake."""


def exchange(url: str, request: bytes, patience: float = 10.0) -> bytes:
    """What a server answers to these bytes, with nothing after them, until it closes or has sent a page."""
    place = urlsplit(url)
    answer = b""
    with socket.create_connection(
        (place.hostname, place.port), timeout=patience
    ) as connection:
        with suppress(OSError):  # it may have closed already
            connection.sendall(request)
            connection.shutdown(socket.SHUT_WR)
        with suppress(ConnectionResetError):
            while part := connection.recv(1 << 16):
                answer += part
    return answer


def ask(
    url: str, path: str = "/", *headers: str, host: str | None = None
) -> tuple[int, str]:
    """Status and text of the answer to a GET, under a host name of one's own choice.

    A websocket is closed as soon as it is open.
    """
    place = urlsplit(url)
    named = f"{place.hostname}:{place.port}" if host is None else host
    lines = (f"GET {path} HTTP/1.1", f"Host: {named}", *headers)
    asked = ("\r\n".join(lines) + "\r\n\r\n").encode()
    with socket.create_connection(
        (place.hostname, place.port), timeout=10.0
    ) as connection:
        connection.sendall(asked)
        answer = b""
        while b"\r\n\r\n" not in answer:
            part = connection.recv(1 << 16)
            assert part, answer
            answer += part
        head, _, body = answer.partition(b"\r\n\r\n")
        status = int(head.split()[1])
        length = re.search(rb"(?i)content-length: (\d+)", head)
        while status != 101 and length is not None and len(body) < int(length[1]):
            body += connection.recv(1 << 16)
    return status, body.decode(errors="replace")


def page_token(url: str) -> str:
    """The token that the live page gives its own script."""
    _, text = ask(url)
    matched = re.search(r'"token":"([^"]+)"', text)
    assert matched is not None, text
    return matched[1]
