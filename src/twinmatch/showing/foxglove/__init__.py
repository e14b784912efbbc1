"""The graph in Foxglove and Lichtblick: every topic unchanged, over their WebSocket protocol.

One node subscribes to all topics, as the recorder does, and forwards the bytes with the schemas that the
recorder writes. A layout for the live graph therefore also fits a recorded session.
"""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["FoxgloveError"]


class FoxgloveError(TwinmatchError):
    """The graph cannot be served, or an option has an invalid value."""
