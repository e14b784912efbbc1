"""Tables of the Box–Jenkins models: criteria, ν-gaps, coefficients."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from twinmatch.comparing import CandidateScore, SimoModel, Verdict
from twinmatch.fitting import BoxJenkins
from twinmatch.showing.criteria import Criterion, computed, criterion_rows, outputs_of
from twinmatch.showing.family import Member
from twinmatch.showing.quantities import number
from twinmatch.showing.report.table import Cell, Table, head, words
from twinmatch.signals import FloatArray

__all__ = ["coefficient_table", "criterion_tables", "gap_table", "identified_table", "order_table"]

_Extra = tuple[str, Callable[[CandidateScore], str]]
"""Name of a column, and its text for a candidate."""


def criterion_tables(verdict: Verdict) -> list[Table]:
    """One table per candidate; the best order by each criterion and output is bold."""
    shown = computed(verdict.candidates)
    columns = ("output", "order", *(_column(c) for c in shown))
    return [
        Table(_criterion_caption(c, verdict), columns, _criterion_body(c, shown), _chosen_rows(c))
        for c in verdict.modelled
    ]


def _column(criterion: Criterion) -> str:
    return f"{criterion.name} / {criterion.unit}" if criterion.unit else criterion.name


def _criterion_caption(candidate: CandidateScore, verdict: Verdict) -> str:
    mark = ", nominal" if candidate.name == verdict.nominal else ""
    return f"Candidate {candidate.name}{mark}: order {candidate.chosen_order} chosen"


def _criterion_body(candidate: CandidateScore, shown: Sequence[Criterion]) -> tuple[tuple[Cell, ...], ...]:
    titles = dict(outputs_of(candidate.orders))
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
    """Akaike weights of the orders, for both outputs together; None where they were not computed."""
    if not any(math.isfinite(o.weight) for c in verdict.candidates for o in c.orders):
        return None
    names = [o.order for o in verdict.modelled[0].orders]
    rows = []
    for c in verdict.modelled:
        best = max(o.weight for o in c.orders)
        weights = (Cell(number(o.weight, 3), best=o.weight == best) for o in c.orders)
        differences = (Cell(number(o.aic_difference, 1), best=o.weight == best) for o in c.orders)
        rows.append((head(c.name), *weights, *differences))
    columns = ("candidate", *(f"weight {n}" for n in names), *(f"ΔAIC {n}" for n in names))
    return Table("Akaike weights of the orders", columns, tuple(rows))


def gap_table(verdict: Verdict) -> Table:
    """The ν-gaps, their sums, and further distances and probabilities of every candidate."""
    title, extra = "ν-gap between the plants", _gap_extras(verdict.candidates)
    sums = [c.nu_gap_sum for c in verdict.candidates]
    return _distances(title, verdict.candidates, verdict.nu_gap, sums, extra, nominal=verdict.nominal)


def identified_table(verdict: Verdict) -> Table:
    """The ν-gaps between the models identified on the twins, as in the paper."""
    sums = [c.identified_gap_sum for c in verdict.modelled]
    extra: list[_Extra] = [("to the newest window's model", lambda c: number(c.identified_gap_to_plant, 3))]
    title = f"ν-gap between the models of order {verdict.order}"
    return _distances(title, verdict.modelled, verdict.identified_gap, sums, extra, nominal=verdict.nominal)


def _distances(
    title: str,
    candidates: Sequence[CandidateScore],
    matrix: Sequence[Sequence[float]],
    sums: Sequence[float],
    extra: Sequence[_Extra],
    *,
    nominal: str | None,
) -> Table:
    """A matrix of distances with its column sums, followed by more columns."""
    rows = []
    for c, gaps, total in zip(candidates, matrix, sums, strict=True):
        more = (Cell(text(c)) for _, text in extra)
        total_cell = Cell(number(total, 3), best=total == min(sums))
        rows.append((head(c.name), *(Cell(number(v, 3)) for v in gaps), total_cell, *more))
    names = [c.name for c in candidates]
    columns = ("candidate", *names, "Σ", *(name for name, _ in extra))
    return Table(title, columns, tuple(rows), frozenset(k for k, n in enumerate(names) if n == nominal))


def _gap_extras(candidates: Sequence[CandidateScore]) -> list[_Extra]:
    """The columns for which at least one candidate has a value."""
    known: list[_Extra] = [
        ("90 % interval of Σ", lambda c: _span(c.nu_gap_sum_low, c.nu_gap_sum_high)),
        ("P(nominal)", lambda c: number(c.nominal_probability, 2)),
        ("to the current plant", lambda c: number(c.nu_gap_to_plant, 3)),
        ("margin b(P, C)", lambda c: number(c.margin, 3)),
        ("to the nominal, scaled like the margin", lambda c: number(c.plant_gap_to_nominal, 3)),
    ]
    return [(name, text) for name, text in known if any(text(c) != number(None) for c in candidates)]


def _span(low: float, high: float) -> str:
    return number(None) if math.isnan(low) else f"{number(low, 3)} to {number(high, 3)}"


def coefficient_table(member: Member) -> Table:
    """B, C, D and F of every order as in the paper's table: set-point to output and input, or, where the
    loop is not known, input to output."""
    models = member.models
    rows = []
    for output, title in outputs_of(member.score.orders)[:2]:
        for k, polynomial in enumerate(("B", "C", "D", "F")):
            first = (head(title, 4),) if k == 0 else ()
            held = (_model(m, output) for m in models)
            cells = (words(coefficients(getattr(m, polynomial)), mark="poly") for m in held if m is not None)
            rows.append((*first, head(polynomial), *cells))
    columns = ("output", "", *(f"order {m.order}" for m in models))
    mark = ", nominal" if member.nominal else ""
    return Table(f"Box–Jenkins models of candidate {member.score.name}{mark}", columns, tuple(rows))


def coefficients(values: FloatArray) -> str:
    """A polynomial in q⁻¹, constant term first, to six significant digits."""
    return "  ".join(f"{v:.6g}".replace("-", "−") for v in values.tolist())


def _model(model: SimoModel, output: str) -> BoxJenkins | None:
    return model.y if output == "y" else model.u
