"""The client over real TCP on this computer, against servers that behave and servers that do not."""

from __future__ import annotations

import itertools
import random
import socket
import statistics
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tests.support.waiting import PATIENCE, wait_for
from twinmatch.links.thermal_client import (
    ClientSettings,
    LinkState,
    LinkStatus,
    Region,
    RegionError,
    StampMapper,
    ThermalClient,
    back_off,
    celsius,
    region,
)
from twinmatch.links.thermal_frame import (
    LEPTON_SHAPE,
    Exposure,
    FlatField,
    FrameChecksumError,
    FrameFlags,
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

QUICK = ClientSettings(stall_timeout=0.3, first_wait=0.01, longest_wait=0.05)
BOOT = b"B" * 16

Script = Callable[[socket.socket], None]


def frame(
    sequence: int,
    *,
    counter: int | None = None,
    boot: bytes = BOOT,
    running: bool = False,
) -> bytes:
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
def served(
    *scripts: Script, settings: ClientSettings = QUICK
) -> Iterator[ThermalClient]:
    server = Server(*scripts)
    try:
        with ThermalClient("127.0.0.1", server.port, settings) as client:
            yield client
    finally:
        server.close()


def until(client: ThermalClient, condition: Callable[[LinkStatus], bool]) -> LinkStatus:
    wait_for(lambda: condition(client.status), lambda: str(client.status))
    return client.status


def failed_with(
    client: ThermalClient, kind: type[ThermalLinkError]
) -> ThermalLinkError:
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

    before = time.monotonic_ns()
    with served(script) as client:
        received = client.wait(timeout=PATIENCE)
        assert received is not None
        assert before <= received.taken <= received.received <= time.monotonic_ns()
        assert received.frame.stamp <= received.received
        assert received.news
        assert received.number == 1
        assert received.age(received.taken + 250_000_000) == 0.25
        assert client.newest() is received
        assert client.news() is received
        assert client.status.state is LinkState.STREAMING


def test_nothing_blocks_without_an_answer_and_it_connects_when_the_server_comes_up_later() -> (
    None
):
    with socket.create_server(("127.0.0.1", 0)) as reserved:
        port = reserved.getsockname()[1]
    with ThermalClient("127.0.0.1", port, QUICK) as client:
        assert client.newest() is None
        assert client.news() is None
        error = failed_with(client, ThermalConnectError)
        assert "is the camera server running there?" in str(error)
        assert client.wait(timeout=0.01) is None
        until(client, lambda s: s.errors["ThermalConnectError"] >= 3)
        with socket.create_server(("127.0.0.1", port)) as listener:
            connection, _ = listener.accept()
            with connection:
                connection.sendall(frame(3))
                received = client.wait(timeout=PATIENCE)
                assert count(received) == 30003
                assert client.status.failures == 0
    assert client.status.state is LinkState.CLOSED


def trickling(connection: socket.socket) -> None:
    for byte in frame(0)[:100]:
        connection.sendall(bytes([byte]))
        time.sleep(0.02)


@pytest.mark.parametrize("script", [lambda _: None, trickling])
def test_silence_and_a_frame_that_trickles_are_a_stall(script: Script) -> None:
    with served(script) as client:
        assert "no complete frame within 0.3 s" in str(
            failed_with(client, ThermalStallError)
        )
        until(client, lambda s: s.connections >= 2)
        assert client.newest() is None


def flipped(data: bytes) -> bytes:
    return data[:4000] + bytes([data[4000] ^ 0x10]) + data[4001:]


@pytest.mark.parametrize(
    ("sent", "kind", "words"),
    [
        (
            frame(0) + frame(1)[:5000],
            ThermalEndError,
            "the server closed the connection",
        ),
        (
            frame(0) + flipped(frame(1)) + frame(2),
            FrameChecksumError,
            "the bytes were corrupted",
        ),
        (frame(0) + frame(0), ThermalOrderError, "frame 0 follows frame 0"),
        (frame(0) + frame(1, boot=b"C" * 16), ThermalOrderError, "boot id changed"),
    ],
)
def test_a_stream_that_goes_wrong_is_dropped(
    sent: bytes, kind: type[ThermalLinkError], words: str
) -> None:
    def script(connection: socket.socket) -> None:
        connection.sendall(sent)
        connection.shutdown(socket.SHUT_WR)

    with served(script) as client:
        assert words in str(failed_with(client, kind))
        assert count(client.newest()) == 30000


def test_a_connection_that_is_reset_counts_as_lost() -> None:
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
    with served(
        lambda c: c.sendall(frame(0) + sent), lambda c: c.sendall(frame(7))
    ) as client:
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

    sequences = set()
    patient = ClientSettings(stall_timeout=5.0, first_wait=0.005, longest_wait=0.005)
    with served(
        *map(send, scripts), lambda c: c.sendall(frame(999)), settings=patient
    ) as client:
        number = 0
        while 999 not in sequences:
            received = client.wait(number, PATIENCE)
            assert received is not None, client.status
            number = received.number
            image = received.frame.image
            assert (image == 30000 + received.frame.sequence).all()
            sequences.add(received.frame.sequence)
        # Each connection carried two frames, and at least one of them was damaged.
        assert client.status.frames <= 61
        assert sum(client.status.errors.values()) == 60


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


@pytest.mark.parametrize(("boot", "restarted"), [(BOOT, False), (b"C" * 16, True)])
def test_the_same_count_is_news_only_of_a_server_that_restarted(
    boot: bytes, restarted: bool
) -> None:
    def first(connection: socket.socket) -> None:
        connection.sendall(frame(0, counter=4))
        connection.close()

    with served(first, lambda c: c.sendall(frame(1, counter=4, boot=boot))) as client:
        until(client, lambda s: s.frames == 2)
        newest = client.newest()
        assert newest is not None
        assert newest.news is restarted
        assert client.status.restarts == restarted


def test_frames_the_server_left_out_are_counted() -> None:
    with served(lambda c: c.sendall(frame(3) + frame(4) + frame(9))) as client:
        until(client, lambda s: s.frames == 3)
        assert client.status.missed == 4


def test_a_consumer_that_sleeps_gets_the_newest() -> None:
    with served(lambda c: c.sendall(b"".join(map(frame, range(20))))) as client:
        until(client, lambda status: status.frames == 20)
        assert count(client.newest()) == count(client.wait(after=3)) == 30019


def test_close_wakes_who_waits() -> None:
    server = Server()
    client = ThermalClient("127.0.0.1", server.port)
    client.start()
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


MS = 1_000_000


def test_the_quickest_frame_sets_the_offset() -> None:
    mapper = StampMapper()
    assert mapper.map(0, 1000 * MS + 5 * MS) == 1005 * MS
    assert mapper.map(100 * MS, 1100 * MS + 1 * MS) == 1101 * MS
    assert mapper.map(200 * MS, 1200 * MS + 80 * MS) == 1201 * MS


@given(
    st.integers(0, 10**15), st.lists(st.integers(0, 500 * MS), min_size=1, max_size=50)
)
def test_never_early_and_late_by_the_shortest_transit(
    offset: int, transits: list[int]
) -> None:
    mapper = StampMapper()
    for i, transit in enumerate(transits):
        stamp = 111 * MS * i
        mapped = mapper.map(stamp, stamp + offset + transit)
        assert mapped - (stamp + offset) == min(transits[: i + 1])


def test_clocks_that_drift_apart_cost_what_they_drift_in_two_stretches() -> None:
    mapper = StampMapper()
    worst = 0
    for i in range(0, 3600 * 9):
        ours = 111 * MS * i
        camera = ours - ours * 50 // 1_000_000  # 50 ppm slow
        worst = max(worst, abs(mapper.map(camera, ours) - ours))
    # 50 ppm of two stretches of 30 s are 3 ms.
    assert worst <= 2 * StampMapper.MEMORY * 50 // 1_000_000 + MS


def test_a_quick_frame_is_forgotten_after_two_stretches() -> None:
    mapper = StampMapper(memory=10)
    mapper.map(0, 100)
    assert mapper.map(1, 111) == 101
    assert mapper.map(12, 122) == 122
    assert mapper.map(23, 133) == 133


def exposure(
    counts: object, resolution: float = 0.01, flags: FrameFlags = FrameFlags.NONE
) -> Exposure:
    image = np.array(counts, dtype=np.uint16)
    return Exposure(
        image=image, stamp=0, resolution=resolution, frame_counter=0, flags=flags
    )


def test_counts_are_kelvin_by_resolution() -> None:
    assert celsius(exposure([[27315, 30815]]))[0] == pytest.approx(
        [0.0, 35.0], abs=1e-9
    )
    assert celsius(exposure([[3032]], resolution=0.1))[0, 0] == pytest.approx(
        30.05, abs=1e-9
    )


def test_the_statistics_of_a_rectangle_are_those_of_its_pixels() -> None:
    counts = np.full((60, 80), 27315)
    counts[10:12, 20:22] = [[30000, 30100], [30200, 30300]]
    statistics_of_region = region(exposure(counts), Region(10, 20, 2, 2))
    degrees = [26.85, 27.85, 28.85, 29.85]
    assert statistics_of_region.mean == pytest.approx(statistics.mean(degrees))
    assert statistics_of_region.variance == pytest.approx(statistics.pvariance(degrees))
    assert (
        statistics_of_region.minimum,
        statistics_of_region.maximum,
    ) == pytest.approx((26.85, 29.85))
    assert statistics_of_region.spread == pytest.approx(3.0)
    assert statistics_of_region.pixels == 4


def test_pixels_at_the_ends_of_the_range_do_not_count() -> None:
    statistics_of_region = region(exposure([[0, 30000], [65535, 30100]]))
    assert statistics_of_region.pixels == 2
    assert statistics_of_region.mean == pytest.approx(27.35)


@given(hnp.arrays(np.uint16, (6, 8), elements=st.integers(1, 65534)), st.data())
def test_a_rectangle_lies_within_the_image(
    image: np.ndarray, data: st.DataObject
) -> None:
    row = data.draw(st.integers(0, 5))
    column = data.draw(st.integers(0, 7))
    roi = Region(
        row,
        column,
        data.draw(st.integers(1, 6 - row)),
        data.draw(st.integers(1, 8 - column)),
    )
    whole = region(exposure(image))
    part = region(exposure(image), roi)
    assert whole.minimum <= part.minimum <= part.maximum <= whole.maximum
    assert part.pixels == roi.rows * roi.columns
    # Popoviciu: no variance exceeds a quarter of the spread squared.
    assert part.variance <= part.spread**2 / 4 + 1e-6


@pytest.mark.parametrize(
    "box", [(-1, 0, 1, 1), (0, -1, 1, 1), (0, 0, 0, 1), (0, 0, 1, 0)]
)
def test_an_invalid_rectangle_is_refused(box: tuple[int, int, int, int]) -> None:
    with pytest.raises(RegionError, match="start at 0 or later and contain a pixel"):
        Region(*box)


@pytest.mark.parametrize(
    ("image", "roi", "message"),
    [
        (exposure(np.ones((6, 8))), Region(5, 0, 2, 1), "leave the image of 6 by 8"),
        (exposure(np.ones((6, 8))), Region(0, 7, 1, 2), "leave the image of 6 by 8"),
        (exposure(np.zeros((6, 8))), None, "every pixel is outside"),
        (
            exposure([[1]], flags=FrameFlags.GAIN_CONTROL),
            None,
            "not temperatures; switch TLinear on",
        ),
        (
            exposure([[1]], flags=FrameFlags.NOT_RADIOMETRIC),
            None,
            "not temperatures; switch TLinear on",
        ),
    ],
)
def test_a_region_without_temperatures_is_an_error_that_says_why(
    image: Exposure, roi: Region | None, message: str
) -> None:
    with pytest.raises(RegionError, match=message):
        region(image, roi)
