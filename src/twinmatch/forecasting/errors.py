"""The error of this package."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["ForecastError"]


class ForecastError(TwinmatchError):
    """A forecast that cannot be made: no candidate yet, or an invalid set-point profile."""
