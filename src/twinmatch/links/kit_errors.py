"""Errors of the link to a Temperature Control Lab."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["KitAbsentError", "KitError", "KitSilentError"]


class KitError(TwinmatchError):
    """The kit or the link to it failed."""


class KitAbsentError(KitError):
    """No kit was found: the package or the port is missing, or another device is on the port."""


class KitSilentError(KitError):
    """The heaters were switched off because no command came in time."""
