"""The broadcast: newest first, nobody waited for."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator

import pytest
from twinmatch_camera.broadcast import Broadcast
from twinmatch_camera.errors import ListenError

PATIENCE = 10.0
SIZE = 10_000


def message(number: int, size: int = SIZE) -> bytes:
    return number.to_bytes(4, "big") * (size // 4)


@pytest.fixture
def serve() -> Iterator[Callable[..., Broadcast]]:
    running: list[tuple[Broadcast, threading.Thread]] = []

    def start(**options: float) -> Broadcast:
        broadcast = Broadcast("127.0.0.1", 0, **options)
        thread = threading.Thread(target=broadcast.serve, daemon=True)
        thread.start()
        running.append((broadcast, thread))
        return broadcast

    yield start
    for broadcast, thread in running:
        broadcast.stop()
        thread.join(PATIENCE)
        assert not thread.is_alive()


def join(broadcast: Broadcast, buffer: int | None = None) -> socket.socket:
    connection = socket.socket()
    connection.settimeout(PATIENCE)
    if buffer:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
    connection.connect(broadcast.address)
    return connection


def exactly(connection: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        piece = connection.recv(size - len(data))
        assert piece, f"closed after {len(data)} of {size} bytes"
        data += piece
    return data


def heard(broadcast: Broadcast, connection: socket.socket, number: int) -> bytes:
    """Publish until the client, whose connection may not be accepted yet, receives it."""
    connection.settimeout(0.05)
    while True:
        broadcast.publish(message(number))
        try:
            first = connection.recv(1)
            break
        except TimeoutError:
            continue
    connection.settimeout(PATIENCE)
    return first + exactly(connection, SIZE - 1)


def test_every_client_gets_the_message(serve: Callable[..., Broadcast]) -> None:
    broadcast = serve()
    clients = [join(broadcast) for _ in range(3)]
    for client in clients:
        assert heard(broadcast, client, 7) == message(7)
        client.close()


def test_a_client_that_does_not_read_is_dropped_and_the_others_do_not_notice(
    serve: Callable[..., Broadcast], caplog: pytest.LogCaptureFixture
) -> None:
    broadcast = serve(patience=0.3)
    asleep, awake = join(broadcast, buffer=4096), join(broadcast)
    heard(broadcast, awake, 0)
    lags = []
    deadline = time.monotonic() + PATIENCE
    while "took no whole frame" not in caplog.text:
        assert time.monotonic() < deadline
        sent = time.monotonic()
        broadcast.publish(message(1))
        exactly(awake, SIZE)
        lags.append(time.monotonic() - sent)
    asleep.settimeout(PATIENCE)
    taken = 0
    while piece := asleep.recv(65_536):
        taken += len(piece)
    # What had fitted into the buffers of the kernel, and then the end.
    assert taken < 100 * SIZE
    assert sorted(lags)[len(lags) // 2] < 0.2
    asleep.close()
    awake.close()


def test_a_slow_client_skips_to_the_newest(serve: Callable[..., Broadcast]) -> None:
    broadcast = serve(patience=PATIENCE)
    client = join(broadcast, buffer=4096)
    heard(broadcast, client, 0)
    for number in range(1, 301):
        broadcast.publish(message(number))
        time.sleep(0.001)
    got = []
    while not got or got[-1] != 300:
        data = exactly(client, SIZE)
        number = int.from_bytes(data[:4], "big")
        assert data == message(number)
        got.append(number)
    assert got == sorted(got)
    # Three megabytes were sent, the buffers of both kernels hold a small part of it.
    assert len(got) < 100
    client.close()


def test_one_client_too_many_is_refused(
    serve: Callable[..., Broadcast], caplog: pytest.LogCaptureFixture
) -> None:
    broadcast = serve(max_clients=1)
    first = join(broadcast)
    heard(broadcast, first, 1)
    second = join(broadcast)
    assert second.recv(1) == b""
    assert "refused: 1 are connected already" in caplog.text
    first.close()
    second.close()
    deadline = time.monotonic() + PATIENCE
    while True:
        third = join(broadcast)
        third.settimeout(0.1)
        broadcast.publish(message(3))
        try:
            if third.recv(1):
                break
        except (TimeoutError, ConnectionError):
            pass
        assert time.monotonic() < deadline
        third.close()
    third.close()


def test_what_clients_say_is_ignored(serve: Callable[..., Broadcast]) -> None:
    broadcast = serve()
    client = join(broadcast)
    client.sendall(b"GET / HTTP/1.1\r\n\r\n" * 1000)
    assert heard(broadcast, client, 5) == message(5)
    client.close()


def test_a_client_that_resets(serve: Callable[..., Broadcast]) -> None:
    broadcast = serve()
    rude, polite = join(broadcast), join(broadcast)
    heard(broadcast, rude, 1)
    rude.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    rude.close()
    assert heard(broadcast, polite, 1) == message(1)
    polite.close()


def test_publishing_to_nobody_and_after_the_end(serve: Callable[..., Broadcast]) -> None:
    broadcast = serve()
    for number in range(10_000):
        broadcast.publish(message(number, 8))
    broadcast.stop()
    broadcast.publish(message(0))


def test_an_address_of_another_computer() -> None:
    with pytest.raises(ListenError, match=r"cannot listen on 192\.0\.2\.1:0"):
        Broadcast("192.0.2.1", 0)
