"""Archives: judging many sessions at once, with one table of candidates over all of them.

`find_sessions` resolves the user's arguments to paths; `judge_archive` judges each session separately, in
processes on this machine or on a Dask cluster, and skips those that cannot be used. With a folder for results
it continues where an earlier run ended.

Sessions are judged in other processes with one thread of linear algebra each; the results equal those of
`twinmatch.offline` to the last bit. Nothing here imports numpy before such a process has been set up.
"""

from __future__ import annotations

from twinmatch.offline.archive.archive import Archive, judge_archive
from twinmatch.offline.archive.files import ArchiveError, find_sessions, is_single

__all__ = [
    "Archive",
    "ArchiveError",
    "find_sessions",
    "is_single",
    "judge_archive",
]
