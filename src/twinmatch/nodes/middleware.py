"""Looks at RMW_IMPLEMENTATION before ROS does, which ends the process while it is being imported.

The library behind `rclpy` compares the variable with what it finds as soon as it is loaded, writes a line
about its own source and exits with code 102: no `except` of ours would ever run. So the look is taken when
somebody is about to import `rclpy`; what needs no ROS, such as reading parameters, is left alone.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from importlib.abc import MetaPathFinder
from pathlib import Path
from types import ModuleType

from twinmatch.errors import EXIT_USER_ERROR

__all__ = ["BeforeRos", "problem"]

VARIABLE = "RMW_IMPLEMENTATION"
_INDEX = Path("share", "ament_index", "resource_index", "rmw_typesupport")
_LOADER = "rmw_implementation"


def problem(environment: Mapping[str, str] = os.environ, own: str = sys.prefix) -> str:
    """What is wrong with the middleware that is named, as a line; empty: nothing, as far as one can see.

    Args:
        environment: the variables of the process.
        own: where ROS 2 is if it comes from wheels.
    """
    named = environment.get(VARIABLE, "")
    prefixes = environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    folders = [Path(prefix) / _INDEX for prefix in (*prefixes, own) if prefix]
    found = {file.name for folder in folders if folder.is_dir() for file in folder.iterdir()} - {_LOADER}
    if not named or not found or named in found:
        return ""
    there = ", ".join(sorted(found))
    return (
        f"network: {VARIABLE} is {named[:80]!r}, which is not installed; there is {there}. "
        "Install it, or unset the variable"
    )


class BeforeRos(MetaPathFinder):
    """Finds no module; ends the program in one line where importing `rclpy` would end it in another."""

    def find_spec(
        self,
        name: str,
        path: Sequence[str] | None = None,  # noqa: ARG002 - the import system gives it
        target: ModuleType | None = None,  # noqa: ARG002
    ) -> None:
        """Take the look when ROS is asked for."""
        if name != "rclpy":
            return
        if line := problem():
            print(line, file=sys.stderr, flush=True)
            raise SystemExit(EXIT_USER_ERROR)
