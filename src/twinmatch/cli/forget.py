"""`twinmatch forget`: take sessions out of a memory."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from twinmatch.cli.shared import add_options, exit_code
from twinmatch.memory import Memory, default_files


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "sessions",
        nargs="+",
        metavar="SESSION",
        help="name or path of a remembered session",
    )
    add_options(
        parser, "--memory", help="the memory (default: all in the user's data folder)"
    )


def run(options: argparse.Namespace) -> int:
    """Forget them; returns the exit code: 0 all, 3 some are not remembered, 2 none is."""
    memories = [
        Memory(file)
        for file in ([options.memory] if options.memory else default_files())
    ]
    missing = 0
    for session in options.sessions:
        names = {session, Path(session).name, Path(session).stem}
        gone = {name for memory in memories for name in memory.forget(names)}
        missing += not gone
        for name in sorted(gone):
            print(f"{name}: forgotten")
        if not gone:
            print(f"twinmatch: {session}: is not remembered", file=sys.stderr)
    return exit_code(len(options.sessions) - missing, missing)
