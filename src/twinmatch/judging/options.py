"""Options on whose terms a session is judged, as several commands have them."""

from __future__ import annotations

import argparse
from pathlib import Path

__all__ = ["add_fmus", "add_plant", "add_terms"]


def add_terms(parser: argparse.ArgumentParser) -> None:
    """The files on whose terms a session is judged."""
    parser.add_argument("--candidates", type=Path, metavar="FILE", help="candidates to begin with (.yaml)")
    add_plant(parser)
    add_fmus(parser)
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="parameters (.yaml), as the nodes take them"
    )


def add_fmus(parser: argparse.ArgumentParser) -> None:
    """FMUs as structures of the plant."""
    parser.add_argument(
        "--allow-fmu",
        metavar="FILE",
        type=Path,
        help="let FMUs be structures of the plant as this file (.yaml) says; their programs are run",
    )


def add_plant(parser: argparse.ArgumentParser) -> None:
    """The plant, where a session does not say it."""
    parser.add_argument(
        "--plant",
        metavar="NAME|FILE.py",
        help="the plant, where the session does not say it or it is in a file of yours, which is run",
    )
