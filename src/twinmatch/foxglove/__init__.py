"""The graph in Foxglove and Lichtblick: every topic as it is sent, over their WebSocket protocol.

One node subscribes to what it finds, as the recorder does, and hands the bytes on with the schema that
the recorder would write. So a layout made for the live graph fits a recorded session.
"""

from __future__ import annotations

from twinmatch.foxglove.clock import StreamTime
from twinmatch.foxglove.errors import FoxgloveError

__all__ = ["FoxgloveError", "StreamTime"]
