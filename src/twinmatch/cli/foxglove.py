"""`twinmatch foxglove`: the graph served in the foreground, until Ctrl-C."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinmatch.cli.shared import add_serving_options, check_writable, serving_words


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_serving_options(parser, 8765)
    parser.add_argument(
        "--layout",
        type=Path,
        metavar="OUT",
        help="write a layout for the graph's plant to this file (.json) once the plant is described",
    )


def run(options: argparse.Namespace) -> int:
    """Serve until Ctrl-C; returns the exit code."""
    words = serving_words("foxglove", options, "foxglove", layout=options.layout)
    check_writable(options.layout, example="layout.json")
    from twinmatch.nodes.runner import run as run_nodes  # noqa: PLC0415
    from twinmatch.showing.foxglove.node import Foxglove  # noqa: PLC0415

    return run_nodes([Foxglove], words)
