"""`twinmatch replay`: one session or many, judged offline."""

from __future__ import annotations

import argparse
import gc
from pathlib import Path

from twinmatch.errors import TwinmatchError
from twinmatch.offline.archive import program as archive
from twinmatch.offline.options import add_terms
from twinmatch.offline.outputs import check_writable
from twinmatch.offline.progress import Progress

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "sessions",
        type=Path,
        nargs="+",
        metavar="SESSION",
        help="session folder, .mcap file, recording (.mat, .csv), folder of any of these, or pattern",
    )
    parser.add_argument("--json", type=Path, metavar="OUT", help="write every verdict to this file")
    parser.add_argument("--figure", type=Path, metavar="OUT", help="draw the verdict (.png, .svg or .pdf)")
    add_terms(parser)
    archive.add_options(parser)


def run(options: argparse.Namespace) -> int:
    """Judge and show; returns the exit code.

    Raises:
        TwinmatchError: a session or a file that the options name cannot be used.
    """
    check_writable(options.json, options.figure)
    if archive.is_archive(options):
        if options.allow_fmu is not None:
            msg = "--allow-fmu works with one session; for several, set allow_fmu in the file of --config"
            raise TwinmatchError(msg)
        with Progress() as progress:
            judged = archive.judge(options, progress.advance)
        return archive.show(options, judged)
    gc.set_threshold(50_000)  # start-up creates many objects and hardly any garbage
    from twinmatch.cli.replay_one import replay  # noqa: PLC0415 — keeps --help fast

    replay(options.sessions[0], options)
    return 0
