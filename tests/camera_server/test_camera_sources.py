"""The recorded and the emulated source, and the thread that reads a source."""

from __future__ import annotations

import logging
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import twinmatch_camera.sources.v4l2 as v4l2_module
from twinmatch_camera.broadcast import Broadcast
from twinmatch_camera.emulation import LeptonSettings, PlateFeed
from twinmatch_camera.errors import CameraError, SourceError
from twinmatch_camera.program import CameraThread, run
from twinmatch_camera.sources.base import EndOfRecording
from twinmatch_camera.sources.emulated import EmulatedSource
from twinmatch_camera.sources.recorded import RecordedSource
from twinmatch_camera.sources.v4l2 import V4l2Source

from tests.support.camera import decoded
from twinmatch.links.thermal_frame import Exposure, FlatField, FrameFlags, encode_frame

PATIENCE = 10.0
BOOT = b"R" * 16


def shot(counter: int, stamp: int = 0) -> Exposure:
    image = np.full((6, 8), 30000 + counter, np.uint16)
    return Exposure(image=image, stamp=stamp, resolution=0.01, frame_counter=counter)


def recording(path: Path, counters: list[int], gap_ms: int = 5) -> Path:
    frames = (
        shot(c, stamp=10**9 + i * gap_ms * 1_000_000) for i, c in enumerate(counters)
    )
    path.write_bytes(
        b"".join(encode_frame(f.numbered(i, BOOT)) for i, f in enumerate(frames))
    )
    return path


def drain(source: RecordedSource, count: int) -> list[Exposure]:
    got: list[Exposure] = []
    while len(got) < count:
        exposure = source.read(1.0)
        if exposure is not None:
            got.append(exposure)
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


def test_recordings_that_are_empty_or_damaged(tmp_path: Path) -> None:
    path = recording(tmp_path / "r", [1, 2, 3])
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))
    source = RecordedSource(path)
    source.open()
    with pytest.raises(SourceError, match="frame 2: thermal frame: checksum"):
        drain(source, 3)
    source.close()
    path.write_bytes(b"")
    source = RecordedSource(path)
    with pytest.raises(SourceError, match="holds no frame; record one first"):
        source.open()
    source.close()


# --- emulated ------------------------------------------------------------------------------------


def test_nonsense_on_the_feed_is_reported_and_skipped(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "plate.sock"
    source = EmulatedSource(feed=path, settings=LeptonSettings(rate=200.0))
    source.open()
    with (
        PlateFeed(path) as feed,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as stranger,
    ):
        stranger.sendto(b"warm", str(path))
        assert source.read(0.1) is None
        assert "b'warm' is not a temperature" in caplog.text
        feed.send(33.0)
        assert source.read(0.1) is not None
    source.close()


def test_a_frame_that_is_not_yet_due(tmp_path: Path) -> None:
    for source in (
        RecordedSource(recording(tmp_path / "r", [1, 2], gap_ms=60_000)),
        EmulatedSource(plate=30.0, settings=LeptonSettings(rate=0.1)),
    ):
        source.open()
        assert source.read(0.01) is not None
        assert source.read(0.01) is None
        source.close()


# --- the thread and the program ------------------------------------------------------------------


class Scripted:
    """A source that does what its steps do."""

    name = "script"

    def __init__(
        self, *steps: Callable[[], Exposure | None], opens: bool = True
    ) -> None:
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


def test_exposures_are_numbered_and_published_under_a_boot_id_of_this_run() -> None:
    sink = Sink()
    source = Scripted(
        lambda: shot(1),
        lambda: None,
        lambda: shot(2),
        raising(EndOfRecording("it ends")),
    )
    thread = CameraThread(source, sink)
    thread.start()
    thread.join(PATIENCE)
    frames = [decoded(message) for message in sink.messages]
    assert [(f.sequence, f.frame_counter) for f in frames] == [(0, 1), (1, 2)]
    assert {f.boot_id for f in frames} == {thread.boot_id}
    assert thread.failure is None
    assert CameraThread(Scripted(), sink).boot_id != thread.boot_id
    sink.close()


@pytest.mark.parametrize(
    "error", [SourceError("unplugged"), ZeroDivisionError("a defect")]
)
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


def test_the_end_of_a_recording_is_reported_and_signal_handlers_are_put_back(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO)
    before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)
    run(Scripted(raising(EndOfRecording("it ends"))), Broadcast("127.0.0.1", 0))
    assert caplog.messages[-2:] == ["it ends", "stopped"]
    assert (signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)) == before


# The V4L2 source above the kernel. The ioctls themselves need a video device and are not run here.


class FakeCapture:
    """A video device that has these images, then none."""

    def __init__(
        self, *images: np.ndarray | bytes, shape: tuple[int, int] = (60, 80)
    ) -> None:
        self.shape = shape
        self.closed = 0
        self._images = list(images)

    def read(self, _timeout: float) -> bytes | None:
        if not self._images:
            return None
        image = self._images.pop(0)
        return image if isinstance(image, bytes) else image.astype("<u2").tobytes()

    def close(self) -> None:
        self.closed += 1


def opened(capture: FakeCapture) -> V4l2Source:
    source = V4l2Source("/dev/video9", opener=lambda path, size: capture)  # noqa: ARG005
    source.open()
    return source


def test_images_are_numbered_as_they_change() -> None:
    images = [np.full((60, 80), level) for level in (30000, 30001, 30001, 30001, 30002)]
    source = opened(FakeCapture(*images))
    got = [source.read(0.1) for _ in images]
    assert [e.frame_counter for e in got if e] == [1, 2, 2, 2, 3]
    assert [int(e.image[0, 0]) for e in got if e] == [30000, 30001, 30001, 30001, 30002]
    assert got[0] is not None
    assert got[0].flat_field is None
    assert got[0].resolution == 0.01
    assert source.read(0.1) is None
    assert source.name == "video device /dev/video9"


def test_telemetry_in_the_last_three_rows() -> None:
    rows = np.full((63, 80), 30000)
    rows[60:] = 0
    rows[60, 3] = 2 << 4
    rows[60, 20] = 99
    rows[62, 48:50] = 1
    exposure = opened(FakeCapture(rows, shape=(63, 80))).read(0.1)
    assert exposure is not None
    assert exposure.image.shape == (60, 80)
    assert (exposure.frame_counter, exposure.flat_field) == (99, FlatField.RUNNING)


def test_an_image_cut_short_is_left_out() -> None:
    source = opened(FakeCapture(b"\0" * 4000, np.full((60, 80), 30000)))
    assert source.read(0.1) is None
    assert source.read(0.1) is not None


class Unplugged(FakeCapture):
    def read(self, _timeout: float) -> bytes | None:
        raise OSError(19, "No such device")


def test_a_device_that_falls_silent_is_unplugged_or_was_never_opened(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(v4l2_module, "_PATIENCE", -1.0)
    with pytest.raises(SourceError, match=r"no image for -1\.0 s"):
        opened(FakeCapture()).read(0.1)
    with pytest.raises(SourceError, match="No such device; is it unplugged"):
        opened(Unplugged()).read(0.1)
    with pytest.raises(SourceError, match="read before it was opened"):
        V4l2Source().read(0.1)


def test_it_is_closed_once() -> None:
    capture = FakeCapture()
    source = opened(capture)
    source.close()
    source.close()
    assert capture.closed == 1


class FakeLinuxpy(ModuleType):
    """As much of linuxpy as is used, with a pipe for a device."""

    class V4L2Error(Exception):
        pass

    class PixelFormat(Enum):
        Y16 = 1
        MJPEG = 2

    def __init__(self, *, chosen: str = "Y16", capable: bool = True) -> None:
        super().__init__("linuxpy.video.device")
        self.done: list[object] = []
        self.readable, self.writable = os.pipe()
        linuxpy = self

        class Device:
            def __init__(self, path: str) -> None:
                linuxpy.done.append(path)

            def open(self) -> None:
                linuxpy.done.append("open")

            def fileno(self) -> int:
                return linuxpy.readable

            def close(self) -> None:
                linuxpy.done.append("close")

        class VideoCapture:
            def __init__(self, _device: Device) -> None:
                self.buffer = self

            def set_format(self, width: int, height: int, code: str) -> None:
                linuxpy.done.append((width, height, code))

            def get_format(self) -> SimpleNamespace:
                return SimpleNamespace(
                    pixel_format=linuxpy.PixelFormat[chosen], width=4, height=2
                )

            def open(self) -> None:
                if not capable:
                    raise linuxpy.V4L2Error(
                        "Device doesn't have VIDEO_CAPTURE capability"
                    )
                linuxpy.done.append("on")

            def raw_read(self) -> SimpleNamespace:
                return SimpleNamespace(data=os.read(linuxpy.readable, 16))

            def close(self) -> None:
                linuxpy.done.append("off")

        self.Device = Device
        self.VideoCapture = VideoCapture

    def end(self) -> None:
        os.close(self.readable)
        os.close(self.writable)


def with_linuxpy(monkeypatch: pytest.MonkeyPatch, linuxpy: FakeLinuxpy) -> V4l2Source:
    monkeypatch.setitem(sys.modules, "linuxpy.video.device", linuxpy)
    return V4l2Source("/dev/video9", size=(4, 2))


def test_linuxpy_is_asked_to_open_stream_and_close_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    linuxpy = FakeLinuxpy()
    source = with_linuxpy(monkeypatch, linuxpy)
    source.open()
    assert source.read(0.01) is None
    os.write(linuxpy.writable, np.arange(8, dtype="<u2").tobytes())
    exposure = source.read(0.1)
    assert exposure is not None
    assert exposure.image.tolist() == [[0, 1, 2, 3], [4, 5, 6, 7]]
    source.close()
    assert linuxpy.done == ["/dev/video9", "open", (4, 2, "Y16 "), "on", "off", "close"]
    linuxpy.end()


@pytest.mark.parametrize(
    ("linuxpy", "message"),
    [
        (FakeLinuxpy(chosen="MJPEG"), "it delivers MJPEG, not Y16"),
        (FakeLinuxpy(capable=False), "doesn't have VIDEO_CAPTURE capability"),
    ],
)
def test_a_device_that_is_not_such_a_camera(
    monkeypatch: pytest.MonkeyPatch, linuxpy: FakeLinuxpy, message: str
) -> None:
    with pytest.raises(SourceError, match=message):
        with_linuxpy(monkeypatch, linuxpy).open()
    assert linuxpy.done[-1] == "close"
    linuxpy.end()


def test_the_names_asked_of_linuxpy_exist() -> None:
    linuxpy = pytest.importorskip("linuxpy.video.device")
    assert int.from_bytes(b"Y16 ", "little") == linuxpy.PixelFormat.Y16
    for name in ("set_format", "get_format", "open", "close"):
        assert callable(getattr(linuxpy.VideoCapture, name))
    assert issubclass(linuxpy.V4L2Error, Exception)


def test_linuxpy_is_asked_for_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("linuxpy.video.device")
    with pytest.raises(SourceError, match=r"/dev/no-such-video.*shows what there is"):
        V4l2Source("/dev/no-such-video").open()
    monkeypatch.setitem(sys.modules, "linuxpy.video.device", None)
    with pytest.raises(
        SourceError, match=r"install with `pip install 'twinmatch-camera\[v4l2\]'`"
    ):
        V4l2Source("/dev/video9").open()
