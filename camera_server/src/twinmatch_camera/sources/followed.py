"""An emulated Lepton whose time is led by another program, line by line on standard input.

Each line holds the camera's time since some start in seconds, the plate's temperature in °C, and the stamp
to write into the frame in ns. Each makes one image; a line with the time of the one before repeats the
image, as a sensor that hangs does. When several lines wait, the newest counts. The end of the input ends
the camera: it cannot outlive its plate.
"""

from __future__ import annotations

import logging
import os
import select

from twinmatch.links.thermal_frame import Exposure, FrameFieldError
from twinmatch_camera.emulation import EmulatedLepton, LeptonError, LeptonSettings
from twinmatch_camera.sources.base import EndOfRecording

_log = logging.getLogger(__name__)

_LONGEST = 256


class FollowedSource:
    """Images on request, at given times."""

    def __init__(
        self,
        descriptor: int = 0,
        *,
        settings: LeptonSettings | None = None,
        seed: int = 0,
    ) -> None:
        self._descriptor = descriptor
        self._camera = EmulatedLepton(settings or LeptonSettings(), seed)
        self._start: float | None = None
        self._rest = b""

    @property
    def name(self) -> str:
        """What it is, for the log."""
        return "emulated Lepton, led by standard input"

    def open(self) -> None:
        """Nothing to do: the input is there."""

    def read(self, timeout: float) -> Exposure | None:
        """The image of the newest line."""
        if not select.select([self._descriptor], [], [], timeout)[0]:
            return None
        piece = os.read(self._descriptor, 65_536)
        if not piece:
            raise EndOfRecording("the program that led the camera has ended")
        *lines, rest = (self._rest + piece).split(b"\n")
        self._rest = rest[-_LONGEST:]
        return self._expose(lines[-1]) if lines else None

    def close(self) -> None:
        """Leave the input to its owner."""

    def _expose(self, line: bytes) -> Exposure | None:
        try:
            elapsed, plate, stamp = line.split()
            start = float(elapsed) if self._start is None else self._start
            exposure = self._camera.expose(
                float(plate), float(elapsed) - start, int(stamp)
            )
        except (ValueError, OverflowError, LeptonError, FrameFieldError) as error:
            _log.warning(
                "line %r: %s; write the time in s, the temperature in °C, the stamp in ns",
                line,
                error,
            )
            return None
        self._start = start
        return exposure
