"""Thin ROS 2 nodes: parameters, topics and diagnostics around the packages below; no mathematics here.

`network` binds everything to this machine before ROS starts, `runner` starts and ends nodes, and `node` is
their base class. A node's subscriptions only put messages into the queue of its `worker`, a thread that
calls the synchronous object of the core and publishes the results. `parameters` and the nodes' tables need
no ROS, so that an offline replay reads the same files.

For that reason ROS is not imported here; only a hook checks RMW_IMPLEMENTATION when it will be. The library
behind `rclpy` compares the variable with the installed middlewares; if it does not match, it prints a line
about its own source and exits with code 102, so that no `except` of ours ever runs.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from importlib.abc import MetaPathFinder
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

from twinmatch.errors import EXIT_USER_ERROR, TwinmatchError

VARIABLE = "RMW_IMPLEMENTATION"
_INDEX = Path("share", "ament_index", "resource_index", "rmw_typesupport")
_LOADER = "rmw_implementation"


def problem(
    environment: Mapping[str, str] = os.environ, wheel_prefix: str = sys.prefix
) -> str:
    """An error line if the selected middleware is not installed; empty if no problem is found.

    Args:
        environment: the variables of the process.
        wheel_prefix: prefix of a ROS 2 that was installed from wheels.
    """
    named = environment.get(VARIABLE, "")
    prefixes = environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    folders = [Path(prefix) / _INDEX for prefix in (*prefixes, wheel_prefix) if prefix]
    installed: set[str] = set()
    for folder in folders:
        if folder.is_dir():
            installed.update(file.name for file in folder.iterdir())
    installed.discard(_LOADER)
    if not named or not installed or named in installed:
        return ""
    installed_names = ", ".join(sorted(installed))
    return (
        f"network: {VARIABLE} is {named[:80]!r}, which is not installed (installed: {installed_names}); "
        "install it, or unset the variable"
    )


def require_ros(program: str, instead: str = "") -> None:
    """Check that there is what a program that runs or shows the graph imports; `instead`: what else would do.

    Raises:
        TwinmatchError: ROS 2, or our messages, cannot be found.
    """
    missing = [
        name
        for name in ("rclpy", "diagnostic_msgs", "twinmatch_msgs")
        if find_spec(name) is None
    ]
    if missing:
        raise TwinmatchError(
            f"{program} needs ROS 2: {', '.join(missing)} cannot be found; run make setup in a clone of "
            f"twinmatch, or source a ROS 2 workspace that has them{instead and f'; {instead}'}"
        )


class BeforeRos(MetaPathFinder):
    """An import hook that finds no module, but exits with a clear error line before `rclpy` would exit."""

    def find_spec(
        self,
        name: str,
        path: Sequence[str] | None = None,  # noqa: ARG002
        target: ModuleType | None = None,  # noqa: ARG002
    ) -> None:
        """Check when `rclpy` is imported."""
        if name != "rclpy":
            return
        if line := problem():
            print(line, file=sys.stderr, flush=True)
            raise SystemExit(EXIT_USER_ERROR)


sys.meta_path.insert(0, BeforeRos())
