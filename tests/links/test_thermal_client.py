"""The client over real TCP on this computer, against servers that behave and servers that do not."""

from __future__ import annotations

import itertools
import random
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from tests.support.waiting import PATIENCE, wait_for
from twinmatch.links.thermal_client import ClientSettings, LinkState, LinkStatus, ThermalClient, back_off
from twinmatch.links.thermal_frame import (
    LEPTON_SHAPE,
    Exposure,
    FlatField,
    FrameChecksumError,
    FrameSyntaxError,
    FrameTooLongError,
    ThermalConnectError,
    ThermalEndError,
    ThermalFrame,
    ThermalLinkError,
    ThermalOrderError,
    ThermalStallError,
    encode_frame,
)

QUICK = ClientSettings(connect_timeout=1.0, stall_timeout=0.3, first_wait=0.01, longest_wait=0.05)
BOOT = b"B" * 16
"""Seconds after which a test gives up; none waits as long when all is well."""

Script = Callable[[socket.socket], None]


def frame(sequence: int, *, counter: int | None = None, boot: bytes = BOOT, running: bool = False) -> bytes:
    exposure = Exposure(
        image=np.full(LEPTON_SHAPE, 30000 + sequence, np.uint16),
        stamp=time.monotonic_ns(),
        resolution=0.01,
        frame_counter=sequence if counter is None else counter,
        flat_field=FlatField.RUNNING if running else FlatField.COMPLETE,
    )
    return encode_frame(exposure.numbered(sequence, boot))


class Server:
    """Runs one script per connection, in the order given, then only accepts."""

    def __init__(self, *scripts: Script) -> None:
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        self.connections: list[socket.socket] = []
        self._scripts = scripts
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        for script in itertools.chain(self._scripts, itertools.repeat(lambda _: None)):
            try:
                connection, _ = self.listener.accept()
            except OSError:
                return
            self.connections.append(connection)
            try:
                script(connection)
            except OSError:
                continue

    def close(self) -> None:
        self.listener.shutdown(socket.SHUT_RDWR)
        self.listener.close()
        self._thread.join(PATIENCE)
        for connection in self.connections:
            connection.close()


@contextmanager
def served(*scripts: Script, settings: ClientSettings = QUICK) -> Iterator[ThermalClient]:
    server = Server(*scripts)
    try:
        with ThermalClient("127.0.0.1", server.port, settings) as client:
            yield client
    finally:
        server.close()


def until(client: ThermalClient, condition: Callable[[LinkStatus], bool]) -> LinkStatus:
    wait_for(lambda: condition(client.status), lambda: str(client.status))
    return client.status


def failed_with(client: ThermalClient, kind: type[ThermalLinkError]) -> ThermalLinkError:
    status = until(client, lambda s: kind.__name__ in s.errors)
    assert status.last_error is not None
    return status.last_error


def count(received: object) -> int:
    assert received is not None
    sent: ThermalFrame = received.frame  # type: ignore[attr-defined]
    return int(sent.image[0, 0])


def test_frames_arrive_with_honest_stamps() -> None:
    def script(connection: socket.socket) -> None:
        connection.sendall(frame(0))

    before, realtime = time.monotonic_ns(), time.time_ns()
    with served(script) as client:
        received = client.wait(timeout=PATIENCE)
        assert received is not None
        assert before <= received.taken <= received.received <= time.monotonic_ns()
        assert realtime <= received.received_realtime <= time.time_ns()
        assert received.frame.stamp <= received.received
        assert received.news
        assert received.number == 1
        assert received.age(received.taken + 250_000_000) == 0.25
        assert client.newest() is received
        assert client.news() is received
        assert client.status.state is LinkState.STREAMING


def test_nothing_blocks_without_an_answer() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with ThermalClient("127.0.0.1", port, QUICK) as client:
        assert client.newest() is None
        assert client.news() is None
        error = failed_with(client, ThermalConnectError)
        assert "is the camera server running there?" in str(error)
        assert client.wait(timeout=0.01) is None
        until(client, lambda s: s.errors["ThermalConnectError"] >= 3)
    assert client.status.state is LinkState.CLOSED


def test_connects_when_the_server_comes_up_later() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with ThermalClient("127.0.0.1", port, QUICK) as client:
        failed_with(client, ThermalConnectError)
        with socket.create_server(("127.0.0.1", port)) as listener:
            connection, _ = listener.accept()
            with connection:
                connection.sendall(frame(3))
                received = client.wait(timeout=PATIENCE)
                assert count(received) == 30003
                assert client.status.failures == 0


def test_silence_is_a_stall() -> None:
    with served(lambda _: None) as client:
        assert "no complete frame within 0.3 s" in str(failed_with(client, ThermalStallError))
        until(client, lambda s: s.connections >= 2)


def test_a_frame_that_trickles_is_a_stall_too() -> None:
    def script(connection: socket.socket) -> None:
        for byte in frame(0)[:100]:
            connection.sendall(bytes([byte]))
            time.sleep(0.02)

    with served(script) as client:
        failed_with(client, ThermalStallError)
        assert client.newest() is None


def test_half_a_frame_and_the_end() -> None:
    def script(connection: socket.socket) -> None:
        connection.sendall(frame(0) + frame(1)[:5000])
        connection.shutdown(socket.SHUT_WR)

    with served(script) as client:
        assert "the server closed the connection" in str(failed_with(client, ThermalEndError))
        assert count(client.newest()) == 30000


def test_a_reset_connection() -> None:
    def script(connection: socket.socket) -> None:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        connection.close()

    # A reset that arrives while the client is still connecting counts as not connected, so: many of them.
    patient = ClientSettings(first_wait=0.01, longest_wait=0.05)
    with served(*[script] * 200, settings=patient) as client:
        failed_with(client, ThermalEndError)
        until(client, lambda status: "connection lost" in str(status.last_error))


@pytest.mark.parametrize(
    ("sent", "kind"),
    [
        (b"HTTP/1.1 400 Bad Request\r\n\r\n" * 400, FrameSyntaxError),
        (b"\xff" * 100, FrameSyntaxError),
        (b"\x5a\x7f\xff\xff\xff" + bytes(70_000), FrameTooLongError),
        (b"\xad" + b"\x81" * 70_000, FrameSyntaxError),
    ],
)
def test_garbage_drops_the_connection_and_the_next_one_works(
    sent: bytes, kind: type[ThermalLinkError]
) -> None:
    with served(lambda c: c.sendall(frame(0) + sent), lambda c: c.sendall(frame(7))) as client:
        failed_with(client, kind)
        until(client, lambda s: s.frames == 2)
        assert count(client.newest()) == 30007
        assert client.status.connections == 2


def test_damage_on_the_wire_never_changes_a_picture_that_is_delivered() -> None:
    rng = random.Random(8)
    scripts = []
    for sequence in range(60):
        stream = bytearray(frame(2 * sequence) + frame(2 * sequence + 1))
        for _ in range(rng.choice((1, 3))):
            stream[rng.randrange(len(stream))] ^= 1 << rng.randrange(8)
        scripts.append(bytes(stream))

    def send(data: bytes) -> Script:
        def script(connection: socket.socket) -> None:
            connection.sendall(data)
            connection.close()

        return script

    seen = set()
    patient = ClientSettings(stall_timeout=5.0, first_wait=0.005, longest_wait=0.005)
    with served(*map(send, scripts), lambda c: c.sendall(frame(999)), settings=patient) as client:
        number = 0
        while 999 not in seen:
            received = client.wait(number, PATIENCE)
            assert received is not None, client.status
            number = received.number
            image = received.frame.image
            assert (image == 30000 + received.frame.sequence).all()
            seen.add(received.frame.sequence)
        # Each connection carried two frames, and at least one of them was damaged.
        assert client.status.frames <= 61
        assert sum(client.status.errors.values()) == 60


def test_a_flipped_bit_drops_the_connection() -> None:
    bad = bytearray(frame(1))
    bad[4000] ^= 0x10
    with served(lambda c: c.sendall(frame(0) + bytes(bad) + frame(2))) as client:
        failed_with(client, FrameChecksumError)
        assert count(client.newest()) == 30000


def test_frames_that_go_backwards() -> None:
    with served(lambda c: c.sendall(frame(5) + frame(5))) as client:
        assert "frame 5 follows frame 5" in str(failed_with(client, ThermalOrderError))


def test_a_boot_id_that_changes_in_a_connection() -> None:
    with served(lambda c: c.sendall(frame(5) + frame(6, boot=b"C" * 16))) as client:
        assert "boot id changed" in str(failed_with(client, ThermalOrderError))


def test_frozen_frames_are_not_news() -> None:
    sent = [
        frame(0, counter=10),
        frame(1, counter=11),
        frame(2, counter=11),
        frame(3, counter=12, running=True),
        frame(4, counter=12, running=True),
    ]
    steps = [threading.Event() for _ in sent]

    def script(connection: socket.socket) -> None:
        for step, data in zip(steps, sent, strict=True):
            step.wait(PATIENCE)
            connection.sendall(data)

    slow = ClientSettings(stall_timeout=PATIENCE)
    with served(script, settings=slow) as client:
        news = []
        for number, step in enumerate(steps):
            step.set()
            received = client.wait(number, PATIENCE)
            assert received is not None
            news.append(received.news)
        assert news == [True, True, False, False, False]
        assert client.status.frozen == 3
        assert count(client.newest()) == 30004
        assert count(client.news()) == 30001


def test_the_same_image_after_a_new_connection_is_not_news() -> None:
    def first(connection: socket.socket) -> None:
        connection.sendall(frame(0, counter=4))
        connection.close()

    with served(first, lambda c: c.sendall(frame(1, counter=4))) as client:
        until(client, lambda s: s.frames == 2)
        newest = client.newest()
        assert newest is not None
        assert not newest.news
        assert client.status.restarts == 0


def test_a_restarted_server_is_noticed() -> None:
    def first(connection: socket.socket) -> None:
        connection.sendall(frame(50, counter=4))
        connection.close()

    with served(first, lambda c: c.sendall(frame(0, counter=4, boot=b"C" * 16))) as client:
        until(client, lambda s: s.frames == 2)
        newest = client.newest()
        assert newest is not None
        assert newest.news
        assert client.status.restarts == 1


def test_frames_the_server_left_out_are_counted() -> None:
    with served(lambda c: c.sendall(frame(3) + frame(4) + frame(9))) as client:
        until(client, lambda s: s.frames == 3)
        assert client.status.missed == 4


def test_a_consumer_that_sleeps_gets_the_newest() -> None:
    def script(connection: socket.socket) -> None:
        for sequence in range(60):
            connection.sendall(frame(sequence))
            time.sleep(1 / 9)

    ages = []
    with served(script, settings=ClientSettings()) as client:
        for _ in range(4):
            time.sleep(0.5)
            newest = client.newest()
            assert newest is not None
            ages.append(newest.age())
    # One interval of 0.11 s, and room for a busy computer.
    assert max(ages) < 0.3
    assert min(ages) < 0.15


def test_close_wakes_who_waits() -> None:
    server = Server()
    client = ThermalClient("127.0.0.1", server.port).start()
    waiting = threading.Thread(target=client.wait, args=(0, 60.0))
    waiting.start()
    until(client, lambda s: s.connections == 1)
    client.close()
    waiting.join(PATIENCE)
    assert not waiting.is_alive()
    assert client.status.state is LinkState.CLOSED
    assert not client.status.errors
    server.close()


def test_back_off_doubles_up_to_its_cap_and_knows_no_chance() -> None:
    waits = [back_off(failures) for failures in range(1, 10)]
    assert waits == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0, 5.0])
    assert back_off(10_000) == 5.0


@pytest.mark.parametrize(
    "name", ["connect_timeout", "stall_timeout", "first_wait", "longest_wait", "frame_limit"]
)
def test_settings_must_be_positive(name: str) -> None:
    with pytest.raises(ThermalLinkError, match=f"{name} is 0; it must be positive"):
        ClientSettings(**{name: 0})


def test_the_longest_wait_is_no_shorter_than_the_first() -> None:
    with pytest.raises(ThermalLinkError, match=r"longest_wait 0\.1 s is below first_wait 1 s"):
        ClientSettings(first_wait=1, longest_wait=0.1)
