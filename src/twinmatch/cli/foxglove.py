"""`twinmatch foxglove`: the graph served in the foreground, until Ctrl-C."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinmatch.showing.foxglove import FoxgloveError
from twinmatch.showing.serving import add_serving_arguments, check_serving, namespace_words


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_serving_arguments(parser, 8765)
    parser.add_argument(
        "--layout",
        type=Path,
        metavar="OUT",
        help="write a layout for the graph's plant to this file (.json) once the plant is described",
    )


def run(options: argparse.Namespace) -> int:
    """Serve until Ctrl-C; returns the exit code.

    Raises:
        FoxgloveError: a package it needs is not installed, or an option has an invalid value.
    """
    check_serving("foxglove", options, "foxglove", FoxgloveError)
    out = options.layout
    if out is not None and (out.is_dir() or not out.absolute().parent.is_dir()):
        msg = f"foxglove: {out} cannot be written; give a file in an existing folder"
        raise FoxgloveError(msg)
    from twinmatch.nodes.runner import run as run_nodes  # noqa: PLC0415
    from twinmatch.showing.foxglove.node import Foxglove  # noqa: PLC0415 — needs ROS and the SDK

    words = ["foxglove", "--ros-args", "-p", f"address:='{options.address}'", "-p", f"port:={options.port}"]
    if out is not None:
        words += ["-p", f"layout:='{out}'"]
    words += namespace_words("foxglove", options.namespace, FoxgloveError)
    return run_nodes([Foxglove], words)
