"""The recorded and the emulated source, and the thread that reads a source."""

from __future__ import annotations

import logging
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from twinmatch_camera.broadcast import Broadcast
from twinmatch_camera.errors import CameraError, SourceError
from twinmatch_camera.program import CameraThread, run
from twinmatch_camera.sources.base import EndOfRecording
from twinmatch_camera.sources.emulated import EmulatedSource
from twinmatch_camera.sources.recorded import RecordedSource

from twinmatch.emulation.lepton import LeptonSettings, PlateFeed
from twinmatch.links.thermal_frame import Exposure, FrameFlags, decode_frame, encode_frame

PATIENCE = 10.0
BOOT = b"R" * 16


def shot(counter: int, stamp: int = 0) -> Exposure:
    image = np.full((6, 8), 30000 + counter, np.uint16)
    return Exposure(image=image, stamp=stamp, resolution=0.01, frame_counter=counter)


def recording(path: Path, counters: list[int], gap_ms: int = 5) -> Path:
    frames = (shot(c, stamp=10**9 + i * gap_ms * 1_000_000) for i, c in enumerate(counters))
    path.write_bytes(b"".join(encode_frame(f.numbered(i, BOOT)) for i, f in enumerate(frames)))
    return path


def drain(source: RecordedSource, count: int) -> list[Exposure]:
    got: list[Exposure] = []
    while len(got) < count:
        found = source.read(1.0)
        if found is not None:
            got.append(found)
    return got


# --- recorded ------------------------------------------------------------------------------------


def test_a_recording_keeps_its_pace_and_says_what_it_is(tmp_path: Path) -> None:
    source = RecordedSource(recording(tmp_path / "r", [5, 6, 6, 7], gap_ms=30))
    source.open()
    start = time.monotonic_ns()
    got = drain(source, 4)
    assert [e.frame_counter for e in got] == [5, 6, 6, 7]
    assert [int(e.image[0, 0]) for e in got] == [30005, 30006, 30006, 30007]
    assert all(FrameFlags.RECORDED in e.flags for e in got)
    assert got[-1].stamp - start >= 85_000_000
    assert [e.stamp for e in got] == sorted(e.stamp for e in got)
    with pytest.raises(EndOfRecording, match="ends after 4 frames"):
        source.read(0.1)
    source.close()


def test_counters_continue_over_the_rounds(tmp_path: Path) -> None:
    source = RecordedSource(recording(tmp_path / "r", [5, 6]), loop=True)
    source.open()
    assert [e.frame_counter for e in drain(source, 6)] == [5, 6, 7, 8, 9, 10]
    source.close()


def test_a_frame_that_is_not_yet_due(tmp_path: Path) -> None:
    source = RecordedSource(recording(tmp_path / "r", [1, 2], gap_ms=60_000))
    source.open()
    assert source.read(0.01) is not None
    assert source.read(0.01) is None
    source.close()


def test_a_recording_without_a_frame(tmp_path: Path) -> None:
    (tmp_path / "r").write_bytes(b"")
    source = RecordedSource(tmp_path / "r")
    with pytest.raises(SourceError, match="holds no frame; record one first"):
        source.open()
    source.close()


def test_a_damaged_recording(tmp_path: Path) -> None:
    path = recording(tmp_path / "r", [1, 2, 3])
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))
    source = RecordedSource(path)
    source.open()
    with pytest.raises(SourceError, match="frame 2: thermal frame: checksum"):
        drain(source, 3)
    source.close()


# --- emulated ------------------------------------------------------------------------------------


def test_nonsense_on_the_feed_is_reported_and_skipped(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "plate.sock"
    source = EmulatedSource(feed=path, settings=LeptonSettings(rate=200.0))
    source.open()
    with PlateFeed(path) as feed:
        feed._socket.sendto(b"warm", str(path))
        assert source.read(0.1) is None
        assert "b'warm' is not a temperature" in caplog.text
        feed.send(33.0)
        assert source.read(0.1) is not None
    source.close()


def test_an_image_that_is_not_yet_due() -> None:
    source = EmulatedSource(plate=30.0, settings=LeptonSettings(rate=0.1))
    source.open()
    assert source.read(0.01) is not None
    assert source.read(0.01) is None
    source.close()


# --- the thread and the program ------------------------------------------------------------------


class Scripted:
    """A source that does what its steps do."""

    name = "script"

    def __init__(self, *steps: Callable[[], Exposure | None], opens: bool = True) -> None:
        self._steps = list(steps)
        self._opens = opens
        self.closed = threading.Event()

    def open(self) -> None:
        if not self._opens:
            raise SourceError("no camera here; plug it in")

    def read(self, timeout: float) -> Exposure | None:
        if self._steps:
            return self._steps.pop(0)()
        time.sleep(min(timeout, 0.01))
        return None

    def close(self) -> None:
        self.closed.set()


class Sink(Broadcast):
    """Keeps what is published."""

    def __init__(self) -> None:
        super().__init__("127.0.0.1", 0)
        self.messages: list[bytes] = []

    def publish(self, message: bytes) -> None:
        self.messages.append(message)


def raising(error: BaseException) -> Callable[[], Exposure]:
    def step() -> Exposure:
        raise error

    return step


def test_exposures_are_numbered_and_published() -> None:
    sink = Sink()
    source = Scripted(lambda: shot(1), lambda: None, lambda: shot(2), raising(EndOfRecording("it ends")))
    thread = CameraThread(source, sink)
    thread.start()
    thread.join(PATIENCE)
    frames = [decode_frame(message) for message in sink.messages]
    assert [(f.sequence, f.frame_counter) for f in frames] == [(0, 1), (1, 2)]
    assert {f.boot_id for f in frames} == {thread.boot_id}
    assert thread.failure is None
    sink.close()


def test_every_run_has_its_own_boot_id() -> None:
    sink = Sink()
    assert CameraThread(Scripted(), sink).boot_id != CameraThread(Scripted(), sink).boot_id
    sink.close()


@pytest.mark.parametrize("error", [SourceError("unplugged"), ZeroDivisionError("a defect")])
def test_a_source_that_fails_ends_the_program(error: Exception) -> None:
    source = Scripted(lambda: shot(1), raising(error))
    with pytest.raises(type(error), match=str(error)):
        run(source, Broadcast("127.0.0.1", 0))
    assert source.closed.is_set()


def test_a_source_that_does_not_open_gives_everything_back() -> None:
    source = Scripted(opens=False)
    broadcast = Broadcast("127.0.0.1", 0)
    _, port = broadcast.address
    with pytest.raises(CameraError, match="plug it in"):
        run(source, broadcast)
    assert source.closed.is_set()
    Broadcast("127.0.0.1", port).close()


def test_the_end_of_a_recording_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    run(Scripted(raising(EndOfRecording("it ends"))), Broadcast("127.0.0.1", 0))
    assert caplog.messages[-2:] == ["it ends", "stopped"]


def test_signal_handlers_are_put_back() -> None:
    before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)
    run(Scripted(raising(EndOfRecording("it ends"))), Broadcast("127.0.0.1", 0))
    assert (signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)) == before
