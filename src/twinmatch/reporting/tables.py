"""The tables of a report, as cells of text that a template only has to lay out."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from twinmatch.discrimination import CandidateScore, SimoModel, Verdict
from twinmatch.identification import BoxJenkins
from twinmatch.matching import Match
from twinmatch.signals import FloatArray
from twinmatch.twin import MatchReport
from twinmatch.views.criteria import OUTPUTS, Criterion, computed, criterion_rows
from twinmatch.views.events import STATUS_WORDS, events
from twinmatch.views.family import Member
from twinmatch.views.intervals import interval, value_of
from twinmatch.views.quantities import QUANTITIES, Quantity, number, quantity

__all__ = [
    "Cell",
    "Table",
    "coefficient_table",
    "criterion_tables",
    "event_table",
    "family_table",
    "gap_table",
    "match_table",
    "nominal_table",
    "order_table",
]


class Cell(NamedTuple):
    """One cell."""

    text: str
    best: bool = False
    """Set in bold."""
    head: bool = False
    """Names its row."""
    number: bool = True
    """Set flush right."""
    rows: int = 1
    """How many rows it spans."""
    mark: str = ""
    """A word for the style sheet."""


@dataclass(frozen=True)
class Table:
    """One table; what it means stands beside it in the template."""

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    marked: frozenset[int] = frozenset()
    """Rows that are set off."""

    @property
    def right(self) -> tuple[bool, ...]:
        """Whether the names of the columns are set flush right, as the figures below them are."""
        first = self.rows[0] if self.rows else ()
        return tuple(cell.number for cell in first) or (False,) * len(self.columns)


def words(text: str, *, mark: str = "") -> Cell:
    """A cell of words."""
    return Cell(text, number=False, mark=mark)


def head(text: str, rows: int = 1) -> Cell:
    """A cell that names its row, or several."""
    return Cell(text, head=True, number=False, rows=rows)


def event_table(matches: Sequence[MatchReport], verdicts: Sequence[Verdict], period: float) -> Table:
    """What happened, in order."""
    rows = tuple(
        (
            Cell(f"{event.sample * period:.0f}"),
            words(event.kind.value, mark=event.kind.name.lower()),
            words(event.title),
            words(event.why),
        )
        for event in events(matches, verdicts)
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


def match_table(matches: Sequence[MatchReport], period: float) -> Table:
    """Every match, accepted or refused, with why."""
    names = [q.name for q in QUANTITIES if any(q.name in m.match.free for m in matches)]
    rows = []
    for report in matches:
        fitted = math.isfinite(report.match.chi2)
        cells = [
            Cell(quantity(n).text(value_of(report.match, n)) if fitted and n in report.match.free else "–")
            for n in names
        ]
        mark = "accepted" if report.match.accepted else "refused"
        status = STATUS_WORDS.get(report.match.status, report.match.status.value)
        rows.append(
            (
                Cell(f"{report.sample * period:.0f}"),
                Cell(f"{report.operating_point:g}"),
                words(status, mark=mark),
                *cells,
                Cell(_percent(report.match.fit.y)),
                Cell(_percent(report.match.fit.u)),
                words(report.match.reason),
            )
        )
    columns = (
        "t / s",
        "set / °C",
        "gate",
        *(quantity(n).label for n in names),
        "fit y / %",
        "fit u / %",
        "why",
    )
    return Table("Every match of the session", columns, tuple(rows))


def criterion_tables(verdict: Verdict) -> list[Table]:
    """One for every candidate; of each criterion and output the best order is set in bold."""
    shown = computed(verdict.candidates)
    columns = ("output", "order", *(_column(c) for c in shown))
    return [
        Table(_criterion_caption(c, verdict), columns, _criterion_body(c, shown), _chosen_rows(c))
        for c in verdict.candidates
    ]


def _column(criterion: Criterion) -> str:
    return f"{criterion.name} / {criterion.unit}" if criterion.unit else criterion.name


def _criterion_caption(candidate: CandidateScore, verdict: Verdict) -> str:
    mark = ", nominal" if candidate.name == verdict.nominal else ""
    return f"Candidate {candidate.name}{mark}: order {candidate.chosen_order} chosen"


def _criterion_body(candidate: CandidateScore, shown: Sequence[Criterion]) -> tuple[tuple[Cell, ...], ...]:
    titles = dict(OUTPUTS)
    count = len(candidate.orders)
    rows = []
    for k, row in enumerate(criterion_rows(candidate, shown)):
        first = (head(titles[row.output], count),) if k % count == 0 else ()
        cells = (Cell(c.text, best=c.best) for c in row.cells)
        rows.append((*first, Cell(row.order, best=row.chosen, number=False), *cells))
    return tuple(rows)


def _chosen_rows(candidate: CandidateScore) -> frozenset[int]:
    return frozenset(k for k, row in enumerate(criterion_rows(candidate)) if row.chosen)


def order_table(verdict: Verdict) -> Table | None:
    """Akaike weights of the orders, both outputs together; None where they were not computed."""
    if not any(math.isfinite(o.weight) for c in verdict.candidates for o in c.orders):
        return None
    names = [o.order for o in verdict.candidates[0].orders]
    rows = []
    for c in verdict.candidates:
        best = max(o.weight for o in c.orders)
        weights = (Cell(number(o.weight, 3), best=o.weight == best) for o in c.orders)
        differences = (Cell(number(o.aic_difference, 1), best=o.weight == best) for o in c.orders)
        rows.append((head(c.name), *weights, *differences))
    columns = ("candidate", *(f"weight {n}" for n in names), *(f"ΔAIC {n}" for n in names))
    return Table("Akaike weights of the orders", columns, tuple(rows))


def gap_table(verdict: Verdict) -> Table:
    """The ν-gaps, their sums, and what else is known of every candidate's distance."""
    candidates = verdict.candidates
    least = min(c.nu_gap_sum for c in candidates)
    extra = _gap_extras(candidates)
    rows = []
    for k, c in enumerate(candidates):
        gaps = (Cell(number(v, 3)) for v in verdict.nu_gap[k])
        rows.append(
            (
                head(c.name),
                *gaps,
                Cell(number(c.nu_gap_sum, 3), best=c.nu_gap_sum == least),
                *(Cell(text(c)) for _, text in extra),
            )
        )
    columns = ("candidate", *(c.name for c in candidates), "Σ", *(name for name, _ in extra))
    marked = frozenset(k for k, c in enumerate(candidates) if c.name == verdict.nominal)
    return Table(f"ν-gap between the models of order {verdict.order}", columns, tuple(rows), marked)


def _gap_extras(candidates: Sequence[CandidateScore]) -> list[tuple[str, Callable[[CandidateScore], str]]]:
    """Columns that are there only when at least one candidate has a figure for them."""
    known: list[tuple[str, Callable[[CandidateScore], str]]] = [
        ("90 % interval of Σ", lambda c: _span(c.nu_gap_sum_low, c.nu_gap_sum_high)),
        ("P(nominal)", lambda c: number(c.nominal_probability, 2)),
        ("to the plant now", lambda c: number(c.nu_gap_to_plant, 3)),
        ("margin b(P, C)", lambda c: number(c.margin, 3)),
        ("plant to nominal's plant", lambda c: number(c.plant_gap_to_nominal, 3)),
    ]
    return [(name, text) for name, text in known if any(text(c) != number(None) for c in candidates)]


def _span(low: float, high: float) -> str:
    return number(None) if math.isnan(low) else f"{number(low, 3)} to {number(high, 3)}"


def coefficient_table(member: Member) -> Table:
    """B, C, D and F of every order, set-point to temperature and to control, as in the paper's table."""
    models = member.models
    rows = []
    for output, title in OUTPUTS[:2]:
        for k, polynomial in enumerate(("B", "C", "D", "F")):
            first = (head(title, 4),) if k == 0 else ()
            cells = (words(coefficients(getattr(_model(m, output), polynomial)), mark="poly") for m in models)
            rows.append((*first, head(polynomial), *cells))
    columns = ("output", "", *(f"order {m.order}" for m in models))
    mark = ", nominal" if member.nominal else ""
    return Table(f"Box–Jenkins models of candidate {member.score.name}{mark}", columns, tuple(rows))


def coefficients(values: FloatArray) -> str:
    """A polynomial in q⁻¹, constant first, to six significant digits."""
    return "  ".join(f"{v:.6g}".replace("-", "−") for v in values.tolist())


def _model(model: SimoModel, output: str) -> BoxJenkins:
    return model.y if output == "y" else model.u


def _percent(fit: float) -> str:
    return number(100 * fit, 1)
