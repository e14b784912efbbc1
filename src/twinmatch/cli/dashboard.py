"""`twinmatch dashboard`: the page in the foreground, until Ctrl-C."""

from __future__ import annotations

import argparse

from twinmatch.cli.shared import (
    add_goal_options,
    add_options,
    add_serving_options,
    goal_of,
    serving_words,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_serving_options(parser, 5006)
    add_options(parser, "--config", help="parameters (.yaml) of the twin's nodes")
    parser.add_argument(
        "--tell",
        metavar="URL",
        help="publish what it shows to an MQTT broker, such as mqtt://HOST",
    )
    add_goal_options(parser)
    parser.add_argument(
        "--control",
        action="store_true",
        help="the page may set the set-point, clear faults and stop",
    )


def run(options: argparse.Namespace) -> int:
    """Serve until Ctrl-C; returns the exit code."""
    config = options.config and options.config.absolute()
    parameters = {"control": options.control, "config": config, "tell": options.tell}
    if options.reach is not None:
        goal = goal_of(options)
        parameters |= {"reach": str(goal.level), "by": goal.by}
    words = serving_words("dashboard", options, "bokeh", **parameters)
    from twinmatch.nodes.runner import run as run_nodes  # noqa: PLC0415
    from twinmatch.showing.page.node import Dashboard  # noqa: PLC0415

    return run_nodes([Dashboard], words)
