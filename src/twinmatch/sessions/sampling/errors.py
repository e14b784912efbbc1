"""Errors in topics, fields and settings of sampling."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["SamplingError"]


class SamplingError(TwinmatchError):
    """A field is missing, or the settings allow no sampling."""
