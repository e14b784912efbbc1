"""Where the parameter files that come with twinmatch lie: in the checkout, or where it is installed."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from twinmatch.launching.processes import LaunchError

__all__ = ["shipped_config"]


def shipped_config(name: str) -> Path:
    """The file of this name in `config/`.

    Raises:
        LaunchError: neither the checkout nor the installation has it.
    """
    installed = [sys.prefix, *os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)]
    folders = [Path(__file__).resolve().parents[3] / "config"]
    folders += [Path(prefix) / "share" / "twinmatch" / "config" for prefix in installed if prefix]
    for folder in folders:
        if (folder / name).is_file():
            return folder / name
    raise LaunchError(f"{name} is in none of {', '.join(map(str, folders))}; install twinmatch again")
