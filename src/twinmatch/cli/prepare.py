"""`twinmatch prepare`: derive and compile beforehand what a first run would wait for."""

from __future__ import annotations

import argparse

from twinmatch.cli.shared import add_options


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_options(parser, "--plant", help="only this plant (default: all that come with twinmatch)")


def run(options: argparse.Namespace) -> int:
    """Derive and compile; returns the exit code."""
    from twinmatch.dynamics.prepare import prepare  # noqa: PLC0415 — keeps --help fast
    from twinmatch.dynamics.store import cache_folder  # noqa: PLC0415
    from twinmatch.plants import PLANTS, find_plant  # noqa: PLC0415

    for plant in [find_plant(options.plant)] if options.plant else PLANTS.values():
        count = sum(1 for _ in prepare(plant))
        print(f"{plant.title}: {count} structures are ready in {cache_folder()}")
    return 0
