"""Tables of what happened and of the parameters that were found."""

from __future__ import annotations

import math
from collections.abc import Sequence

from twinmatch.discrimination import REFUSED, CandidateScore, Verdict
from twinmatch.matching import Match
from twinmatch.reporting.table import Cell, Table, head, words
from twinmatch.twin import MatchReport
from twinmatch.views.events import events, match_word
from twinmatch.views.family import Member
from twinmatch.views.intervals import interval, value_of
from twinmatch.views.quantities import QUANTITIES, Quantity, number, quantity

__all__ = ["event_table", "family_table", "match_table", "nominal_table", "structure_table"]


def event_table(verdicts: Sequence[Verdict], period: float) -> Table:
    """What happened, in order."""
    rows = tuple(
        (
            Cell(f"{event.sample * period:.0f}"),
            words(event.kind.value, mark=event.kind.name.lower()),
            words(event.title),
            words(event.why),
        )
        for event in events(verdicts)
    )
    return Table("What happened", ("t / s", "kind", "what", "why"), rows)


def nominal_table(score: CandidateScore, match: Match | None) -> Table:
    """The nominal twin's parameters with their intervals."""
    rows = []
    for q in QUANTITIES:
        if match is not None and q.name in match.free:
            value, *rest = _fitted(match, q)
        elif hasattr(score.parameters, q.name):
            origin = words("given" if match is None else "not fitted")
            value, *rest = (Cell(q.text(getattr(score.parameters, q.name))), Cell("–"), Cell("–"), origin)
        else:
            continue
        rows.append((head(q.symbol), words(q.words), value, words(q.unit), *rest))
    columns = ("symbol", "meaning", "value", "unit", "standard error", "95 % interval", "from")
    return Table(f"Parameters of the nominal twin, {score.name}", columns, tuple(rows))


def _fitted(match: Match, shown: Quantity) -> tuple[Cell, Cell, Cell, Cell]:
    known = interval(match, shown.name)
    return (
        Cell(shown.text(value_of(match, shown.name)), best=True),
        Cell(shown.error_text(known.error)),
        Cell(f"{shown.text(known.low)} to {shown.text(known.high)}" if known.known else "–"),
        words(_believed(match, shown.name)),
    )


def _believed(match: Match, name: str) -> str:
    if not match.believed:
        return "fitted"
    return "fitted, well determined" if name in match.believed else "fitted, hardly determined"


def structure_table(verdict: Verdict) -> Table | None:
    """The rig as the structure has it that the data pay for; None before structures were compared."""
    parameters = verdict.structure_parameters
    if parameters is None:
        return None
    rows = tuple(
        (head(q.symbol), words(q.words), Cell(q.text(getattr(parameters, q.name))), words(q.unit))
        for q in QUANTITIES
        if hasattr(parameters, q.name)
    )
    columns = ("symbol", "meaning", "value", "unit")
    return Table(f"The rig with the structure “{verdict.structure}”", columns, rows)


def family_table(members: Sequence[Member]) -> Table:
    """Parameters of every candidate with their 95 % half-widths."""
    names = _shown_names([m.match for m in members if m.match is not None], members)
    rows = []
    for m in members:
        cells = []
        for name in names:
            q = quantity(name)
            value = getattr(m.score.parameters, name, math.nan)
            if m.match is not None and name in m.match.free:
                known = interval(m.match, name)
                span = f" ({q.text(known.low)} to {q.text(known.high)})" if known.known else ""
                cells.append(Cell(q.text(value_of(m.match, name)) + span))
            else:
                cells.append(Cell(q.text(value)))
        rows.append(
            (
                head(m.score.name),
                Cell(f"{m.score.first} to {m.score.last}" if m.match else "given"),
                *cells,
                Cell(_percent(m.match.fit.y) if m.match else "–"),
                Cell(_percent(m.match.fit.u) if m.match else "–"),
            )
        )
    columns = (
        "candidate",
        "samples",
        *(quantity(n).label for n in names),
        "fit of y / %",
        "fit of u / %",
    )
    marked = frozenset(k for k, m in enumerate(members) if m.nominal)
    return Table("Parameters of the family, with 95 % intervals", columns, tuple(rows), marked)


def _shown_names(matches: Sequence[Match], members: Sequence[Member]) -> list[str]:
    """The free parameters of any match; without matches the four of the paper."""
    free = {name for match in matches for name in match.free}
    if not free and members:
        free = {"seebeck", "resistance", "conductance", "heat_capacity"}
    return [q.name for q in QUANTITIES if q.name in free]


def match_table(matches: Sequence[MatchReport], verdicts: Sequence[Verdict], period: float) -> Table:
    """Every match, admitted or refused, with why."""
    said = {v.sample: v.reason.removeprefix("match refused: ") for v in verdicts if v.match == REFUSED}
    names = [q.name for q in QUANTITIES if any(q.name in m.match.free for m in matches)]
    rows = []
    for report in matches:
        fitted = math.isfinite(report.match.chi2)
        cells = [
            Cell(quantity(n).text(value_of(report.match, n)) if fitted and n in report.match.free else "–")
            for n in names
        ]
        word = match_word(report, verdicts)
        rows.append(
            (
                Cell(f"{report.sample * period:.0f}"),
                Cell(f"{report.operating_point:g}"),
                words(word, mark=word.partition(":")[0]),
                *cells,
                Cell(_percent(report.match.fit.y)),
                Cell(_percent(report.match.fit.u)),
                words(said.get(report.sample, report.match.reason)),
            )
        )
    columns = (
        "t / s",
        "set / °C",
        "match",
        *(quantity(n).label for n in names),
        "fit y / %",
        "fit u / %",
        "why",
    )
    return Table("Every match of the session", columns, tuple(rows))


def _percent(fit: float) -> str:
    return number(100 * fit, 1)
