"""Frames from a file, at the pace they were taken.

The file is what a client of this program receives, byte for byte: a CBOR sequence of frames. So
`nc camera 5580 > plate.cborseq` records one.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

from twinmatch.links.thermal_frame import (
    Exposure,
    FrameError,
    FrameFlags,
    ThermalFrame,
    read_frame,
)
from twinmatch_camera.errors import SourceError
from twinmatch_camera.sources.base import EndOfRecording

_PAUSE_BETWEEN_ROUNDS = 0.2


class _Ended(Exception):  # noqa: N818
    """The file ends."""


class RecordedSource:
    """Plays a recording once, or again and again.

    Stamps are of now. Frame counters continue over the rounds, so that each round's frames count as new.
    """

    def __init__(self, path: str | Path, *, loop: bool = False) -> None:
        self._path = Path(path)
        self._loop = loop
        self._file: BinaryIO | None = None
        self._first = 0
        self._start = 0
        self._next: ThermalFrame | None = None
        self._counter_shift = 0
        self._last_counter = 0
        self._frames = 0

    @property
    def name(self) -> str:
        """What it is, for the log."""
        return f"recording {self._path}"

    def open(self) -> None:
        """Open the file and read its first frame."""
        try:
            self._file = self._path.open("rb")
        except OSError as error:
            raise SourceError(
                f"recording {self._path}: {error.strerror}; give a file of frames"
            ) from error
        self._next = self._load()
        if self._next is None:
            raise SourceError(
                f"recording {self._path}: it holds no frame; record one first"
            )
        self._begin_round(self._next, time.monotonic_ns())

    def read(self, timeout: float) -> Exposure | None:
        """The next frame when its time has come."""
        frame = self._next
        if frame is None:
            raise EndOfRecording(
                f"recording {self._path} ends after {self._frames} frames"
            )
        wait = (self._start + frame.stamp - self._first - time.monotonic_ns()) / 1e9
        if wait > timeout:
            time.sleep(timeout)
            return None
        if wait > 0:
            time.sleep(wait)
        counter = self._last_counter = (
            frame.frame_counter + self._counter_shift
        ) % 2**32
        self._frames += 1
        self._advance()
        flags = frame.flags | FrameFlags.RECORDED
        return replace(
            frame, stamp=time.monotonic_ns(), frame_counter=counter, flags=flags
        )

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _advance(self) -> None:
        self._next = self._load()
        if self._next is None and self._loop and self._file is not None:
            self._file.seek(0)
            self._next = self._load()
            if self._next is not None:
                self._counter_shift = self._last_counter + 1 - self._next.frame_counter
                self._begin_round(
                    self._next, time.monotonic_ns() + round(_PAUSE_BETWEEN_ROUNDS * 1e9)
                )

    def _begin_round(self, frame: ThermalFrame, start: int) -> None:
        self._first = frame.stamp
        self._start = start

    def _load(self) -> ThermalFrame | None:
        """The next frame, or None at the end of the file, be it between frames or in the midst of one."""
        try:
            return read_frame(self._read)
        except _Ended:
            return None
        except FrameError as error:
            raise SourceError(
                f"recording {self._path}, frame {self._frames + 1}: {error}"
            ) from error

    def _read(self, count: int) -> bytes:
        piece = b"" if self._file is None else self._file.read(count)
        if len(piece) < count:
            raise _Ended
        return piece
