"""What can be wrong with an archive."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["ArchiveError", "ClusterError"]


class ArchiveError(TwinmatchError):
    """No sessions where some were named, or a folder for results that cannot be used."""


class ClusterError(ArchiveError):
    """A Dask cluster that is not there, went away, or cannot judge sessions."""
