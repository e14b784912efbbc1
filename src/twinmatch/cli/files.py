"""Files that commands write."""

from __future__ import annotations

from pathlib import Path

from twinmatch.errors import TwinmatchError

__all__ = ["check_writable"]


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
