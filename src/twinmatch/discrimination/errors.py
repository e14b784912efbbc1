"""The error of this room."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["DiscriminationError"]


class DiscriminationError(TwinmatchError):
    """Models or tables that cannot be scored or compared; the message says which and why."""
