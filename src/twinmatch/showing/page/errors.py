"""Errors of the page."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["DashboardError"]


class DashboardError(TwinmatchError):
    """The page cannot be served, or a request made on it cannot be carried out."""
