"""A run on a terminal, redrawn while it lasts: progress, level, family, newest events."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from datetime import timedelta
from typing import Final, NamedTuple

from rich.cells import cell_len
from rich.console import Console as AnyConsole
from rich.console import ConsoleOptions, Group, RenderableType, RenderResult
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from twinmatch.comparing import CandidateScore, TrustLevel, Verdict, statements_of
from twinmatch.compiled import told
from twinmatch.offline.summary import nominal_score
from twinmatch.settings import Rule
from twinmatch.shipped_code import why_not_used
from twinmatch.showing.console import Console
from twinmatch.showing.family import (
    FamilyTable,
    FigureColumn,
    chosen_score,
    family_table_of,
)
from twinmatch.showing.lines import STYLES
from twinmatch.showing.quantities import ParameterFormat, number, percent, point_number
from twinmatch.showing.verdicts import (
    Event,
    EventKind,
    events_since,
    leader_words,
    missed,
    trust_by_signal,
)
from twinmatch.signals import time_text
from twinmatch.twin import MatchReport


class _Pace(Rule):
    """How often the view is drawn."""

    shortest: float = 0.25
    """Shortest time between two drawings, s."""
    parts: int = 4
    """A run is drawn at least after each of these parts, so that even a short run shows progress."""
    share: float = 0.01
    """Most time that drawing may take, as a share of the whole."""


_PACE: Final = _Pace()


MAX_EVENTS = 8
MAX_MATCHES = 100
"""Newest matches that are kept, besides those of the current candidates."""
BAR = 30
"""Width of the progress bar, characters."""
_MARKS: Final = {
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

    def __init__(
        self,
        console: Console,
        title: str,
        period: float = 1.0,
        total: int | None = None,
    ) -> None:
        """Show a run of `total` samples (None: not known), `period` seconds apart."""
        self._console = console
        self._title = title
        self._period = period
        self._total = total
        self._done = self._part = 0
        self._matches: list[MatchReport] = []
        self._verdict: Verdict | None = None
        self._events: deque[Event] = deque(maxlen=MAX_EVENTS)
        self._next = 0.0  # when to draw again
        self._over = False
        self._compiled = ""
        self._has_compiled = False
        self._live = Live(
            self,
            console=console,
            auto_refresh=False,
            redirect_stdout=False,
            redirect_stderr=False,
        )

    def open(self) -> None:
        """Start drawing."""
        told.append(self._compile)
        self._live.start()
        self._draw()

    def close(self, *, wipe: bool = False) -> None:
        """Draw a last time and leave it there, or wipe it away; a second call does nothing, nor does one for a
        run that failed before it was opened."""
        if self._compile in told:
            told.remove(self._compile)
        self._over = True
        self._live.transient = wipe
        self._live.stop()

    def advance(self, count: int) -> None:
        """Note the number of samples processed since the start of the session."""
        self._done = count
        self._compiled = ""
        part = _PACE.parts * count // self._total if self._total else 0
        if part > self._part or time.monotonic() >= self._next:
            self._part = part
            self._draw()

    def take_match(self, report: MatchReport) -> None:
        """Keep the match for the marks in the family table; its result comes with the verdict."""
        self._matches.append(report)
        if len(self._matches) > 2 * MAX_MATCHES:
            standing = (
                {(c.first, c.last) for c in self._verdict.candidates}
                if self._verdict
                else set()
            )
            old = self._matches[:-MAX_MATCHES]
            new = self._matches[-MAX_MATCHES:]
            self._matches = [
                report for report in old if report.match.samples in standing
            ] + new

    def take_verdict(self, verdict: Verdict) -> None:
        """Show this verdict from now on."""
        self._events += events_since(self._verdict, verdict)
        self._verdict = verdict

    def say(self, text: str, style: str = "") -> None:
        """Print a line of another program part above the view."""
        self._console.print(Text(text, style=style))

    def _compile(self, kernel: str) -> None:
        remark = "" if self._has_compiled else why_not_used()
        self._has_compiled = True
        if remark:
            self.say(f"twinmatch: {remark}")
        self._compiled = kernel
        self._draw()

    def _draw(self) -> None:
        began = time.monotonic()
        if self._live.is_started:
            self._live.refresh()
        ended = time.monotonic()
        self._next = ended + max(_PACE.shortest, (ended - began) / _PACE.share)

    def __rich_console__(
        self, console: AnyConsole, options: ConsoleOptions
    ) -> RenderResult:
        verdict = self._verdict
        lines = console.render_lines(
            Group(*self._fixed(verdict, options.max_width)), options, pad=False
        )
        room = MAX_EVENTS if self._over else console.size.height - len(lines) - 2
        lines += self._newest(console, options, room)
        for line in lines:
            yield from line
            yield Segment.line()

    def _fixed(self, verdict: Verdict | None, width: int) -> list[RenderableType]:
        """What stands above the events: progress, verdict, and the tables of signals and candidates."""
        shown: list[RenderableType] = [
            self._progress(width),
            _headline(verdict, self._period),
        ]
        if self._compiled:
            shown.append(
                Text(f"compiling {self._compiled} once on this machine", style="dim")
            )
        if trust_of_signals := trust_by_signal(verdict):
            shown += [Text(), signal_table(trust_of_signals)]
        if verdict is not None and verdict.family:
            accepted = [
                report.match for report in self._matches if report.match.accepted
            ]
            determined = {
                m.samples: m.believed for m in accepted if m.samples is not None
            }
            shown += [
                Text(),
                family_table(verdict, determined, width),
                Text(LEGEND, style="dim"),
            ]
        return shown

    def _progress(self, width: int) -> RenderableType:
        parts: list[RenderableType] = [Text(self._title, style="bold")]
        plant_time = str(timedelta(seconds=int(self._done * self._period)))
        if self._total is None:
            parts.append(Text(f"plant time {plant_time} h, {self._done} samples"))
        else:
            whole = timedelta(seconds=int(self._total * self._period))
            total = max(self._total, 1)
            if width > 2 * BAR + len(self._title):
                parts.append(ProgressBar(total, self._done, width=BAR))
            parts.append(
                Text(f"{percent(self._done / total, 0)} %, {plant_time} of {whole} h")
            )
        grid = Table.grid(padding=(0, 2, 0, 0))
        grid.add_row(*parts)
        return grid

    def _newest(
        self, console: AnyConsole, options: ConsoleOptions, room: int
    ) -> list[list[Segment]]:
        """The newest events that fit, oldest first."""
        shown: list[list[Segment]] = []
        for event in reversed(self._events):
            lines = console.render_lines(
                _event_line(event, self._period), options, pad=False
            )
            if len(shown) + len(lines) > room and not self._over:
                if not shown:  # part of the newest event is better than nothing
                    shown = lines[: max(room, 0)]
                break
            shown = lines + shown
        return [[], *shown] if shown else []


def _headline(verdict: Verdict | None, period: float) -> RenderableType:
    """Level, leader, nominal, fault and reason, each after its label."""
    trust, fault, _ = statements_of(verdict)
    style = STYLES[trust.level]
    grid = Table.grid(padding=(0, 2, 0, 0))
    badge = (f" {trust.level.value.upper()} ", f"{style} reverse")
    grid.add_row("level", Text.assemble(badge, (f"  {trust.reason}", style)))
    if verdict is None:
        grid.add_row("verdict", "none yet")
        return grid
    sure = (
        "decided"
        if verdict.decided
        else "not decided: the data do not show which twin forecasts best"
    )
    grid.add_row(
        "leader",
        Text(
            leader_words(verdict) + (f"; {sure}" if verdict.leader is not None else "")
        ),
    )
    chosen = nominal_score(verdict)
    probable = (
        "" if chosen is None else f"  probability {number(chosen.nominal_probability)}"
    )
    grid.add_row(
        "nominal",
        Text.assemble((chosen.name, "bold"), probable) if chosen else Text("none yet"),
    )
    if fault is not None:
        grid.add_row(
            "fault", Text(fault.with_begin(period), style=STYLES[TrustLevel.FAULT])
        )
    if verdict.leader is not None:
        grid.add_row("forecasts", Text(missed(verdict)))
    grid.add_row(
        "verdict", Text(f"at {time_text(verdict.sample, period)} s: {verdict.reason}")
    )
    return grid


def _event_line(event: Event, period: float) -> RenderableType:
    mark, style = _MARKS[event.kind]
    if event.kind is EventKind.LEVEL:
        style = STYLES[TrustLevel(event.title)]
    why = f": {event.why}" if event.why else ""
    grid = Table.grid(padding=(0, 1, 0, 0))
    when = f"{time_text(event.sample or 0, period):>6} s"
    grid.add_row(
        when, Text(mark, style=style), Text.assemble((event.title, style), (why, "dim"))
    )
    return grid


LEGEND = "▶ leader; ○ nominal; * known within a factor of two from its window"
"""Meaning of the marks in the table."""
_GAP = 2
"""Spaces between two columns."""

WellDetermined = Mapping[tuple[int, int], Sequence[str]]
"""Names of well determined parameters, by first and last sample of the window they were matched on."""


_FREE: Final = "parameters"
_BY_PRIORITY: Final = (
    "candidate",
    "order",
    "Σ ν-gap",
    "P(nominal)",
    _FREE,
    "gain",
    "at",
    "margin",
    "90 % of Σ",
    "nAIC",
    "BIC",
    "MDL",
    "ν-gap now",
)
"""Names of the columns; where there is no room for all, the last are left out first."""


class FamilyColumn(NamedTuple):
    """One column of the table of candidates."""

    name: str
    unit: str
    text_of: Callable[[CandidateScore, Sequence[str]], str]
    """Text for a candidate and the names of its well determined parameters."""

    @property
    def head(self) -> str:
        """Name, with the unit below it."""
        return f"{self.name}\n{self.unit}" if self.unit.strip() else self.name

    @property
    def priority(self) -> int:
        """Its place among the columns that are kept."""
        return _BY_PRIORITY.index(self.name if self.name in _BY_PRIORITY else _FREE)


def family_table(verdict: Verdict, determined: WellDetermined, width: int) -> Table:
    """The candidates with the columns that fit into `width` characters, chosen by priority."""
    family = verdict.family
    columns = _family_columns(verdict)
    parameters = [determined.get((c.first, c.last), ()) for c in family]
    texts = [list(map(column.text_of, family, parameters)) for column in columns]
    widths = [
        _width(column.head, cells) for column, cells in zip(columns, texts, strict=True)
    ]
    table = Table(
        box=None, padding=(0, _GAP, 0, 0), pad_edge=False, header_style="bold"
    )
    chosen = _fitting([column.priority for column in columns], widths, width)
    for k in chosen:
        table.add_column(
            columns[k].head, no_wrap=True, justify="right" if k else "left"
        )
    for row, candidate in enumerate(family):
        style = "bold" if candidate.name in {verdict.leader, verdict.nominal} else ""
        table.add_row(*(texts[k][row] for k in chosen), style=style)
    return table


def _width(head: str, cells: Sequence[str]) -> int:
    return max(map(cell_len, (*head.split("\n"), *cells)))


def signal_table(rows: Sequence[Mapping[str, str]]) -> Table:
    """How far to trust the forecasts of each of several signals."""
    table = Table(
        box=None, padding=(0, _GAP, 0, 0), pad_edge=False, header_style="bold"
    )
    for head in rows[0]:
        table.add_column(head, justify="left" if head == "signal" else "right")
    for row in rows:
        table.add_row(*row.values())
    return table


def _fitting(
    priorities: Sequence[float], widths: Sequence[int], room: int
) -> list[int]:
    """As many columns as have room, chosen by priority, in the order of the table; always at least one."""
    room += _GAP  # there is none after the last column
    chosen: list[int] = []
    for k in sorted(range(len(widths)), key=priorities.__getitem__):
        if not chosen or widths[k] + _GAP <= room:
            chosen.append(k)
            room -= widths[k] + _GAP
    return sorted(chosen)


def _family_columns(verdict: Verdict) -> list[FamilyColumn]:
    """All columns, in the order of the table; the parameters are those that the structure leaves free."""

    def candidate(c: CandidateScore, _: Sequence[str]) -> str:
        marks = ("▶" if c.name == verdict.leader else " ") + (
            "○" if c.name == verdict.nominal else " "
        )
        return f"{marks} {c.name}"

    def of_both(column: FigureColumn) -> FamilyColumn:
        def text(c: CandidateScore, _: Sequence[str]) -> str:
            score = chosen_score(c)
            return column.text(score.total) if score else ""

        return FamilyColumn(column.name, column.unit, text)

    def figure(column: FigureColumn) -> FamilyColumn:
        return FamilyColumn(column.name, column.unit, lambda c, _: column.text(c))

    def point(c: CandidateScore, _: Sequence[str]) -> str:
        return point_number(c.operating_point, c.parameters.model.plant)

    table = family_table_of(verdict)
    columns = [
        FamilyColumn("candidate", "", candidate),
        FamilyColumn("at", table.point, point),
    ]
    columns += [_parameter(table, shown) for shown in table.parameters]
    if verdict.modelled:
        columns.append(FamilyColumn("order", "", lambda c, _: c.chosen_order))
    columns += [
        of_both(criterion)
        for criterion in table.criteria
        if criterion.name in _BY_PRIORITY
    ]
    return [*columns, *map(figure, table.figures)]


def _parameter(table: FamilyTable, shown: ParameterFormat) -> FamilyColumn:
    def text(candidate: CandidateScore, determined: Sequence[str]) -> str:
        return table.parameter(candidate, shown) + (
            "*" if shown.name in determined else " "
        )

    # The spaces leave room for the mark after the value.
    return FamilyColumn(f"{shown.symbol} ", f"{shown.unit} ", text)
