"""A video device that delivers Y16, such as a Lepton behind a PureThermal board.

A device with 63 rows of 80 delivers telemetry in the last three; any other does not tell about
flat-field corrections, and then an image that repeats the one before to the last count is taken for a
picture that stands still. linuxpy speaks to the kernel; everything else is here.
"""

from __future__ import annotations

import select
import time
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from twinmatch.links.thermal_frame import CountArray, Exposure
from twinmatch_camera.errors import SourceError
from twinmatch_camera.sources.telemetry import exposure

_PATIENCE = 5.0
_TELEMETRY_SHAPE = (63, 80)
_VIDEO_ROWS = 60


class Capture(Protocol):
    """A video device that has been opened for Y16."""

    shape: tuple[int, int]
    """Rows and columns, telemetry included."""

    def read(self, timeout: float) -> bytes | None:
        """The next image as little-endian uint16, None if none comes in time. Raises OSError."""

    def close(self) -> None:
        """Stop the stream and give the device back."""


class V4l2Source:
    """Passes on what a video device delivers."""

    def __init__(
        self,
        device: str = "/dev/video0",
        *,
        size: tuple[int, int] = (80, 60),
        resolution: float = 0.01,
        opener: Callable[[str, tuple[int, int]], Capture] | None = None,
    ) -> None:
        self._device = device
        self._size = size
        self._resolution = resolution
        self._opener = opener or _LinuxCapture
        self._capture: Capture | None = None
        self._last: CountArray | None = None
        self._counter = 0
        self._last_frame = 0.0

    @property
    def name(self) -> str:
        """What it is, for the log."""
        return f"video device {self._device}"

    def open(self) -> None:
        """Open the device for Y16 and start its stream."""
        try:
            self._capture = self._opener(self._device, self._size)
        except ImportError as error:
            msg = f"video device {self._device}: {error}; install with `pip install 'twinmatch-camera[v4l2]'`"
            raise SourceError(msg) from error
        except OSError as error:
            msg = f"video device {self._device}: {error}; `v4l2-ctl --list-devices` shows what there is"
            raise SourceError(msg) from error
        self._last_frame = time.monotonic()

    def read(self, timeout: float) -> Exposure | None:
        """The next image."""
        if self._capture is None:
            raise SourceError(f"video device {self._device}: read before it was opened")
        try:
            data = self._capture.read(timeout)
        except OSError as error:
            raise SourceError(
                f"video device {self._device}: {error}; is it unplugged?"
            ) from error
        now = time.monotonic()
        if data is None:
            if now - self._last_frame > _PATIENCE:
                raise SourceError(
                    f"video device {self._device}: no image for {_PATIENCE} s"
                )
            return None
        self._last_frame = now
        rows, columns = self._capture.shape
        if len(data) != 2 * rows * columns:
            return None  # a frame the USB transfer cut short; the next one comes
        counts = np.frombuffer(data, dtype="<u2").reshape(rows, columns).copy()
        if counts.shape == _TELEMETRY_SHAPE:
            return exposure(
                counts[:_VIDEO_ROWS].copy(), counts[_VIDEO_ROWS:], time.monotonic_ns()
            )
        if self._last is None or not np.array_equal(counts, self._last):
            self._counter = (self._counter + 1) % 2**32
        self._last = counts
        return Exposure(
            image=counts,
            stamp=time.monotonic_ns(),
            resolution=self._resolution,
            frame_counter=self._counter,
        )

    def close(self) -> None:
        """Give the device back."""
        if self._capture is not None:
            self._capture.close()
            self._capture = None


class _LinuxCapture:
    """The kernel's side, by linuxpy."""

    def __init__(self, path: str, size: tuple[int, int]) -> None:
        from linuxpy.video.device import Device, PixelFormat, V4L2Error, VideoCapture  # noqa: PLC0415

        self._device: Any = Device(path)
        self._device.open()
        try:
            self._stream: Any = VideoCapture(self._device)
            self._stream.set_format(*size, "Y16 ")
            chosen = self._stream.get_format()
            if chosen.pixel_format != PixelFormat.Y16:
                raise OSError(f"it delivers {chosen.pixel_format.name}, not Y16")
            self.shape = (int(chosen.height), int(chosen.width))
            self._stream.open()
        except BaseException as error:
            self._device.close()
            if isinstance(error, V4L2Error):
                raise OSError(str(error)) from error
            raise

    def read(self, timeout: float) -> bytes | None:
        ready, _, _ = select.select([self._device.fileno()], [], [], timeout)
        return bytes(self._stream.buffer.raw_read().data) if ready else None

    def close(self) -> None:
        self._stream.close()
        self._device.close()
