"""`twinmatch foxglove`: the graph served in the foreground, until Ctrl-C."""

from __future__ import annotations

import argparse
import importlib.util
import re

from twinmatch.foxglove.errors import FoxgloveError

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--address",
        default="127.0.0.1",
        help="serve on this address; others than 127.0.0.1 are open to others",
    )
    parser.add_argument("--port", type=int, default=8765, help="TCP port (8765); 0: any that is free")
    parser.add_argument("--namespace", default="", metavar="/RIG", help="namespace of the rig to show")


def run(options: argparse.Namespace) -> int:
    """Serve until Ctrl-C; returns the exit code.

    Raises:
        FoxgloveError: what it needs is not installed, or an option is no value it can have.
    """
    if not 0 <= options.port <= 65535:
        msg = f"foxglove: there is no port {options.port}; give one from 0 to 65535"
        raise FoxgloveError(msg)
    for name, remedy in (
        ("foxglove", "pip install 'twinmatch[foxglove]'"),
        ("rclpy", "pip install 'twinmatch[ros]'"),
    ):
        if importlib.util.find_spec(name) is None:
            msg = f"foxglove: {name} is not installed; {remedy}"
            raise FoxgloveError(msg)
    from twinmatch.foxglove.node import Foxglove  # noqa: PLC0415 — needs ROS and the SDK
    from twinmatch.nodes.runner import run as run_nodes  # noqa: PLC0415

    words = ["foxglove", "--ros-args", "-p", f"address:='{options.address}'", "-p", f"port:={options.port}"]
    if options.namespace:
        if re.fullmatch(r"(/?[A-Za-z_][A-Za-z0-9_]*)+", options.namespace) is None:
            msg = f"foxglove: {options.namespace!r} is no namespace; give one such as /rig_a"
            raise FoxgloveError(msg)
        words += ["-r", f"__ns:=/{options.namespace.removeprefix('/')}"]
    return run_nodes([Foxglove], words)
