"""A check of the files that commands write."""

from __future__ import annotations

from pathlib import Path

from twinmatch.errors import TwinmatchError

__all__ = ["check_writable"]


def check_writable(*outputs: Path | None, example: str = "") -> None:
    """Check the output paths before a minute of work, not after; `example` is the name of such a file.

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
            such = f", such as {output / example}" if example else ""
            msg = f"{output}: is a folder; give the file to write{such}"
            raise TwinmatchError(msg)
