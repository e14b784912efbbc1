"""Where things are in the project."""

from __future__ import annotations

import os
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]
TESTS = PROJECT / "tests"
SHIPPED = PROJECT / "bags" / "four_setpoints"
"""The sample session."""
RECORDINGS = Path(os.environ.get("TWINMATCH_RECORDINGS", PROJECT.parent / "shared" / "rig_recordings"))
"""Hours of the real rig. They have no licence for copying, so they stay outside the project."""
OTHERS = Path(os.environ.get("TWINMATCH_PLANT_RECORDINGS", RECORDINGS.parent / "plant_recordings"))
"""Recordings of other people's plants, likewise."""
LAUNCH_SCRIPTS = PROJECT / "launch_scripts"
CAMERA_PATHS = os.pathsep.join([str(PROJECT / "camera_server" / "src"), str(PROJECT / "src")])
"""PYTHONPATH of the camera program, which is a distribution of its own."""
CHROMIUM = (
    *("--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update"),
)
"""Options of a browser that reaches nobody."""
