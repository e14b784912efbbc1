"""The base class of all errors that this package raises intentionally.

    TwinmatchError            the user can fix it: the message says what is wrong, where, and what to do
    └── <Package>Error        one per subpackage, next to the code that raises it

Programs catch `TwinmatchError`, print its message on one line and exit with `EXIT_USER_ERROR`; any other
exception is a bug and keeps its traceback.
"""

from __future__ import annotations

import traceback
from pathlib import Path
from typing import ClassVar

EXIT_USER_ERROR = 2
EXIT_INTERRUPTED = 130
"""As shells say of a program that Ctrl-C ended."""


def defect_words(error: Exception) -> str:
    """A defect of this package in a sentence: which error it was, where it was raised, and what to do.

    The place is the innermost line in this package, since it called a library wrongly.
    """
    package = Path(__file__).parent
    lines = traceback.extract_tb(error.__traceback__)
    ours = [line for line in lines if package in Path(line.filename).parents] or lines
    place = f" at {Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else ""
    return f"a defect of twinmatch ({type(error).__name__}{place}: {error}); please report it"


class TwinmatchError(ValueError):
    """A problem outside the program that the user can fix."""

    NODE_EXIT: ClassVar[int] = EXIT_USER_ERROR
    """Exit code of a node that it ends."""
