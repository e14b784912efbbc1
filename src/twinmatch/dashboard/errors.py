"""What can go wrong with the page."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["DashboardError"]


class DashboardError(TwinmatchError):
    """The page cannot be served, or what was asked through it cannot be done."""
