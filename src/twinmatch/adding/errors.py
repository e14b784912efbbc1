"""What can be wrong when a plant is added."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["AddingError"]


class AddingError(TwinmatchError):
    """A name no plant can have, or a file that is there already."""
