"""Where things are in the project."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]
TESTS = PROJECT / "tests"
SHIPPED = PROJECT / "bags" / "four_setpoints"
"""The sample session."""
RECORDINGS = Path(
    os.environ.get("TWINMATCH_RECORDINGS", PROJECT.parent / "shared" / "rig_recordings")
)
"""Hours of the real rig. They have no licence for copying, so they stay outside the project."""
OTHERS = Path(
    os.environ.get("TWINMATCH_PLANT_RECORDINGS", RECORDINGS.parent / "plant_recordings")
)
"""Recordings of other people's plants, likewise."""
LAUNCH_SCRIPTS = PROJECT / "launch_scripts"
CAMERA_PATHS = os.pathsep.join(
    [str(PROJECT / "camera_server" / "src"), str(PROJECT / "src")]
)
"""PYTHONPATH of the camera program, which is a distribution of its own."""
CHROMIUM = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-sync",
    "--disable-background-networking",
    "--disable-component-update",
)
"""Options of a browser that reaches nobody."""
_TEMPORARY: list[Path] = []


def temporary_folder() -> Path:
    """A new folder for what is made once for many tests; it is removed when this process has run its tests.

    At the exit of a process would be too late: a worker of pytest-xdist has none.
    """
    _TEMPORARY.append(Path(tempfile.mkdtemp(prefix="twinmatch-tests-")))
    return _TEMPORARY[-1]


def remove_temporary_folders() -> None:
    """Remove them."""
    for folder in _TEMPORARY:
        shutil.rmtree(folder, ignore_errors=True)
    _TEMPORARY.clear()
