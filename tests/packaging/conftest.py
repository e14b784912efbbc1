"""What the tests of packages share."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.support.places import PROJECT


@pytest.fixture(scope="session")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of what is packaged, so that a build leaves nothing behind in the project."""
    copy = tmp_path_factory.mktemp("sources")
    for name in ("setup.py", "setup.cfg", "pyproject.toml", "package.xml", "README.md"):
        shutil.copy(PROJECT / name, copy)
    for name in ("src/twinmatch", "camera_server/src", "config", "resource"):
        shutil.copytree(
            PROJECT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__")
        )
    return copy
