"""`twinmatch dashboard`: the page in the foreground, until Ctrl-C."""

from __future__ import annotations

import argparse
import importlib.util
import re
from pathlib import Path

from twinmatch.dashboard.errors import DashboardError

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--address",
        default="127.0.0.1",
        help="serve on this address; others than 127.0.0.1 are open to others",
    )
    parser.add_argument("--port", type=int, default=5006, help="TCP port (5006); 0: any that is free")
    parser.add_argument("--config", default="", metavar="FILE", help="parameters (.yaml) of the twin's nodes")
    parser.add_argument(
        "--control", action="store_true", help="the page may set the set-point, clear faults and stop"
    )
    parser.add_argument("--namespace", default="", metavar="/RIG", help="namespace of the rig to show")


def run(options: argparse.Namespace) -> int:
    """Serve until Ctrl-C; returns the exit code.

    Raises:
        DashboardError: what it needs is not installed, or an option is no value it can have.
    """
    if not 0 <= options.port <= 65535:
        msg = f"dashboard: there is no port {options.port}; give one from 0 to 65535"
        raise DashboardError(msg)
    for name, remedy in (
        ("bokeh", "pip install 'twinmatch[dashboard]'"),
        ("rclpy", "pip install 'twinmatch[ros]'"),
    ):
        if importlib.util.find_spec(name) is None:
            msg = f"dashboard: {name} is not installed; {remedy}"
            raise DashboardError(msg)
    from twinmatch.dashboard.node import Dashboard  # noqa: PLC0415 — needs ROS and Bokeh
    from twinmatch.nodes.runner import run as run_nodes  # noqa: PLC0415

    words = ["dashboard", "--ros-args"]
    for name in ("address", "port", "control"):
        value = getattr(options, name)
        words += ["-p", f"{name}:={str(value).lower() if isinstance(value, bool) else value}"]
    if options.config:
        words += ["-p", f"config:={Path(options.config).absolute()}"]
    if options.namespace:
        if re.fullmatch(r"(/?[A-Za-z_][A-Za-z0-9_]*)+", options.namespace) is None:
            msg = f"dashboard: {options.namespace!r} is no namespace; give one such as /rig_a"
            raise DashboardError(msg)
        words += ["-r", f"__ns:=/{options.namespace.removeprefix('/')}"]
    return run_nodes([Dashboard], words)
