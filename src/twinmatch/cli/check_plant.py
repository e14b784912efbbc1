"""`twinmatch check-plant`: what is wrong with a plant's file, and what to change."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from twinmatch.adding import CheckedPlant, check_plant
from twinmatch.adding.data import check_data, data_for
from twinmatch.cli.shared import Progress, add_options, column_map
from twinmatch.plants import find_plant


def add_arguments(parser: argparse.ArgumentParser) -> None:
    codes = "Exit code 0: no findings; 1: findings, each with what to do; 2: the plant cannot be used."
    parser.description = codes
    parser.add_argument("plant", metavar="NAME|FILE.py", help="the plant")
    add_options(parser, "--period", help="sampling period it will be run with")
    data = "also check a recording of it against the gate"
    parser.add_argument("--data", type=Path, metavar="SESSION|CSV", help=data)
    add_options(
        parser,
        "--map",
        help="time=elapsed output=t2 'input=duty; scale=100': columns of the .csv",
    )
    add_options(parser, "--map-file", "--bridge", "--gaps")


def run(options: argparse.Namespace) -> int:
    """Check and print; returns the exit code."""
    plant = find_plant(options.plant)
    with Progress("reading") as progress:
        limits = {"longest": options.bridge, "gaps": options.gaps}
        samples = options.data and data_for(
            options.data,
            plant,
            column_map(options),
            options.period,
            progress.advance,
            **limits,
        )
    with Progress("checking") as progress:
        checked = check_plant(
            plant,
            options.period or (samples.period if samples else None),
            progress.show,
        )
    _print(checked)
    if samples is None or checked.unusable:
        return checked.exit_code

    with Progress("checking") as progress:
        checked_data = check_data(samples, plant, progress.show)
    _print(checked_data)
    return max(checked.exit_code, checked_data.exit_code)


def _print(checked: CheckedPlant) -> None:
    for note in checked.notes:
        print(f"  {note}")
    for number, finding in enumerate(checked.findings, 1):
        print(f"{number}. {finding.what}")
        print(f"   → {finding.todo}")
    if checked.unusable:
        print(f"twinmatch: {checked.unusable}", file=sys.stderr)
    elif not checked.findings:
        print(f"{checked.title}: no problems found")
    else:
        many = "finding" if len(checked.findings) == 1 else "findings"
        print(f"{checked.title}: {len(checked.findings)} {many}")
