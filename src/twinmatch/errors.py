"""The root of every error this package raises on purpose.

    TwinmatchError            a user can mend it: the message names what is wrong, where, and what to do
    └── <room>Error           one per room, next to the code that raises it

Programs catch `TwinmatchError`, print its one line and exit with `EXIT_USER_ERROR`; anything else is
a defect of ours and keeps its traceback.
"""

from __future__ import annotations

__all__ = ["EXIT_USER_ERROR", "TwinmatchError"]

EXIT_USER_ERROR = 2


class TwinmatchError(ValueError):
    """Something outside the program is wrong and its owner can mend it."""
