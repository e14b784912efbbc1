"""The one small interface between the program and a camera."""

from __future__ import annotations

from typing import Protocol

from twinmatch.links.thermal_frame import Exposure


class EndOfRecording(Exception):  # noqa: N818
    """A source has nothing more to show, which is not a fault."""


class Source(Protocol):
    """A camera."""

    @property
    def name(self) -> str:
        """What it is, for the log: `emulated Lepton`, `/dev/video0`."""

    def open(self) -> None:
        """Make it ready. Raises SourceError."""

    def read(self, timeout: float) -> Exposure | None:
        """The next exposure, or None if there is none within `timeout` seconds.

        A camera whose picture stands still (a flat-field correction) repeats its exposure with the same
        frame counter. Raises SourceError when the camera has failed, EndOfRecording when it is done.
        """

    def close(self) -> None:
        """Give it back; also after `open` has failed, and twice."""
