"""Errors of session files and recordings.

TwinmatchError
├── SessionError           a session cannot be read or written
│   └── RecordingError     a recording (.mat, .csv) cannot be imported
└── DocumentError          a YAML or JSON text cannot be used
"""

from __future__ import annotations

from twinmatch.errors import TwinmatchError

__all__ = ["DocumentError", "RecordingError", "SessionError"]


class SessionError(TwinmatchError):
    """A session cannot be read or written; the message names the file and the place in it."""


class RecordingError(SessionError):
    """A recording cannot be imported; the message names the file and the place in it."""


class DocumentError(TwinmatchError):
    """A YAML or JSON text cannot be used; the message names the file and the line in it."""
