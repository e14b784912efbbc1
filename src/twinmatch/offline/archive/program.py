"""`twinmatch replay` on many sessions: options, table, exit codes."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path

from twinmatch.errors import EXIT_USER_ERROR
from twinmatch.offline.archive.archive import Archive, judge_archive
from twinmatch.offline.archive.errors import ArchiveError
from twinmatch.offline.archive.job import Failure
from twinmatch.offline.archive.sources import is_single

__all__ = ["EXIT_PARTLY", "add_options", "is_archive", "judge", "show"]

EXIT_PARTLY = 3
"""Some sessions were judged and some skipped."""

WIDTH = 180
"""Width of the table when the output is not a terminal."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options for many sessions."""
    group = parser.add_argument_group(
        "many sessions",
        "Several sessions, a folder of them or a pattern are judged in parallel, and one table shows all "
        "candidates. Exit code 0: all judged; 3: some skipped; 2: none judged.",
    )
    group.add_argument("--jobs", type=_count, metavar="N", help="processes (default: one per core)")
    group.add_argument(
        "--out", type=Path, metavar="DIR", help="write a JSON file per session; judge only new sessions"
    )
    group.add_argument(
        "--scheduler", metavar="ADDRESS", help="judge on this Dask cluster; it needs the same paths"
    )


def is_archive(options: argparse.Namespace) -> bool:
    """Whether these options ask for many sessions."""
    asked = (options.jobs, options.out, options.scheduler)
    return not is_single(options.sessions) or any(option is not None for option in asked)


def judge(options: argparse.Namespace, watch: Callable[[int, int], None]) -> Archive:
    """Judge the sessions of the options; a skipped session is reported at once."""
    if options.figure is not None:
        raise ArchiveError("--figure: draws one session, but several were given; give one")
    return judge_archive(
        options.sessions,
        config=options.config,
        plant=options.plant,
        candidates=options.candidates,
        out=options.out,
        jobs=options.jobs,
        scheduler=options.scheduler,
        watch=watch,
        on_skip=_report_skipped,
    )


def show(options: argparse.Namespace, archive: Archive) -> int:
    """Print the table and write the JSON; returns the exit code."""
    _print(archive)
    if options.json is not None:
        text = json.dumps(archive.document(), indent=1, allow_nan=False, ensure_ascii=False)
        options.json.write_text(text + "\n", encoding="utf-8")
    if not archive.failed:
        return 0
    return EXIT_PARTLY if archive.sessions else EXIT_USER_ERROR


def _report_skipped(failure: Failure) -> None:
    print(f"twinmatch: skipped {failure.reason}", file=sys.stderr)


def _print(archive: Archive) -> None:
    from rich.console import Console  # noqa: PLC0415 — needed only to print

    from twinmatch.offline.archive.table import table  # noqa: PLC0415

    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = WIDTH
    if archive.candidates:
        console.print(table(archive))
    without = [s["session"] for s in archive.sessions if s["summary"]["nominal"] is None]
    if without:
        print(f"No nominal twin: {', '.join(without)}")
    reused = f", {archive.reused} of them earlier" if archive.reused else ""
    skipped = f"; {len(archive.failed)} skipped" if archive.failed else ""
    print(f"{len(archive.sessions)} sessions judged{reused}, {len(archive.candidates)} candidates{skipped}")


def _count(text: str) -> int:
    try:
        count = int(text)
    except ValueError:
        count = 0
    if count < 1:
        msg = f"{text!r} is not a number of processes; give 1 or more"
        raise argparse.ArgumentTypeError(msg)
    return count
