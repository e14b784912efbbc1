"""The camera program is a distribution of its own; its sources are put on the path here."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]
SOURCES = PROJECT / "camera_server" / "src"
sys.path.insert(0, str(SOURCES))


class CameraProcess:
    """The camera program in a process, with what it says."""

    def __init__(self, *arguments: str) -> None:
        paths = [str(SOURCES), str(PROJECT / "src")]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "twinmatch_camera", *arguments],
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        )
        self.lines: list[str] = []
        self._said = threading.Condition()
        self._ended = False
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            with self._said:
                self.lines.append(line.rstrip())
                self._said.notify_all()
        with self._said:
            self._ended = True
            self._said.notify_all()

    def said(self, pattern: str, timeout: float = 20.0) -> re.Match[str]:
        """Wait for a line that matches."""

        def found() -> re.Match[str] | None:
            return next((m for m in (re.search(pattern, line) for line in self.lines) if m), None)

        with self._said:
            self._said.wait_for(lambda: found() or self._ended, timeout)
            match = found()
        assert match, f"no line matches {pattern!r} in {self.lines}"
        return match

    @property
    def port(self) -> int:
        return int(self.said(r"serving .* on .*:(\d+)$")[1])

    def end(self) -> int:
        """Exit code, after everything it said was read."""
        code = self.process.wait(20)
        self._thread.join(20)
        return code

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.end()
        assert self.process.stderr is not None
        self.process.stderr.close()


@pytest.fixture
def camera() -> Iterator[Callable[..., CameraProcess]]:
    """Start the camera program on a free port of this computer: `camera("emulated", "--plate", "40")`."""
    started: list[CameraProcess] = []

    def start(*arguments: str, listen: str | None = "127.0.0.1:0") -> CameraProcess:
        extra = () if listen is None else ("--listen", listen)
        started.append(CameraProcess(*arguments, *extra))
        return started[-1]

    yield start
    for process in started:
        process.close()
