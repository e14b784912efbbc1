"""`twinmatch new-plant`: a first file for a plant, its test and its configuration."""

from __future__ import annotations

import argparse
import shlex
from dataclasses import replace
from pathlib import Path

from twinmatch.adding import Proposal, example, files_of, propose
from twinmatch.adding.blank import blank, signal_said
from twinmatch.adding.several import SeveralProposal, has_several, propose_several
from twinmatch.cli.shared import Progress, add_options, positive, positive_period
from twinmatch.errors import TwinmatchError
from twinmatch.importing.column_map import (
    SEEN,
    columns_of,
    in_words_of_all_loops,
    proposed,
    seen_by_controller,
)
from twinmatch.importing.derived import with_derived
from twinmatch.importing.table_files import open_table
from twinmatch.offline.first_steps import course_from_file
from twinmatch.plants import find_plant
from twinmatch.sampling.sources import SignalMap, parse_map
from twinmatch.showing.first_steps import course_words

HEATER = "heater [%] 0 to 100"
"""What is moved where nothing else is said."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "name", help="name of the plant: lower-case letters, digits and _"
    )
    table = "recording (.csv or .mat) to take ranges, noise, sampling period and a first gain and lag from"
    parser.add_argument("--from", dest="table", type=Path, metavar="CSV", help=table)
    guess = "which column is which signal, as for twinmatch import; without it a guess is made"
    add_options(parser, "--map", help=guess)
    add_options(
        parser,
        "--period",
        help="sampling period, if the table has no times or finer ones",
    )
    add_options(parser, "--bridge", "--gaps")
    nothing = "write a file from --measured, --moved and --takes alone, and say what to record first"
    parser.add_argument("--nothing-recorded", action="store_true", help=nothing)
    measured = "what is measured, its unit and the range that it may never leave: 'temperature [°C] 10 to 95'"
    parser.add_argument("--measured", metavar="SIGNAL", help=measured)
    moved = "what is moved, with its unit and limits (default: 'heater [%%] 0 to 100')"
    parser.add_argument("--moved", metavar="SIGNAL", default=HEATER, help=moved)
    takes = "about how long two thirds of a change take, s"
    parser.add_argument(
        "--takes", type=positive(float, "a number of seconds"), metavar="S", help=takes
    )
    now = "the reading now, with nothing moved"
    parser.add_argument("--now", type=float, metavar="VALUE", help=now)
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path(),
        metavar="DIR",
        help="folder to write into (default: here)",
    )


def run(options: argparse.Namespace) -> int:
    """Write the files; returns the exit code.

    Raises:
        TwinmatchError: the table cannot be used, or a file already exists.
    """

    proposal = _proposal(options)
    files = files_of(options.name, proposal)
    folder: Path = options.output
    if not folder.is_dir():
        raise TwinmatchError(
            f"new-plant: the folder {folder} does not exist; create it first"
        )
    for name in files:
        if (folder / name).exists():
            raise TwinmatchError(
                f"{folder / name}: exists already; move it away or choose another name"
            )
    for name, text in files.items():
        try:
            (folder / name).write_text(text, encoding="utf-8")
        except OSError as error:
            raise TwinmatchError(
                f"{folder / name}: cannot be written ({error.strerror})"
            ) from error
    for note in proposal.notes:
        print(f"Note: {note}")
    paths = [str(folder / name) for name in files]
    if isinstance(proposal, Proposal) and options.nothing_recorded:
        _say_course(paths, proposal)
    else:
        _say(options, paths, proposal)
    return 0


def _further_options(proposal: Proposal | SeveralProposal) -> str:
    """What the next commands need to read the table as it was read here."""
    words = "" if proposal.bridge is None else f" --bridge {proposal.bridge:g}"
    return words + (" --gaps split" if proposal.split else "")


def _proposal(options: argparse.Namespace) -> Proposal | SeveralProposal:
    period = positive_period(options, "new-plant")
    signal_map = parse_map(options.map)
    if options.nothing_recorded:
        return _blank(options)
    if options.table is None:
        if signal_map.sources:
            raise TwinmatchError(
                "new-plant: --map needs the table it maps; name it with --from"
            )
        return example()
    with Progress("reading") as progress:
        table = open_table(options.table, progress.advance)
    if not signal_map.sources:
        columns = columns_of(table)
        signal_map = SignalMap(proposed(columns, table))
        words = shlex.join(
            f"{signal}={source.text}" for signal, source in signal_map.sources.items()
        )
        if words:
            print(f"Columns guessed as: --map {words}")
        if seen_by_controller(columns, signal_map.sources):
            print(SEEN)
        if of_all := in_words_of_all_loops(columns, signal_map.sources):
            print(of_all)
    table, signal_map = with_derived(table, replace(signal_map, period=period))
    propose_from = propose_several if has_several(signal_map) else propose
    return propose_from(table, signal_map, longest=options.bridge)


def _blank(options: argparse.Namespace) -> Proposal:
    if options.table is not None or options.measured is None or options.takes is None:
        options.parser.error(
            "--nothing-recorded needs --measured and --takes, and takes no table"
        )
    measured = signal_said(options.measured, "--measured")
    proposal = blank(
        measured, signal_said(options.moved, "--moved"), options.takes, options.now
    )
    return (
        proposal if options.period is None else replace(proposal, period=options.period)
    )


def _say_course(files: list[str], proposal: Proposal) -> None:
    """Print the first course of the plant file that was written, and where its recording belongs."""
    path = files[0]
    course, period = course_from_file(find_plant(path), proposal.period)
    print(f"Written: {', '.join(files)}")
    print(f"Record first, at one sample every {period:g} s:")
    for line in course_words(course):
        print(f"  {line}")
    columns = f"time,{proposal.output.name},{proposal.input.name}"
    print(f"as a table with the columns {columns} (time in seconds). Then:")
    print(f"  twinmatch experiment LOG.csv --plant {shlex.quote(path)} --pid pid.json")
    print("docs/newcomer.md goes the whole way.")


def _say(
    options: argparse.Namespace, files: list[str], proposal: Proposal | SeveralProposal
) -> None:
    plant, test, config, *mapped = map(shlex.quote, files)
    session = f"{options.name}_session"
    further_options = _further_options(proposal)
    print(f"Written: {', '.join(files)}")
    if isinstance(proposal, Proposal) and proposal.held:
        print(
            f"Note: {proposal.input.name} stood at one level, so gain and rest cannot be told apart: they "
            f"hold if {proposal.output.name} rested at its first readings. Rest first; how long, and which "
            "step then:"
        )
        print(f"  twinmatch experiment --plant {shlex.quote(files[0])}")
    print("Next:")
    print(f"  1. check {plant}: names, units, ranges, equations (lines marked *)")
    data = ""
    if mapped:
        table = shlex.quote(str(options.table))
        data = f" --data {table} --map-file {mapped[0]}{further_options}"
    print(
        f"  2. twinmatch check-plant {plant}{data}        # what is wrong with it, and what to change"
    )
    print(f"  3. python -m pytest {test}        # passes as it is; keep it so")
    if mapped:
        arguments = f"{table} --map-file {mapped[0]} --plant {plant}{further_options}"
        print(f"  4. twinmatch import {arguments} -o {session}")
    else:
        print(
            f"  4. twinmatch import LOG.csv --plant {plant} --map time=… output=… input=… -o {session}"
        )
    print(
        f"  5. twinmatch replay {session} --plant {plant}        # or --config {config}"
    )
    print("docs/your_plant.md explains each step.")
