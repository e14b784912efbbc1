"""`twinmatch backtest`: scores of the twin's forecasts of recorded sessions."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from twinmatch.errors import EXIT_USER_ERROR, TwinmatchError
from twinmatch.offline.command_line import Progress, add_terms, check_writable

if TYPE_CHECKING:
    from twinmatch.offline.backtest.result import Backtest

EXIT_PARTLY = 3
"""Exit code: some sessions were tested and some skipped."""
PEERS: Final = ("persistence", "arx", "statsmodels")
WIDTH = 140
"""Width of the tables where standard output is not a terminal, characters."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    # Sessions come first: after --horizon or --peers they would be parsed as further values of these.
    parser.usage = "%(prog)s SESSION [SESSION ...] [options]"
    parser.add_argument(
        "sessions",
        type=Path,
        nargs="+",
        metavar="SESSION",
        help="session folder, .mcap file, recording (.mat, .csv), folder of any of these, or pattern",
    )
    parser.add_argument(
        "--every",
        type=_seconds,
        metavar="S",
        help="seconds between forecasts, in addition to those at every verdict (default: 60)",
    )
    parser.add_argument(
        "--horizon",
        type=_seconds,
        nargs="+",
        metavar="S",
        help="forecast horizons, in seconds (default: 10 60 300; at least 2, 12 and 60 samples, at most 20, "
        "120 and 600)",
    )
    parser.add_argument(
        "--peers",
        nargs="*",
        choices=PEERS,
        default=list(PEERS),
        help="methods to compare the twin with; without a value: none (default: all)",
    )
    parser.add_argument(
        "--json", type=Path, metavar="OUT", help="write the scores, and those of every forecast, to this file"
    )
    parser.add_argument("--figure", type=Path, metavar="OUT", help="draw the scores (.png, .svg or .pdf)")
    add_terms(parser)


def run(options: argparse.Namespace) -> int:
    """Test the twin; returns the exit code: 0 all sessions tested, 3 some skipped, 2 none tested.

    Raises:
        TwinmatchError: the only session cannot be used, or a file cannot be written.
    """
    from twinmatch.offline.archive import find_sessions  # noqa: PLC0415 — keeps --help fast
    from twinmatch.offline.backtest.result import over_all  # noqa: PLC0415

    check_writable(options.json, options.figure)
    sessions = find_sessions(options.sessions)
    found: list[Backtest] = []
    for path in sessions:
        try:
            found.append(_one(path, options))
        except TwinmatchError as error:
            if len(sessions) == 1:
                raise
            print(f"twinmatch: skipped {path}: {error}", file=sys.stderr)
    if not found:
        return EXIT_USER_ERROR
    total = found[0] if len(found) == 1 else over_all(found)
    if len(found) > 1:
        _print(total)
    _write(found, total, options)
    return 0 if len(found) == len(sessions) else EXIT_PARTLY


def _one(path: Path, options: argparse.Namespace) -> Backtest:
    from twinmatch.offline.backtest import Choices, backtest_session  # noqa: PLC0415 — as above

    horizons = None if options.horizon is None else tuple(options.horizon)
    choices = Choices(options.every, horizons, tuple(options.peers))
    with Progress() as progress:
        tested = backtest_session(
            path,
            choices,
            config=options.config,
            candidates=options.candidates,
            plant=options.plant,
            watch=progress.advance,
            progress=progress.reading,
        )
    _print(tested)
    return tested


def _print(tested: Backtest) -> None:
    from rich.console import Console  # noqa: PLC0415 — only needed for printing

    from twinmatch.showing.backtests import sentences, tables  # noqa: PLC0415

    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = WIDTH
    for table in tables(tested):
        console.print(table)
        console.print()
    for line in (*sentences(tested), *tested.notes, *(f"{a.name}: {a.reason}" for a in tested.absent)):
        print(line)


def _write(found: Sequence[Backtest], total: Backtest, options: argparse.Namespace) -> None:
    if options.json is not None:
        from twinmatch.offline.backtest.result import document  # noqa: PLC0415

        entry = {
            "sessions": [document(each) for each in found],
            "total": document(total, forecasts=False),
        }
        text = json.dumps(entry, indent=1, allow_nan=False, ensure_ascii=False)
        options.json.write_text(text + "\n", encoding="utf-8")
    if options.figure is not None:
        from twinmatch.showing.backtests import draw_backtest  # noqa: PLC0415
        from twinmatch.showing.figures.drawing import save  # noqa: PLC0415

        save(draw_backtest(total), options.figure)


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < float("inf"):
        msg = f"{text!r} is not a time in seconds; give a positive number"
        raise argparse.ArgumentTypeError(msg)
    return value
