"""The V4L2 source above the kernel. The ioctls themselves need a video device and are not run here."""

from __future__ import annotations

import os
import sys
from enum import Enum
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import twinmatch_camera.sources.v4l2 as v4l2_module
from twinmatch_camera.errors import SourceError
from twinmatch_camera.sources.v4l2 import V4l2Source

from twinmatch.links.thermal_frame import FlatField


class FakeCapture:
    """A video device that has these images, then none."""

    def __init__(self, *images: np.ndarray | bytes, shape: tuple[int, int] = (60, 80)) -> None:
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
    rows[60, 3], rows[60, 20], rows[62, 48], rows[62, 49] = 2 << 4, 99, 1, 1
    found = opened(FakeCapture(rows, shape=(63, 80))).read(0.1)
    assert found is not None
    assert found.image.shape == (60, 80)
    assert (found.frame_counter, found.flat_field) == (99, FlatField.RUNNING)


def test_an_image_cut_short_is_left_out() -> None:
    source = opened(FakeCapture(b"\0" * 4000, np.full((60, 80), 30000)))
    assert source.read(0.1) is None
    assert source.read(0.1) is not None


def test_a_device_that_falls_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(v4l2_module, "_PATIENCE", -1.0)
    with pytest.raises(SourceError, match=r"no image for -1\.0 s"):
        opened(FakeCapture()).read(0.1)


def test_a_device_that_is_unplugged() -> None:
    class Unplugged(FakeCapture):
        def read(self, _timeout: float) -> bytes | None:
            raise OSError(19, "No such device")

    with pytest.raises(SourceError, match="No such device; is it unplugged"):
        opened(Unplugged()).read(0.1)


def test_read_before_open_and_close_twice() -> None:
    with pytest.raises(SourceError, match="read before it was opened"):
        V4l2Source().read(0.1)
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
                return SimpleNamespace(pixel_format=linuxpy.PixelFormat[chosen], width=4, height=2)

            def open(self) -> None:
                if not capable:
                    raise linuxpy.V4L2Error("Device doesn't have VIDEO_CAPTURE capability")
                linuxpy.done.append("on")

            def raw_read(self) -> SimpleNamespace:
                return SimpleNamespace(data=os.read(linuxpy.readable, 16))

            def close(self) -> None:
                linuxpy.done.append("off")

        self.Device, self.VideoCapture = Device, VideoCapture

    def end(self) -> None:
        os.close(self.readable)
        os.close(self.writable)


def with_linuxpy(monkeypatch: pytest.MonkeyPatch, linuxpy: FakeLinuxpy) -> V4l2Source:
    monkeypatch.setitem(sys.modules, "linuxpy.video.device", linuxpy)
    return V4l2Source("/dev/video9", size=(4, 2))


def test_what_is_asked_of_linuxpy(monkeypatch: pytest.MonkeyPatch) -> None:
    linuxpy = FakeLinuxpy()
    source = with_linuxpy(monkeypatch, linuxpy)
    source.open()
    assert source.read(0.01) is None
    os.write(linuxpy.writable, np.arange(8, dtype="<u2").tobytes())
    found = source.read(0.1)
    assert found is not None
    assert found.image.tolist() == [[0, 1, 2, 3], [4, 5, 6, 7]]
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
    monkeypatch.setitem(sys.modules, "linuxpy.video.device", None)
    with pytest.raises(SourceError, match=r"install with `pip install 'twinmatch-camera\[v4l2\]'`"):
        V4l2Source("/dev/video9").open()


def test_no_such_device() -> None:
    pytest.importorskip("linuxpy.video.device")
    with pytest.raises(SourceError, match=r"/dev/no-such-video.*shows what there is"):
        V4l2Source("/dev/no-such-video").open()
