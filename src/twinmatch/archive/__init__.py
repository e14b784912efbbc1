"""Archives: many sessions judged at once, and one table of candidates over all of them.

`find_sessions` turns what a user names into paths, `judge_archive` judges them, each on its own, in
processes of this machine or on a Dask cluster, and passes over those that cannot be used. With a folder to
keep results in it goes on where an earlier run ended.

Sessions are judged in other processes, one thread of linear algebra each; their results are those of
`twinmatch.judging`, to the last bit. Nothing here imports numpy before such a process has been set up.
"""

from __future__ import annotations

from twinmatch.archive.archive import Archive, judge_archive
from twinmatch.archive.errors import ArchiveError, ClusterError
from twinmatch.archive.job import Failure
from twinmatch.archive.sources import find_sessions, is_single

__all__ = [
    "Archive",
    "ArchiveError",
    "ClusterError",
    "Failure",
    "find_sessions",
    "is_single",
    "judge_archive",
]
