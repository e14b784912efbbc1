"""What can be wrong with topics, fields and rules of sampling."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["SamplingError"]


class SamplingError(TwinmatchError):
    """A field that is not there, or rules by which nothing can be sampled."""
