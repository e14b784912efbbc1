"""What can be wrong with a forecast that is asked for."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["ForecastError"]


class ForecastError(TwinmatchError):
    """A forecast that cannot be given: no candidate yet, or a set-point profile that cannot be followed."""
