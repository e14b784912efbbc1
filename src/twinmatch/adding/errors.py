"""Errors of adding a plant."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["AddingError"]


class AddingError(TwinmatchError):
    """The name is not valid for a plant, or a file exists already."""
