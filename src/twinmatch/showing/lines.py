"""Verdicts as plain lines, for pipes and logs."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import IO, TYPE_CHECKING, Final

from twinmatch.comparing import TrustLevel, Verdict, plant_fault
from twinmatch.printing import one_line
from twinmatch.showing.verdicts import COLUMNS, News, row
from twinmatch.twin import MatchReport

if TYPE_CHECKING:
    from twinmatch.showing.console import Console


STYLES: Final = {
    TrustLevel.UNKNOWN: "dim",
    TrustLevel.TRUSTED: "green",
    TrustLevel.DOUBTFUL: "yellow",
    TrustLevel.FAULT: "bold red",
}
"""rich style of each level."""

_INDENT = 8
_BELOW: Final = "why"
"""The column that stands below the others."""


def line_text(verdict: Verdict, period: float = 1.0) -> str:
    """Time, level, figures, nominal and leader in columns; below them the fault's name and the reason.

    `period` is the sample time, s. Gains are in characters, misses in half widths of the leader's bands.
    """
    cells = row(verdict, period)
    why = cells.pop(_BELOW)
    fault = plant_fault(verdict)
    evidence = why if fault is None else fault._replace(reason=why).with_reason
    reason = " ".join(evidence.split())
    return f"{_columns(cells)}\n{'':{_INDENT}}{reason}"


def header_text() -> str:
    """The column names, with their units where there is room."""
    headings = {}
    for name, column in COLUMNS.items():
        if name != _BELOW:
            has_room = len(name) <= column.width
            headings[name] = name if has_room else name.partition(" / ")[0]
    return _columns(headings)


def _columns(cells: Mapping[str, str]) -> str:
    """Cells, by the headings of their columns, side by side."""
    return "  ".join(
        f"{one_line(cell):<{COLUMNS[name].width}}" for name, cell in cells.items()
    )


def redraws(stream: IO[str]) -> bool:
    """Whether a view can be redrawn there: a terminal, and not a dumb one."""
    return stream.isatty() and os.environ.get("TERM", "").lower() not in {
        "dumb",
        "unknown",
    }


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

    def advance(self, count: int) -> None:
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
            self._console.print(text, style=style, soft_wrap=True)
