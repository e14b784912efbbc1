"""What can be wrong with an FMU, or with what is said of it."""

from __future__ import annotations

from twinmatch.dynamics import PlantError

__all__ = ["FmuError"]


class FmuError(PlantError):
    """An FMU that cannot be used, or a file that says of it what is not so."""
