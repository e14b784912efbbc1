"""Errors of FMUs and their maps."""

from __future__ import annotations

from twinmatch.dynamics import PlantError

__all__ = ["FmuError"]


class FmuError(PlantError):
    """An FMU cannot be used, or its map does not fit."""
