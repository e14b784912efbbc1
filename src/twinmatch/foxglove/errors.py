"""What can go wrong with serving the graph."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["FoxgloveError"]


class FoxgloveError(TwinmatchError):
    """The graph cannot be served, or an option is no value it can have."""
