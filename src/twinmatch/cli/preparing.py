"""`twinmatch prepare`: what a first run would wait for, made beforehand."""

from __future__ import annotations

import argparse

__all__ = ["add_arguments", "run"]


def add_arguments(_: argparse.ArgumentParser) -> None:
    """There are no options."""


def run(_: argparse.Namespace) -> int:
    """Derive and compile; returns the exit code."""
    from twinmatch.dynamics.prepare import prepare  # noqa: PLC0415 — keeps --help fast
    from twinmatch.dynamics.store import cache_folder  # noqa: PLC0415
    from twinmatch.plants import PLANTS  # noqa: PLC0415

    for plant in PLANTS.values():
        count = sum(1 for _ in prepare(plant))
        print(f"{plant.title}: {count} structures are ready in {cache_folder()}")
    return 0
