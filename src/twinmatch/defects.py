"""Defects of this program: what was raised, where, and how it is logged."""

from __future__ import annotations

import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, NamedTuple

from twinmatch.errors import TwinmatchError

_PACKAGE: Final = Path(__file__).parent
_LONGEST: Final = 300
"""Characters of an error's message that are shown."""


class DefectWarning(RuntimeWarning):
    """A part of this program raised an error that nobody outside can fix; the run continues without it.

    In tests every warning is an error, so that no defect is overlooked there.
    """


class Defect(NamedTuple):
    """What was raised in this program, and where."""

    error: str
    """Class and message of the error, on one line."""
    file: str
    """File whose line raised it; of this program if any of its files was on the way."""
    line: int
    function: str

    @property
    def place(self) -> str:
        """File and line; of a file of this package its path within it, which is the same on every machine."""
        path = Path(self.file)
        name = (
            path.relative_to(_PACKAGE).as_posix()
            if path.is_relative_to(_PACKAGE)
            else path.name
        )
        return f"{name}:{self.line}"

    @property
    def sentence(self) -> str:
        """For who asked for what it has prevented."""
        return f"a defect of twinmatch ({self}); please report it"

    def __str__(self) -> str:
        return f"{self.place}, {self.function}: {self.error}"


def defect_of(error: Exception) -> Defect:
    """The defect behind an error that was raised: its innermost line in this program."""
    frames = traceback.extract_tb(error.__traceback__)
    inside = [
        frame for frame in frames if Path(frame.filename).is_relative_to(_PACKAGE)
    ]
    innermost = (inside or frames)[-1]
    message = " ".join(str(error).split())[:_LONGEST]
    text = f"{type(error).__name__}: {message}" if message else type(error).__name__
    return Defect(text, innermost.filename, innermost.lineno or 0, innermost.name)


def log_once(consequence: str, defect: Defect, logged: dict[str, Defect]) -> None:
    """Warn of a defect in its own place, unless one of that place has been `logged`; `consequence` is what
    could not be done."""
    if defect.place not in logged:
        logged[defect.place] = defect
        text = f"{consequence}, because of a defect in {defect}; please report it"
        warnings.warn_explicit(DefectWarning(text), None, defect.file, defect.line)


@contextmanager
def without_what_fails(consequence: str, logged: dict[str, Defect]) -> Iterator[None]:
    """Context that a defect ends early, and that logs it; an error that the user can fix is raised."""
    try:
        yield
    except TwinmatchError:
        raise
    except Exception as error:
        log_once(consequence, defect_of(error), logged)
