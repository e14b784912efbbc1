"""Errors of serving the graph."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["FoxgloveError"]


class FoxgloveError(TwinmatchError):
    """The graph cannot be served, or an option has an invalid value."""
