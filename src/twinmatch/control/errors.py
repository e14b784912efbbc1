"""Errors in a set-point profile or a loop."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["ControlError"]


class ControlError(TwinmatchError):
    """A profile or a loop cannot be run."""
