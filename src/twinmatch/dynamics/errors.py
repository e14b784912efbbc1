"""What can be wrong with a plant's equations, its numbers, or the signals it is run on."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["PlantError"]


class PlantError(TwinmatchError):
    """Equations that cannot be used, numbers no plant can have, or signals it cannot be run on."""
