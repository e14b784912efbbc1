"""What the tests of whole graphs share."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.processes import Processes


@pytest.fixture
def processes(tmp_path: Path, ros: None) -> Iterator[Processes]:  # noqa: ARG001
    """Processes in the ROS domain of this worker, which end with the test."""
    started = Processes(tmp_path / "output")
    yield started
    started.end()
