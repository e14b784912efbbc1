"""`twinmatch play`: a recorded session through the ROS graph."""

from __future__ import annotations

import argparse

from twinmatch.cli.shared import add_options, open_shown
from twinmatch.launching.launcher import continue_as_launcher
from twinmatch.launching.processes import add_page_options, page_of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(parser, "session")
    parser.add_argument(
        "--rate",
        type=float,
        default=50.0,
        help="times recorded speed (default: 50); 0: as fast as possible",
    )
    add_options(parser, "--candidates")
    add_options(parser, "--config", help="parameter file of the twin's nodes")
    add_options(parser, "--plant", help="the plant, if the session does not name it")
    add_page_options(parser)


def run(options: argparse.Namespace) -> int:
    """Play and show the verdicts as they come; returns the exit code: 130 if interrupted."""
    if not 0.0 <= options.rate <= 1000.0:
        options.parser.error(
            f"--rate is {options.rate:g}; it must be within 0 and 1000"
        )
    if options.is_program:
        continue_as_launcher()
    from twinmatch.launching.replay import Replay, play  # noqa: PLC0415

    session = open_shown(options.session, options.plant)
    with page_of(options, options.parser, options.config) as page:
        code = play(Replay(session, options.rate, options.candidates, options.config))
        if code == 0:
            page.stay()
        return code
