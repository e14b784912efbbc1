"""Find the files installed beside the package: in the checkout, or below `share/twinmatch`."""

from __future__ import annotations

import os
import site
import sys
from pathlib import Path

from twinmatch.errors import TwinmatchError


class NotShippedError(TwinmatchError):
    """Neither the checkout nor the installation has the file."""


def shipped(name: str) -> Path:
    """The file or folder of this name, such as `config/rig.yaml`.

    Searched in this order: the checkout that the package runs from, the environment, the user's own
    installation, and the prefixes of a sourced ROS 2 workspace.

    Raises:
        NotShippedError: none of them has it.
    """
    prefixes = [
        sys.prefix,
        site.getuserbase(),
        *os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep),
    ]
    folders = [Path(__file__).resolve().parents[2]]
    folders += [Path(prefix) / "share" / "twinmatch" for prefix in prefixes if prefix]
    for folder in folders:
        if (folder / name).exists():
            return folder / name
    raise NotShippedError(
        f"{name} is in none of {', '.join(map(str, folders))}; reinstall twinmatch"
    )
