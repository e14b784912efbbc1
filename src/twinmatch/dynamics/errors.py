"""What can be wrong with a plant's equations, its numbers, or the signals it is run on."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["PlantError", "StructureLostError"]


class PlantError(TwinmatchError):
    """Equations that cannot be used, numbers no plant can have, or signals it cannot be run on."""


class StructureLostError(PlantError):
    """A structure from elsewhere that ran before cannot be run any more, and never will be again."""
