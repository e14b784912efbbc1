"""`twinmatch apply`: have the running controller try another law, watched, with a way back."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinmatch.cli.shared import node_words, positive
from twinmatch.sessions.documents import read_text


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Asks the twin that runs beside the plant whether a PID may be run now, as try-controller does, and "
        "after your word has the controller run it within predicted bands. If it misses them, or the guard "
        "acts, the law before drives again by itself. Exit code: 0 kept, 1 not run or back, 3 undecided."
    )
    law = "a document of kind pid (.json), as for try-controller; leave it out with --back"
    parser.add_argument("law", type=Path, nargs="?", metavar="LAW", help=law)
    shadow = "compute it beside the law that runs for so many seconds before it drives"
    parser.add_argument(
        "--shadow",
        type=positive(float, "a number of seconds"),
        metavar="S",
        help=shadow,
    )
    parser.add_argument(
        "--although", action="store_true", help="run it although it is not found safe"
    )
    parser.add_argument(
        "--yes", action="store_true", help="do not ask again before it is run"
    )
    parser.add_argument(
        "--back", action="store_true", help="give the law before back, at once"
    )


def run(options: argparse.Namespace) -> int:
    """Ask, run and follow it; returns the exit code.

    Raises:
        TwinmatchError: the document cannot be read.
    """
    if (options.law is None) != options.back:
        options.parser.error("give a LAW, or --back alone")
    asked = (
        {}
        if options.back
        else {
            "law": read_text(options.law),
            "although": options.although,
            "shadow": options.shadow,
            "yes": options.yes,
        }
    )
    from twinmatch.nodes.runner import run as run_nodes  # noqa: PLC0415
    from twinmatch.showing.asking import LawAsking, LawBack  # noqa: PLC0415

    return run_nodes(
        [LawBack if options.back else LawAsking], node_words("apply", asked)
    )
