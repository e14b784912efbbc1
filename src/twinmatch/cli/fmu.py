"""`twinmatch fmu`: an FMU's variables, and a draft of the map that makes it a structure of a plant."""

from __future__ import annotations

import argparse
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path
from typing import Final

from twinmatch.cli.shared import Progress
from twinmatch.fmu.archive import draft, overview
from twinmatch.fmu.process import FmuProcess
from twinmatch.fmu.structure import described_by
from twinmatch.plants import find_plant

_SHOWN_EVERY: Final = 0.5
"""Interval at which progress is shown, s."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file", type=Path, metavar="FMU", help="the FMU; its binary is not run"
    )
    plant = "the plant it will be a structure of (default: peltier)"
    parser.add_argument("--plant", default="peltier", help=plant)


def run(options: argparse.Namespace) -> int:
    """Print the map as YAML, with the variables as comments; returns the exit code."""
    plant = find_plant(options.plant)
    process = FmuProcess()
    try:
        with Progress() as progress, ThreadPoolExecutor(1) as executor:
            reading = executor.submit(described_by, options.file, process)
            try:
                while not wait([reading], _SHOWN_EVERY).done:
                    progress.show("reading the description", 0, 0)
            except KeyboardInterrupt:
                process.close()  # ends the reading, which the executor waits for
                raise
        described = reading.result()
    finally:
        process.close()
    for line in overview(described):
        print(f"# {line}")
    print(draft(options.file, described, plant), end="")
    return 0
