"""`twinmatch foxglove`: the graph served in the foreground, until Ctrl-C."""

from __future__ import annotations

import argparse

from twinmatch.foxglove.errors import FoxgloveError
from twinmatch.nodes.serving import add_serving_arguments, check_serving, namespace_words

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_serving_arguments(parser, 8765)


def run(options: argparse.Namespace) -> int:
    """Serve until Ctrl-C; returns the exit code.

    Raises:
        FoxgloveError: what it needs is not installed, or an option is no value it can have.
    """
    check_serving("foxglove", options, "foxglove", FoxgloveError)
    from twinmatch.foxglove.node import Foxglove  # noqa: PLC0415 — needs ROS and the SDK
    from twinmatch.nodes.runner import run as run_nodes  # noqa: PLC0415

    words = ["foxglove", "--ros-args", "-p", f"address:='{options.address}'", "-p", f"port:={options.port}"]
    words += namespace_words("foxglove", options.namespace, FoxgloveError)
    return run_nodes([Foxglove], words)
