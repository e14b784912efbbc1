"""What colcon needs beyond pyproject.toml: the files below share/, where ROS 2 looks for a package.

`requires-python` is here too: from pyproject.toml it becomes an object that colcon cannot read.
"""

from __future__ import annotations

from pathlib import Path

from setuptools import setup

HERE = Path(__file__).resolve().parent
SHARED = sorted(
    path.relative_to(HERE)
    for path in [
        *(HERE / "config").glob("*"),
        *(HERE / "camera_server" / "src").rglob("*.py"),
    ]
    if path.is_file()
)
"""Files that are found at run time: configurations, and the camera program that the virtual rig starts."""

setup(
    python_requires=">=3.10",
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/twinmatch"]),
        ("share/twinmatch", ["package.xml"]),
        *((f"share/twinmatch/{path.parent}", [str(path)]) for path in SHARED),
    ],
)
