"""What colcon needs beyond pyproject.toml: the files below share/, where ROS 2 looks for a package.

`requires-python` is here too: from pyproject.toml it becomes an object that colcon cannot read.
"""

from __future__ import annotations

from pathlib import Path

from setuptools import setup

HERE = Path(__file__).resolve().parent
CONFIG = [f"config/{path.name}" for path in sorted((HERE / "config").glob("*")) if path.is_file()]

setup(
    python_requires=">=3.10",
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/twinmatch"]),
        ("share/twinmatch", ["package.xml"]),
        ("share/twinmatch/config", CONFIG),
    ],
)
