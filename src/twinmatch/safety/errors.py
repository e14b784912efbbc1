"""Errors in safety limits."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["SafetyError"]


class SafetyError(TwinmatchError):
    """Limits under which nothing is protected."""
