"""The camera program in a process of its own, and a frame from its bytes."""

from __future__ import annotations

import os
from io import BytesIO

from tests.support.places import CAMERA_PATHS
from tests.support.processes import Process, Processes
from twinmatch.links.thermal_frame import (
    FrameSyntaxError,
    ThermalEndError,
    ThermalFrame,
    read_frame,
)


def decoded(data: bytes) -> ThermalFrame:
    """The only frame in some bytes, as a client reads it from a connection that then ends."""
    stream = BytesIO(data)

    def read(count: int) -> bytes:
        piece = stream.read(count)
        if len(piece) < count:
            raise ThermalEndError("the bytes end")
        return piece

    frame = read_frame(read)
    if stream.read():
        raise FrameSyntaxError("bytes follow")
    return frame


class CameraProgram:
    """A started camera program: `CameraProgram(processes, "emulated", "--plate", "40")`."""

    def __init__(
        self, processes: Processes, *arguments: str, listen: str | None = "127.0.0.1:0"
    ) -> None:
        """Start it on a free port of this computer, or at the given address; None says nothing."""
        extra = () if listen is None else ("--listen", listen)
        environment = {**os.environ, "PYTHONPATH": CAMERA_PATHS}
        command = ("-m", "twinmatch_camera", *arguments, *extra)
        self.process: Process = processes.python(*command, environment=environment)

    @property
    def port(self) -> int:
        """Where it serves; waits until it does."""
        return int(self.process.said(r"serving .* on .*:(\d+)$")[1])
