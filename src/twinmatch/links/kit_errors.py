"""What can go wrong between us and a Temperature Control Lab."""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["KitAbsentError", "KitError", "KitSilentError"]


class KitError(TwinmatchError):
    """The kit, or what stands between, did something else than it should."""


class KitAbsentError(KitError):
    """There is no kit where one was looked for: no package, no port, or another device on it."""


class KitSilentError(KitError):
    """The heaters were switched off because no command came in time."""
