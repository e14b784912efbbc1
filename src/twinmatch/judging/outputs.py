"""A check of the files that commands write."""

from __future__ import annotations

from pathlib import Path

from twinmatch.errors import TwinmatchError

__all__ = ["check_writable"]


def check_writable(*outputs: Path | None) -> None:
    """Check the output paths before a minute of work, not after.

    Raises:
        TwinmatchError: the folder of an output does not exist, or the output is itself a folder.
    """
    for output in outputs:
        if output is None:
            continue
        if not output.absolute().parent.is_dir():
            msg = f"{output}: the folder {output.parent} does not exist; create it first"
            raise TwinmatchError(msg)
        if output.is_dir():
            msg = f"{output}: is a folder; name the file to write"
            raise TwinmatchError(msg)
