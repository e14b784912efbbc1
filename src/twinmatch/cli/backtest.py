"""`twinmatch backtest`: scores of the twin's forecasts of recorded sessions."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from twinmatch.cli.shared import (
    TERMS,
    Progress,
    add_options,
    check_writable,
    console_for,
    exit_code,
    judging,
    positive,
    write_json,
)
from twinmatch.errors import EXIT_USER_ERROR, TwinmatchError
from twinmatch.offline.archive import find_sessions
from twinmatch.offline.backtest import Choices, backtest_outputs
from twinmatch.offline.backtest.scoring import Backtest, document, over_all
from twinmatch.showing.forecasts import backtest_tables, backtest_words
from twinmatch.showing.summary import fault_words


def add_arguments(parser: argparse.ArgumentParser) -> None:
    # Sessions come first: after --horizon or --peers they would be parsed as further values of these.
    parser.usage = "%(prog)s SESSION [SESSION ...] [options]"
    add_options(parser, "sessions")
    seconds = positive(float, "a time in seconds; give a positive number")
    interval = "seconds between forecasts, in addition to those at every verdict (default: 60 for the rig)"
    parser.add_argument("--every", type=seconds, metavar="S", help=interval)
    horizons = "forecast horizons, in seconds (default: those that the twin scores: 10 60 300 for the rig)"
    parser.add_argument(
        "--horizon", type=seconds, nargs="+", metavar="S", help=horizons
    )
    add_options(parser, "--peers")
    add_options(
        parser,
        "--json",
        help="write the scores, and those of every forecast, to this file",
    )
    add_options(parser, "--figure", help="draw the scores (.png, .svg or .pdf)")
    add_options(parser, *TERMS)


def run(options: argparse.Namespace) -> int:
    """Test the twin; returns the exit code: 0 all sessions tested, 3 some skipped, 2 none tested."""
    check_writable(options.json, options.figure)
    sessions = find_sessions(options.sessions)
    tests: list[Backtest] = []
    tested = 0
    for path in sessions:
        try:
            tests += _tested(path, options)
            tested += 1
        except TwinmatchError as error:
            if len(sessions) == 1:
                raise
            print(f"twinmatch: skipped {path}: {error}", file=sys.stderr)
    if not tests:
        return EXIT_USER_ERROR
    totals = _totals(tests)
    for total in totals if len(tests) > len(totals) else ():
        _print(total)
    write_json(options.json, lambda: _document(tests, totals))
    if options.figure is not None:
        _draw(totals, options.figure)
    return exit_code(tested, len(sessions) - tested)


def _document(tests: Sequence[Backtest], totals: Sequence[Backtest]) -> dict[str, Any]:
    """What is written to the file of `--json`."""
    of_totals = [document(total, forecasts=False) for total in totals]
    return {
        "sessions": [document(test) for test in tests],
        "total": of_totals[0] if len(of_totals) == 1 else of_totals,
    }


def _draw(totals: Sequence[Backtest], figure: Path) -> None:
    """Draw the scores of every output, each into a file of its own beside `figure`."""
    from twinmatch.showing.figures.drawing import save  # noqa: PLC0415
    from twinmatch.showing.figures.forecasts import draw_backtest  # noqa: PLC0415

    for number, total in enumerate(totals):
        ending = f"_{next(iter(total.plant.outputs))}" if number else ""
        save(draw_backtest(total), figure.with_stem(figure.stem + ending))


def _totals(tests: Sequence[Backtest]) -> list[Backtest]:
    """Over all sessions, output by output."""
    tests_by_output: dict[object, list[Backtest]] = {}
    for test in tests:
        tests_by_output.setdefault(test.plant.output, []).append(test)
    totals = []
    for tests_of_output in tests_by_output.values():
        totals.append(
            tests_of_output[0]
            if len(tests_of_output) == 1
            else over_all(tests_of_output)
        )
    return totals


def _tested(path: Path, options: argparse.Namespace) -> tuple[Backtest, ...]:
    horizons = None if options.horizon is None else tuple(options.horizon)
    choices = Choices(options.every, horizons, tuple(options.peers))
    with Progress() as progress:
        tests = backtest_outputs(
            path, choices, second=True, **judging(options, progress)
        )
    for tested in tests:
        _print(tested)
    summary = tests[0].summary
    if summary is not None and (line := fault_words(summary)):
        print(line)
    return tests


def _print(tested: Backtest) -> None:
    console = console_for(140)
    for table in backtest_tables(tested):
        console.print(table)
        console.print()
    for line in (*backtest_words(tested), *tested.notes):
        print(line)
