"""`twinmatch forecast`: forecasts from chosen samples of a session."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

from twinmatch.errors import TwinmatchError
from twinmatch.offline.options import add_terms
from twinmatch.offline.outputs import check_writable

__all__ = ["LONGEST", "RECORDED", "add_arguments", "run"]

LONGEST: Final = 86_400.0
"""Longest horizon, s; for samples more than 5 s or less than 0.5 s apart in proportion to the sample time. A
longer one is a typing error: bands are learned up to a 288th of that."""
RECORDED: Final = "recorded"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.description = (
        "Runs the session through the twin once. At each chosen sample the leader (the candidate whose "
        "forecasts have cost least so far) forecasts what comes next, from the samples up to that one and "
        "the set-points ahead. Without --reference and --hold, the set-point of that sample is held."
    )
    parser.add_argument(
        "session", type=Path, metavar="SESSION", help="session folder, .mcap file, or recording (.mat, .csv)"
    )
    parser.add_argument(
        "--at",
        type=_sample,
        nargs="+",
        action="extend",
        required=True,
        metavar="SAMPLE",
        help="indices of the samples to forecast from",
    )
    parser.add_argument(
        "--reference",
        metavar="FILE|recorded",
        help="set-points ahead: a .csv of seconds ahead and set-point, or those recorded in the session",
    )
    parser.add_argument("--hold", type=float, metavar="VALUE", help="set-point to hold ahead")
    parser.add_argument("--candidate", metavar="NAME", help="candidate that forecasts (default: the leader)")
    parser.add_argument(
        "--horizon",
        type=float,
        metavar="S",
        help="forecast horizon, s (default: 300, at least 60 and at most 600 samples)",
    )
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the forecasts to this file")
    parser.add_argument("--figure", type=Path, metavar="OUT", help="draw them (.png, .svg or .pdf)")
    add_terms(parser)


def run(options: argparse.Namespace) -> int:
    """Forecast and print; returns the exit code.

    Raises:
        TwinmatchError: an option, the session or a file cannot be used.
    """
    _check(options)
    check_writable(options.json, options.figure)
    from twinmatch.cli.foretold import foretold, show  # noqa: PLC0415 — keeps --help fast

    show(foretold(options), options)
    return 0


def _check(options: argparse.Namespace) -> None:
    if options.reference is not None and options.hold is not None:
        msg = "forecast: --reference and --hold exclude each other; give only one of them"
        raise TwinmatchError(msg)
    if options.candidate is not None and not options.candidate.strip():
        raise TwinmatchError("forecast: --candidate is empty; give a name, or omit it to use the leader")


def _sample(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        msg = f"{text!r} is not a sample index; give whole numbers, and the session before --at"
        raise argparse.ArgumentTypeError(msg) from None
