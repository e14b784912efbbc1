"""The base class of all errors that this package raises intentionally.

    TwinmatchError            the user can fix it: the message says what is wrong, where, and what to do
    └── <Package>Error        one per subpackage, next to the code that raises it

Programs catch `TwinmatchError`, print its message on one line and exit with `EXIT_USER_ERROR`; any other
exception is a bug and keeps its traceback.
"""

from __future__ import annotations

from typing import ClassVar

EXIT_USER_ERROR = 2
EXIT_INTERRUPTED = 130
"""As shells say of a program that Ctrl-C ended."""


class TwinmatchError(ValueError):
    """A problem outside the program that the user can fix."""

    NODE_EXIT: ClassVar[int] = EXIT_USER_ERROR
    """Exit code of a node that it ends."""
