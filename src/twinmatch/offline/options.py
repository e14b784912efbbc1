"""Command-line options for the terms of a judgement, shared by several commands."""

from __future__ import annotations

import argparse
from pathlib import Path

__all__ = ["add_fmus", "add_plant", "add_terms"]


def add_terms(parser: argparse.ArgumentParser) -> None:
    """Add the options for candidates, plant, FMUs and parameters."""
    parser.add_argument("--candidates", type=Path, metavar="FILE", help="initial candidates (.yaml)")
    add_plant(parser)
    add_fmus(parser)
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="parameters (.yaml), in the format of the nodes"
    )


def add_fmus(parser: argparse.ArgumentParser) -> None:
    """Add the option for FMUs as structures of the plant."""
    parser.add_argument(
        "--allow-fmu",
        metavar="FILE",
        type=Path,
        help="use the FMUs listed in this file (.yaml) as structures of the plant; their code is executed",
    )


def add_plant(parser: argparse.ArgumentParser) -> None:
    """Add the option for the plant, for sessions that do not name it."""
    parser.add_argument(
        "--plant",
        metavar="NAME|FILE.py",
        help="the plant, if the session does not name it, or your plant file, which is executed",
    )
