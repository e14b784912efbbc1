"""`twinmatch report`: a session as a document to share."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from pathlib import Path

from twinmatch.cli.shared import TERMS, Progress, add_options, check_writable, judging
from twinmatch.offline.processes import held_interrupts
from twinmatch.showing.report.pictures import write_pictures
from twinmatch.showing.report.report import make_report

FORMATS = ("png", "pdf")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(parser, "session")
    # The session comes first: after --peers it would be parsed as another of these.
    parser.usage = "%(prog)s SESSION [options]"
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="OUT",
        help="the file to write (default: SESSION.html, here)",
    )
    parser.add_argument(
        "--figures",
        type=Path,
        metavar="DIR",
        help="also write the figures into this folder",
    )
    parser.add_argument(
        "--format", choices=FORMATS, default="png", help="their format (default: png)"
    )
    of_peers = "methods to compare the forecasts with; without a value: none (default: persistence arx)"
    add_options(parser, "--peers", help=of_peers)
    add_options(parser, *TERMS)


def run(options: argparse.Namespace) -> int:
    """Write the report; returns the exit code."""
    # does not raise on a loop of links
    session = Path(os.path.realpath(options.session))
    output: Path = options.output or Path(
        f"{session.name if session.is_dir() else session.stem}.html"
    )
    check_writable(output, example="report.html")
    command = shlex.join(["twinmatch", *sys.argv[1:]])
    with held_interrupts(), Progress() as progress:
        asked = judging(options, progress)
        asked |= {"memory": options.memory, "rig": options.rig}
        report = make_report(
            options.session, peers=options.peers, second=True, command=command, **asked
        )
    report.write(output)
    print(report.sentence, *report.memory, sep="\n")
    print(
        f"report: {output} ({output.stat().st_size / 1e6:.1f} MB, opens in any browser, offline)"
    )
    if options.figures is not None:
        written = write_pictures(report.pictures, options.figures, options.format)
        print(
            f"figures: {len(written)} {options.format.upper()} files in {options.figures}"
        )
    return 0
