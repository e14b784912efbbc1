"""The camera program in a process of its own."""

from __future__ import annotations

import os

from tests.support.places import CAMERA_PATHS
from tests.support.processes import Process, Processes


class CameraProgram:
    """A started camera program: `CameraProgram(processes, "emulated", "--plate", "40")`."""

    def __init__(self, processes: Processes, *arguments: str, listen: str | None = "127.0.0.1:0") -> None:
        """Start it on a free port of this computer, or at the given address; None says nothing."""
        extra = () if listen is None else ("--listen", listen)
        environment = {**os.environ, "PYTHONPATH": CAMERA_PATHS}
        command = ("-m", "twinmatch_camera", *arguments, *extra)
        self.process: Process = processes.python(*command, environment=environment)

    @property
    def port(self) -> int:
        """Where it serves; waits until it does."""
        return int(self.process.said(r"serving .* on .*:(\d+)$")[1])
