"""What this room refuses."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["SafetyError"]


class SafetyError(TwinmatchError):
    """Limits that protect nothing."""
