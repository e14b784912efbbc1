"""Tables of events, matches and parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence

from twinmatch.comparing import REFUSED, CandidateScore, Verdict
from twinmatch.fitting import Match
from twinmatch.showing.events import events, match_word
from twinmatch.showing.family import Member
from twinmatch.showing.intervals import interval, value_of
from twinmatch.showing.quantities import Quantity, in_order, number, quantity
from twinmatch.showing.report.table import Cell, Table, head, words
from twinmatch.twin import MatchReport

__all__ = ["event_table", "family_table", "match_table", "nominal_table", "structure_table"]


def event_table(verdicts: Sequence[Verdict], period: float) -> Table:
    """The events of the session, in order of time."""
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
    plant, free = score.parameters.model.plant, match.free if match is not None else ()
    rows = []
    for name in in_order(plant, (*score.parameters, *free)):
        q = quantity(plant, name)
        if match is not None and name in free:
            value, *rest = _fitted(match, q)
        else:
            origin = words("candidate file" if match is None else "not fitted")
            value, *rest = (Cell(q.text(score.parameters[name])), Cell("–"), Cell("–"), origin)
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
    return "fitted, well determined" if name in match.believed else "fitted, poorly determined"


def structure_table(verdict: Verdict) -> Table | None:
    """Parameters of the structure that the data support; None before structures were compared."""
    parameters = verdict.structure_parameters
    if parameters is None:
        return None
    shown = [(quantity(parameters.model.plant, name), value) for name, value in parameters.items()]
    rows = tuple((head(q.symbol), words(q.words), Cell(q.text(value)), words(q.unit)) for q, value in shown)
    columns = ("symbol", "meaning", "value", "unit")
    return Table(f"{parameters.model.plant.title} with the structure “{verdict.structure}”", columns, rows)


def family_table(members: Sequence[Member]) -> Table:
    """Parameters of every candidate with their 95 % intervals."""
    shown, closed = _shown(members), any(m.settings.gains is not None for m in members)
    rows = []
    for m in members:
        cells = []
        for q in shown:
            name, value = q.name, m.score.parameters.get(q.name, math.nan)
            if m.match is not None and name in m.match.free:
                known = interval(m.match, name)
                span = f" ({q.text(known.low)} to {q.text(known.high)})" if known.known else ""
                cells.append(Cell(q.text(value_of(m.match, name)) + span))
            else:
                cells.append(Cell(q.text(value)))
        rows.append(
            (
                head(m.score.name),
                Cell(f"{m.score.first} to {m.score.last}" if m.match else "candidate file"),
                *cells,
                Cell(_percent(m.match.fit.y) if m.match else "–"),
                *([Cell(_percent(m.match.fit.u) if m.match else "–")] if closed else []),
            )
        )
    columns = (
        "candidate",
        "samples",
        *(q.label for q in shown),
        "fit of y / %",
        *(["fit of u / %"] if closed else []),
    )
    marked = frozenset(k for k, m in enumerate(members) if m.nominal)
    return Table("Parameters of the family, with 95 % intervals", columns, tuple(rows), marked)


def _shown(members: Sequence[Member]) -> list[Quantity]:
    """The free parameters of all matches; without matches those of the structures."""
    free = [m.match.free for m in members if m.match is not None]
    free = free or [m.score.parameters.model.structure.free for m in members]
    if not members:
        return []
    plant = members[0].score.parameters.model.plant
    return [quantity(plant, name) for name in in_order(plant, {name for names in free for name in names})]


def match_table(
    matches: Sequence[MatchReport], verdicts: Sequence[Verdict], period: float, *, closed: bool = True
) -> Table:
    """Every match, admitted or refused, and why; `closed`: whether the loop is known."""
    reasons = {v.sample: v.reason.removeprefix("match refused: ") for v in verdicts if v.match == REFUSED}
    shown = []
    if matches:
        plant = matches[0].match.parameters.model.plant
        names = in_order(plant, {name for m in matches for name in m.match.free})
        shown = [quantity(plant, name) for name in names]
    rows = []
    for report in matches:
        fitted = math.isfinite(report.match.chi2)
        cells = [
            Cell(q.text(value_of(report.match, q.name)) if fitted and q.name in report.match.free else "–")
            for q in shown
        ]
        word = match_word(report, verdicts)
        rows.append(
            (
                Cell(f"{report.sample * period:.0f}"),
                Cell(f"{report.operating_point:g}"),
                words(word, mark=word.partition(":")[0]),
                *cells,
                Cell(_percent(report.match.fit.y)),
                *([Cell(_percent(report.match.fit.u))] if closed else []),
                words(reasons.get(report.sample, report.match.reason)),
            )
        )
    columns = (
        "t / s",
        "set-point" if closed else "operating point",
        "match",
        *(q.label for q in shown),
        "fit y / %",
        *(["fit u / %"] if closed else []),
        "why",
    )
    return Table("Every match of the session", columns, tuple(rows))


def _percent(fit: float) -> str:
    return number(100 * fit, 1)
