"""The error of this package."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["IdentificationError"]


class IdentificationError(TwinmatchError):
    """Data, orders or start values with which no Box–Jenkins model can be estimated or used."""
