"""What can be wrong with files of sessions and recordings.

TwinmatchError
└── SessionError           a session cannot be read or written
    └── RecordingError     a recording (.mat, .csv) cannot be imported
"""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["RecordingError", "SessionError"]


class SessionError(TwinmatchError):
    """A session cannot be read or written; the message names the file and the place in it."""


class RecordingError(SessionError):
    """A recording cannot be imported; the message names the file and the place in it."""
