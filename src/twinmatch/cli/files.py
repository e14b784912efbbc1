"""Files that commands read and write."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinmatch.errors import TwinmatchError

__all__ = ["add_fmus", "add_plant", "add_terms", "check_writable"]


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


def check_writable(*outputs: Path | None) -> None:
    """Before a minute of work, not after.

    Raises:
        TwinmatchError: there is no folder for one of them, or it is a folder.
    """
    for output in outputs:
        if output is None:
            continue
        if not output.absolute().parent.is_dir():
            msg = f"{output}: there is no folder {output.parent} to write into; create it first"
            raise TwinmatchError(msg)
        if output.is_dir():
            msg = f"{output}: is a folder; name the file to write"
            raise TwinmatchError(msg)
