"""A run on a terminal, redrawn while it lasts: progress, level, family, newest events."""

from __future__ import annotations

import time
from collections import deque
from datetime import timedelta

from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from twinmatch.comparing import TrustLevel, Verdict
from twinmatch.showing.events import Event, EventKind, events
from twinmatch.showing.family_table import LEGEND, believed_of, family_table
from twinmatch.showing.line import Lines, redraws
from twinmatch.showing.quantities import number
from twinmatch.showing.standing import nominal_score
from twinmatch.showing.style import LEVEL_WORDS
from twinmatch.showing.table import STYLES
from twinmatch.showing.words import leader_words, missed
from twinmatch.twin import MatchReport

__all__ = ["Screen", "view_on"]

LEAST_WAIT = 0.25
"""Shortest time between two drawings, s."""
QUARTERS = 4
"""A run is drawn at least after each of these parts, so that even a short run shows progress."""
SHARE = 0.01
"""Most time that drawing may take, as a share of the whole."""
MOST_EVENTS = 8
MOST_MATCHES = 100
"""Newest matches that are kept, besides those of the current candidates."""
BAR = 30
"""Width of the progress bar, characters."""
_MARKS = {
    EventKind.ADMITTED: ("✓", "green"),
    EventKind.REFUSED: ("✗", "yellow"),
    EventKind.DISMISSED: ("✗", "yellow"),
    EventKind.LEADER: ("▶", "bold"),
    EventKind.NOMINAL: ("○", "bold"),
    EventKind.LEVEL: ("●", "bold"),
    EventKind.FAULT: ("!", "bold red"),
}


class Screen:
    """Shows a run; has the same methods as `Lines`.

    Its methods draw, in the caller's thread, when the last drawing is long enough ago.
    """

    def __init__(self, console: Console, title: str, period: float = 1.0, total: int | None = None) -> None:
        """Show a run of `total` samples (None: not known), `period` seconds apart."""
        self._console = console
        self._title = title
        self._period = period
        self._total = total
        self._done = self._part = 0
        self._matches: list[MatchReport] = []
        self._verdict: Verdict | None = None
        self._events: deque[Event] = deque(maxlen=MOST_EVENTS)
        self._next = 0.0
        self._over = False
        self._live = Live(
            self, console=console, auto_refresh=False, redirect_stdout=False, redirect_stderr=False
        )

    def open(self) -> None:
        """Start drawing."""
        self._live.start()
        self._draw()

    def close(self, *, wipe: bool = False) -> None:
        """Draw a last time and leave it there, or wipe it away; a second call does nothing."""
        self._over = True
        self._live.transient = wipe
        self._live.stop()

    def advance(self, done: int) -> None:
        """Note the number of samples processed since the start of the session."""
        self._done = done
        part = QUARTERS * done // self._total if self._total else 0
        if part > self._part or time.monotonic() >= self._next:
            self._part = part
            self._draw()

    def take_match(self, report: MatchReport) -> None:
        """Keep the match for the marks in the family table; its result comes with the verdict."""
        self._matches.append(report)
        if len(self._matches) > 2 * MOST_MATCHES:
            standing = {(c.first, c.last) for c in self._verdict.candidates} if self._verdict else set()
            old, new = self._matches[:-MOST_MATCHES], self._matches[-MOST_MATCHES:]
            self._matches = [report for report in old if report.match.samples in standing] + new

    def take_verdict(self, verdict: Verdict) -> None:
        """Show this verdict from now on."""
        before = () if self._verdict is None else (self._verdict,)
        self._events += events((*before, verdict))[len(events(before)) :]
        self._verdict = verdict

    def say(self, text: str, style: str = "") -> None:
        """Print a line of another program part above the view."""
        self._console.print(Text(text, style=style))

    def _draw(self) -> None:
        began = time.monotonic()
        if self._live.is_started:
            self._live.refresh()
        ended = time.monotonic()
        self._next = ended + max(LEAST_WAIT, (ended - began) / SHARE)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        verdict = self._verdict
        lines = console.render_lines(Group(*self._fixed(verdict, options.max_width)), options, pad=False)
        room = MOST_EVENTS if self._over else console.size.height - len(lines) - 2
        lines += self._newest(console, options, room)
        for line in lines:
            yield from line
            yield Segment.line()

    def _fixed(self, verdict: Verdict | None, width: int) -> list[RenderableType]:
        shown: list[RenderableType] = [self._progress(width), _headline(verdict, self._period)]
        if verdict is not None and verdict.candidates:
            table = family_table(verdict, believed_of(self._matches), width)
            shown += [Text(), table, Text(LEGEND, style="dim")]
        return shown

    def _progress(self, width: int) -> RenderableType:
        parts: list[RenderableType] = [Text(self._title, style="bold")]
        plant_time = str(timedelta(seconds=int(self._done * self._period)))
        if self._total is None:
            parts.append(Text(f"plant time {plant_time} h, {self._done} samples"))
        else:
            whole = str(timedelta(seconds=int(self._total * self._period)))
            if width > 2 * BAR + len(self._title):
                parts.append(ProgressBar(max(self._total, 1), self._done, width=BAR))
            share = 100 * self._done / max(self._total, 1)
            parts.append(Text(f"{number(share, 0)} %, {plant_time} of {whole} h"))
        grid = Table.grid(padding=(0, 2, 0, 0))
        grid.add_row(*parts)
        return grid

    def _newest(self, console: Console, options: ConsoleOptions, room: int) -> list[list[Segment]]:
        """The newest events that fit, oldest first."""
        shown: list[list[Segment]] = []
        for event in reversed(self._events):
            lines = console.render_lines(_event_line(event, self._period), options, pad=False)
            if len(shown) + len(lines) > room and not self._over:
                if not shown:  # part of the newest event is better than nothing
                    shown = lines[: max(room, 0)]
                break
            shown = lines + shown
        return [[], *shown] if shown else []


def view_on(console: Console, title: str, period: float = 1.0, total: int | None = None) -> Screen | Lines:
    """A view that is redrawn where the console supports it, otherwise lines."""
    if console.is_terminal and redraws(console.file):
        # A separate console: the given one may not wrap and would draw past the terminal's edge.
        return Screen(Console(file=console.file, highlight=False), title, period, total)
    return Lines(period, console)


def _headline(verdict: Verdict | None, period: float) -> RenderableType:
    """Level, leader, nominal, fault and reason, each after its label."""
    level = TrustLevel.UNKNOWN if verdict is None else verdict.level
    grid = Table.grid(padding=(0, 2, 0, 0))
    grid.add_row(
        "level",
        Text.assemble(
            (f" {level.value.upper()} ", f"{STYLES[level]} reverse"),
            (f"  {LEVEL_WORDS[level]}", STYLES[level]),
        ),
    )
    if verdict is None:
        grid.add_row("verdict", "none yet")
        return grid
    grid.add_row("leader", _leader(verdict))
    grid.add_row("nominal", _nominal(verdict))
    if verdict.fault:
        since = "" if verdict.fault_since is None else f" since {number(verdict.fault_since * period, 0)} s"
        grid.add_row("fault", Text(f"{verdict.fault}{since}", style=STYLES[TrustLevel.FAULT]))
    if verdict.leader is not None:
        grid.add_row("forecasts", Text(missed(verdict)))
    grid.add_row("verdict", Text(f"at {number(verdict.sample * period, 0)} s: {verdict.reason}"))
    return grid


def _nominal(verdict: Verdict) -> Text:
    chosen = nominal_score(verdict)
    if chosen is None:
        return Text("none yet")
    return Text.assemble((chosen.name, "bold"), f"  probability {number(chosen.nominal_probability, 2)}")


def _leader(verdict: Verdict) -> Text:
    if verdict.leader is None:
        return Text("none yet")
    sure = "decided" if verdict.decided else "not decided: the data do not show which twin forecasts best"
    return Text(f"{leader_words(verdict)}; {sure}")


def _event_line(event: Event, period: float) -> RenderableType:
    mark, style = _MARKS[event.kind]
    if event.kind is EventKind.LEVEL:
        style = next((s for level, s in STYLES.items() if level.value == event.title), style)
    why = f": {event.why}" if event.why else ""
    grid = Table.grid(padding=(0, 1, 0, 0))
    when = f"{number(event.sample * period, 0):>6} s"
    grid.add_row(when, Text(mark, style=style), Text.assemble((event.title, style), (why, "dim")))
    return grid
