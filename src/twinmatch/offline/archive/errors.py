"""Errors of an archive."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["ArchiveError", "ClusterError"]


class ArchiveError(TwinmatchError):
    """No sessions were found, or the folder for results cannot be used."""


class ClusterError(ArchiveError):
    """A Dask cluster cannot be reached, was lost, or cannot judge sessions."""
