"""Verdicts as plain lines, for pipes and logs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import IO, TYPE_CHECKING, Final

from twinmatch.comparing import TrustLevel, Verdict
from twinmatch.showing.verdicts import COLUMNS, News, row
from twinmatch.twin import MatchReport

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["STYLES", "Lines", "header_text", "line_text", "redraws"]

STYLES: Final = {
    TrustLevel.UNKNOWN: "dim",
    TrustLevel.TRUSTED: "green",
    TrustLevel.DOUBTFUL: "yellow",
    TrustLevel.FAULT: "bold red",
}
"""rich style of each level."""

_NAMES = (*COLUMNS[:3], "decided", *COLUMNS[3:-1])
_LEADER = 45
"""Room for the name of a structure with three parts."""


def line_text(verdict: Verdict, period: float = 1.0) -> str:
    """One line: time, level, leader, nominal and figures in columns, then the fault's name and the reason.

    `period` is the sample time, s.
    """
    when, level, leader, *figures, why = row(verdict, period)
    decided = "–" if verdict.leader is None else "yes" if verdict.decided else "no"
    named = f"{verdict.fault}: " if verdict.fault else ""
    return _columns((when, level, leader, decided, *figures)) + " ".join(f"{named}{why}".split())


def header_text() -> str:
    """The column names with their units."""
    return _columns(_NAMES) + COLUMNS[-1]


def _columns(cells: Sequence[str]) -> str:
    widths = (_LEADER if name == "leader" else max(7, len(name)) for name in _NAMES)
    return "".join(f"{cell:<{width}}  " for cell, width in zip(cells, widths, strict=True))


def redraws(stream: IO[str]) -> bool:
    """Whether a view can be redrawn there: a terminal, and not a dumb one."""
    return stream.isatty() and os.environ.get("TERM", "").lower() not in {"dumb", "unknown"}


class Lines:
    """Prints a run line by line: each verdict that says something new."""

    def __init__(self, period: float = 1.0, console: Console | None = None) -> None:
        """Print on a console, or without one (and without `rich`) on standard output."""
        self._period = period
        self._console = console
        self._news = News()

    def open(self) -> None:
        """Print the column names."""
        self.say(header_text(), "bold")

    def close(self, *, wipe: bool = False) -> None:
        """Do nothing: lines need no end and cannot be wiped; a `Screen` can."""

    def advance(self, done: int) -> None:
        """Do nothing: lines do not show progress."""

    def take_match(self, report: MatchReport) -> None:
        """Do nothing: the verdict on the match is printed."""

    def take_verdict(self, verdict: Verdict) -> None:
        """Print it if it says something new, in the colour of its level where there are colours."""
        if self._news.is_new(verdict):
            self.say(line_text(verdict, self._period), STYLES[verdict.level])

    def say(self, text: str, style: str = "") -> None:
        """Print a line of another program part."""
        if self._console is None:
            print(text, flush=True)
        else:
            self._console.print(text, style=style, markup=False, highlight=False, soft_wrap=True)
