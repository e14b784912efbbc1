"""Verdicts as plain lines, for pipes and logs."""

from __future__ import annotations

import os
from typing import IO, TYPE_CHECKING

from twinmatch.comparing import Verdict
from twinmatch.showing.news import News
from twinmatch.showing.quantities import quantity
from twinmatch.showing.summary import Summary, sentence
from twinmatch.showing.table import STYLES, row
from twinmatch.twin import MatchReport

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["Lines", "closing_lines", "header_text", "line_text", "print_header", "print_line", "redraws"]

_NAMES = (
    "t / s",
    "level",
    "leader",
    "decided",
    "nominal",
    "order",
    "gain / characters",
    "ν-gap sum",
    "ν-gap to plant",
    "miss y / half band",
    "miss u / half band",
)
_LEADER = 45
"""Room for the name of a structure with three parts."""
_WIDTHS = tuple(_LEADER if name == "leader" else max(7, len(name)) for name in _NAMES)


def line_text(verdict: Verdict, period: float = 1.0) -> str:
    """One line: time, level, leader, nominal and figures in columns, then the fault's name and the reason.

    `period` is the sample time, s.
    """
    when, level, leader, nominal, *figures, why = row(verdict, period)
    decided = "–" if verdict.leader is None else "yes" if verdict.decided else "no"
    named = f"{verdict.fault}: " if verdict.fault else ""
    return _columns((when, level, leader, decided, nominal, *figures)) + " ".join(f"{named}{why}".split())


def header_text() -> str:
    """The column names with their units."""
    return f"{_columns(_NAMES)}why"


def print_line(console: Console, verdict: Verdict, period: float = 1.0) -> None:
    """Print a verdict on a console, in the colour of its level where there are colours."""
    from rich.text import Text  # noqa: PLC0415 — replay starts without it

    console.print(Text(line_text(verdict, period), style=STYLES[verdict.level]), soft_wrap=True)


def print_header(console: Console) -> None:
    """Print the column names."""
    from rich.text import Text  # noqa: PLC0415

    console.print(Text(header_text(), style="bold"), soft_wrap=True)


def closing_lines(summary: Summary, verdict: Verdict | None) -> list[str]:
    """The last lines of a run: notes, the meaning of leader and nominal, the plant's structure, the summary.

    `verdict` is the last one.
    """
    lines = [f"Note: {note}" for note in summary.notes]
    if verdict is not None and verdict.leader is not None:
        lines.append(
            "The leader is the twin to ask what comes next, the nominal one the centre of the family."
        )
    if verdict is not None and verdict.certainty:
        lines.append(f"Certainty: {verdict.certainty}.")
    if verdict is not None and verdict.structure:
        lines.append(f"Structure: the samples justify {verdict.structure}{_plant(verdict)}.")
    return [*lines, sentence(summary)]


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
        if self._console is None:
            print(header_text(), flush=True)
        else:
            print_header(self._console)

    def close(self, *, wipe: bool = False) -> None:
        """Do nothing: lines need no end and cannot be wiped; a `Screen` can."""

    def advance(self, done: int) -> None:
        """Do nothing: lines do not show progress."""

    def take_match(self, report: MatchReport) -> None:
        """Do nothing: the verdict on the match is printed."""

    def take_verdict(self, verdict: Verdict) -> None:
        """Print it if it says something new."""
        if not self._news.is_new(verdict):
            return
        if self._console is None:
            print(line_text(verdict, self._period), flush=True)
        else:
            print_line(self._console, verdict, self._period)

    def say(self, text: str, style: str = "") -> None:
        """Print a line of another program part."""
        if self._console is None:
            print(text, flush=True)
        else:
            self._console.print(text, style=style, markup=False, highlight=False, soft_wrap=True)


def _columns(cells: tuple[str, ...]) -> str:
    return "".join(f"{cell:<{width}}  " for cell, width in zip(cells, _WIDTHS, strict=True))


def _plant(verdict: Verdict) -> str:
    """The structure's parameters in brackets with their units; one that is 0 and not fitted is left out."""
    held = verdict.structure_parameters
    if held is None:
        return ""
    plant, fitted = held.model.plant, held.model.structure.free
    known = [(quantity(plant, name), held[name]) for name in held if held[name] or name in fitted]
    shown = [f"{q.symbol} {q.text(value)} {q.unit}".removesuffix(" 1") for q, value in known]
    return f" ({', '.join(shown)})"
