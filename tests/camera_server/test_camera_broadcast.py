"""The broadcast: newest first, nobody waited for."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import BinaryIO

import pytest
from twinmatch_camera.broadcast import Broadcast
from twinmatch_camera.emulation import PLATE
from twinmatch_camera.errors import ListenError
from twinmatch_camera.sources.base import EndOfRecording
from twinmatch_camera.sources.followed import FollowedSource

from twinmatch.links.thermal_client import region

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


FULL = 100
"""Messages that the kernel's buffers between two programs have no room for."""


def test_a_client_that_does_not_read_holds_nobody_up(
    serve: Callable[..., Broadcast],
) -> None:
    broadcast = serve(patience=10 * PATIENCE)
    asleep = join(broadcast, buffer=4096)
    awake = join(broadcast)
    heard(broadcast, awake, 0)
    for _ in range(FULL):
        broadcast.publish(message(1))
        exactly(awake, SIZE)  # fails if it waits for the other
    asleep.close()
    awake.close()


def test_a_client_that_does_not_read_is_dropped_and_the_others_are_not(
    serve: Callable[..., Broadcast], caplog: pytest.LogCaptureFixture
) -> None:
    broadcast = serve(patience=0.3)
    asleep = join(broadcast, buffer=4096)
    awake = join(broadcast)
    heard(broadcast, awake, 0)
    deadline = time.monotonic() + PATIENCE
    while "took no whole frame" not in caplog.text:
        assert time.monotonic() < deadline
        broadcast.publish(message(1))
        exactly(awake, SIZE)
    asleep.settimeout(PATIENCE)
    received = 0
    while piece := asleep.recv(65_536):
        received += len(piece)
    # What had fitted into the buffers of the kernel, and then the end.
    assert received < FULL * SIZE
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


def test_a_client_that_resets_its_connection_takes_nothing_from_others(
    serve: Callable[..., Broadcast],
) -> None:
    broadcast = serve()
    rude = join(broadcast)
    polite = join(broadcast)
    heard(broadcast, rude, 1)
    rude.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    rude.close()
    assert heard(broadcast, polite, 1) == message(1)
    polite.close()


def test_publishing_to_nobody_and_after_the_end(
    serve: Callable[..., Broadcast],
) -> None:
    broadcast = serve()
    for number in range(10_000):
        broadcast.publish(message(number, 8))
    broadcast.stop()
    broadcast.publish(message(0))


def test_an_address_of_another_computer_is_refused() -> None:
    with pytest.raises(ListenError, match=r"cannot listen on 192\.0\.2\.1:0"):
        Broadcast("192.0.2.1", 0)


# The emulated camera that another program leads through its standard input.

START = 100.0


@pytest.fixture
def pipe() -> Iterator[tuple[int, BinaryIO]]:
    read, write = os.pipe()
    with os.fdopen(write, "wb", buffering=0) as leader:
        yield read, leader
    os.close(read)


def test_each_line_makes_an_image_and_a_repeated_one_repeats_it(
    pipe: tuple[int, BinaryIO],
) -> None:
    source = FollowedSource(pipe[0])
    leader = pipe[1]
    source.open()
    assert source.read(0.01) is None
    exposures = []
    for tick in (*range(20), 19, 19, 20):
        leader.write(b"%.9f 41.5 %d\n" % (START + tick / 9, 7 * tick))
        exposures.append(source.read(5.0))
        assert exposures[-1] is not None
    shown = [e for e in exposures if e is not None]
    # A camera begins with its flat-field correction, 0.9 s: nine ticks of a ninth.
    assert [e.frozen for e in shown[:12]] == [True] * 9 + [False] * 3
    assert [e.frame_counter for e in shown[9:]] == [*range(1, 12), 11, 11, 12]
    assert [e.stamp for e in shown[-2:]] == [7 * 19, 7 * 20]
    assert region(shown[-1], PLATE).mean == pytest.approx(41.5, abs=0.5)


def test_of_several_lines_the_newest_counts(pipe: tuple[int, BinaryIO]) -> None:
    source = FollowedSource(pipe[0])
    leader = pipe[1]
    leader.write(b"0 20 0\n1 30 0\n2 4")
    assert source.read(5.0) is not None
    leader.write(b"0 0\n")
    exposure = source.read(5.0)
    assert exposure is not None
    assert exposure.flat_field_age == 1000  # the first line that counted had the time 1


@pytest.mark.parametrize(
    "line",
    [
        b"warm\n",
        b"1 20\n",
        b"1 2 3 4\n",
        b"1 nan 0\n",
        b"nan 20 0\n",
        b"inf 20 0\n",
        b"1 20 -1\n",
        b"1 20 1.5\n",
    ],
)
def test_an_invalid_line_is_left_out(
    pipe: tuple[int, BinaryIO], line: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    source = FollowedSource(pipe[0])
    leader = pipe[1]
    leader.write(line)
    assert source.read(5.0) is None
    assert "write the time in s, the temperature in" in caplog.text
    leader.write(b"0 20 0\n")
    assert source.read(5.0) is not None


def test_time_cannot_go_back(
    pipe: tuple[int, BinaryIO], caplog: pytest.LogCaptureFixture
) -> None:
    source = FollowedSource(pipe[0])
    leader = pipe[1]
    for line in (b"5 20 0\n", b"6 20 0\n"):
        leader.write(line)
        assert source.read(5.0) is not None
    leader.write(b"5 20 0\n")
    assert source.read(5.0) is None
    assert "is before that of the last image" in caplog.text


def test_the_end_of_the_input_is_the_end_of_the_recording(
    pipe: tuple[int, BinaryIO],
) -> None:
    pipe[1].close()
    with pytest.raises(
        EndOfRecording, match="the program that led the camera has ended"
    ):
        FollowedSource(pipe[0]).read(5.0)
