"""Errors in a plant's equations, its numbers, or the signals on which it is run."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["PlantError", "StructureLostError"]


class PlantError(TwinmatchError):
    """Equations that cannot be used, impossible values, or signals on which the plant cannot be run."""


class StructureLostError(PlantError):
    """An external structure was lost: it ran before, but can never be run again."""
