"""`twinmatch fmu`: an FMU's variables, and a draft of the map that makes it a structure of a plant."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinmatch.fmu.archive import draft, overview
from twinmatch.fmu.process import FmuProcess
from twinmatch.fmu.structure import described_by
from twinmatch.plants import find_plant


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=Path, metavar="FMU", help="the FMU; its binary is not run")
    plant = "the plant it will be a structure of (default: peltier)"
    parser.add_argument("--plant", default="peltier", help=plant)


def run(options: argparse.Namespace) -> int:
    """Print the map as YAML, with the variables as comments; returns the exit code."""
    plant, process = find_plant(options.plant), FmuProcess()
    try:
        described = described_by(options.file, process)
    finally:
        process.close()
    for line in overview(described):
        print(f"# {line}")
    print(draft(options.file, described, plant), end="")
    return 0
