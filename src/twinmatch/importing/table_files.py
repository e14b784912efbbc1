"""Opens a table of any kind: text, MATLAB, or a database of Home Assistant."""

from __future__ import annotations

from pathlib import Path

from twinmatch.importing.home_assistant import is_database, read_history
from twinmatch.importing.stacked import taken_apart
from twinmatch.importing.tables import Table, read_table
from twinmatch.sessions.files import ProgressCallback

__all__ = ["open_table"]


def open_table(path: Path, progress: ProgressCallback | None = None) -> Table:
    """The table in a file; if it stacks many series in one column, it has a column for each.

    `progress` is called with what is read so far and the total.

    Raises:
        RecordingError: the file does not exist, is not a table, or is damaged.
    """
    if is_database(path):
        return read_history(path)
    return taken_apart(read_table(path, progress))
