"""What can be wrong with data or orders given to the identification room."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["IdentificationError"]


class IdentificationError(TwinmatchError):
    """Data, orders or start values from which no Box–Jenkins model can be estimated or used."""
