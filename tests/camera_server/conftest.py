"""The camera program in processes that end with the test."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from tests.support.camera import CameraProgram
from tests.support.processes import Processes


@pytest.fixture
def camera(tmp_path: Path) -> Iterator[Callable[..., CameraProgram]]:
    """Start the camera program: `camera("emulated", "--plate", "40")`."""
    processes = Processes(tmp_path / "cameras")
    yield partial(CameraProgram, processes)
    processes.end()
