"""The error of this package."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["DiscriminationError"]


class DiscriminationError(TwinmatchError):
    """A model or table that cannot be scored or compared; the message says which and why."""
