"""`twinmatch dashboard`: the page in the foreground, until Ctrl-C."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinmatch.showing.page import DashboardError
from twinmatch.showing.serving import add_serving_arguments, check_serving, namespace_words


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_serving_arguments(parser, 5006)
    parser.add_argument("--config", default="", metavar="FILE", help="parameters (.yaml) of the twin's nodes")
    parser.add_argument(
        "--control", action="store_true", help="the page may set the set-point, clear faults and stop"
    )


def run(options: argparse.Namespace) -> int:
    """Serve until Ctrl-C; returns the exit code."""
    check_serving("dashboard", options, "bokeh", DashboardError)
    from twinmatch.nodes.runner import run as run_nodes  # noqa: PLC0415
    from twinmatch.showing.page.node import Dashboard  # noqa: PLC0415 — needs ROS and Bokeh

    words = ["dashboard", "--ros-args"]
    for name in ("address", "port", "control"):
        value = getattr(options, name)
        words += ["-p", f"{name}:={str(value).lower() if isinstance(value, bool) else value}"]
    if options.config:
        words += ["-p", f"config:={Path(options.config).absolute()}"]
    words += namespace_words("dashboard", options.namespace, DashboardError)
    return run_nodes([Dashboard], words)
