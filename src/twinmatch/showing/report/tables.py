"""The tables of a report, as cells of text ready for layout."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, NamedTuple, TypeVar

from twinmatch.comparing import REFUSED, CandidateScore, Verdict
from twinmatch.dynamics import Plant
from twinmatch.fitting import Match
from twinmatch.offline.backtest import Backtest
from twinmatch.offline.backtest.scoring import LEADER, TWINS
from twinmatch.showing.family import (
    FIGURES,
    FigureColumn,
    Member,
    computed,
    criterion_rows,
    interval,
    outputs_of,
    value_of,
)
from twinmatch.showing.forecasts import card_columns, levels_words
from twinmatch.showing.quantities import (
    ParameterFormat,
    in_order,
    number,
    parameter_format,
    percent,
    signal_names,
    span_text,
    with_unit,
)
from twinmatch.showing.series import Fan, root_mean_square
from twinmatch.showing.verdicts import events, match_word, refusal, trust_by_signal
from twinmatch.signals import FloatArray, point_text, time_text
from twinmatch.twin import MatchReport

Subject = TypeVar("Subject")


class Cell(NamedTuple):
    """One cell of a table."""

    text: str
    best: bool = False
    """Whether it is in bold."""
    head: bool = False
    """Whether it heads its row."""
    number: bool = True
    """Whether it is aligned right."""
    rows: int = 1
    """Number of rows that it spans."""
    css_class: str = ""


@dataclass(frozen=True)
class ReportTable:
    """One table; the template explains it."""

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    highlighted: frozenset[int] = frozenset()
    """Numbers of the rows that stand out."""

    @property
    def right(self) -> tuple[bool, ...]:
        """Whether each column name is aligned right, like the numbers below it."""
        first = self.rows[0] if self.rows else ()
        return tuple(cell.number for cell in first) or (False,) * len(self.columns)


def _words(text: str, *, css_class: str = "") -> Cell:
    return Cell(text, number=False, css_class=css_class)


def _head(text: str, rows: int = 1) -> Cell:
    """A cell that heads its row, or several rows."""
    return Cell(text, head=True, number=False, rows=rows)


def _table(
    caption: str,
    subjects: Iterable[Subject],
    shown: Sequence[tuple[str, Callable[[Subject], Cell]]],
    highlighted: Collection[int] = (),
) -> ReportTable:
    """A table with a row for each subject; `shown` has the name of each column, and its cell for a subject.

    `highlighted` are the numbers of the rows that stand out.
    """
    rows = tuple(tuple(cell(subject) for _, cell in shown) for subject in subjects)
    return ReportTable(
        caption, tuple(name for name, _ in shown), rows, frozenset(highlighted)
    )


def event_table(verdicts: Sequence[Verdict], period: float) -> ReportTable:
    """The events of the session, in order of time."""
    return _table(
        "What happened",
        events(verdicts),
        (
            ("t / s", lambda event: Cell(time_text(event.sample or 0, period))),
            (
                "kind",
                lambda event: _words(
                    event.kind.value, css_class=event.kind.name.lower()
                ),
            ),
            ("what", lambda event: _words(event.title)),
            ("why", lambda event: _words(event.why)),
        ),
    )


def nominal_table(score: CandidateScore, match: Match | None) -> ReportTable:
    """The nominal twin's parameters with their intervals."""
    plant = score.parameters.model.plant
    free = match.free if match is not None else ()
    rows = []
    for name in in_order(plant, (*score.parameters, *free)):
        q = parameter_format(plant, name)
        if match is not None and name in free:
            value = Cell(q.text(value_of(match, name)), best=True)
            error = q.error_text(interval(match, name).error)
            ends = _ends(match, q) or "–"
            well = "well" if name in match.believed else "poorly"
            origin = f"fitted, {well} determined" if match.believed else "fitted"
        else:
            value = Cell(q.text(score.parameters[name]))
            error = "–"
            ends = "–"
            origin = "candidate file" if match is None else "not fitted"
        named = (_head(q.symbol), _words(q.words), value, _words(q.unit))
        rows.append((*named, Cell(error), Cell(ends), _words(origin)))
    names = (
        "symbol",
        "meaning",
        "value",
        "unit",
        "standard error",
        "95 % interval",
        "from",
    )
    return ReportTable(
        f"Parameters of the nominal twin, {score.name}", names, tuple(rows)
    )


def _ends(match: Match, q: ParameterFormat) -> str:
    """The ends of a free parameter's interval; empty where they are not known."""
    ends = interval(match, q.name)
    return f"{q.text(ends.low)} to {q.text(ends.high)}" if ends.known else ""


def structure_table(verdict: Verdict) -> ReportTable | None:
    """Parameters of the structure that the data support; None before structures were compared."""
    parameters = verdict.structure_parameters
    if parameters is None:
        return None
    plant = parameters.model.plant
    return _table(
        f"{plant.title} with the structure “{verdict.structure}”",
        [(parameter_format(plant, name), value) for name, value in parameters.items()],
        (
            ("symbol", lambda shown: _head(shown[0].symbol)),
            ("meaning", lambda shown: _words(shown[0].words)),
            ("value", lambda shown: Cell(shown[0].text(shown[1]))),
            ("unit", lambda shown: _words(shown[0].unit)),
        ),
    )


def family_table(members: Sequence[Member]) -> ReportTable | None:
    """Parameters of every candidate with their 95 % intervals; None without one."""
    if not members:
        return None
    closed = any(m.settings.law is not None for m in members)
    shown: list[tuple[str, Callable[[Member], Cell]]] = [
        ("candidate", lambda m: _head(m.score.name)),
        (
            "samples",
            lambda m: Cell(_samples(m.score) if m.fitted else "candidate file"),
        ),
    ]
    for q in _formats(members):
        shown.append((q.label, partial(_parameter_cell, q)))
    shown.append(
        ("fit of y / %", lambda m: Cell(percent(m.match.fit.y) if m.match else "–"))
    )
    if closed:
        shown.append(
            ("fit of u / %", lambda m: Cell(percent(m.match.fit.u) if m.match else "–"))
        )
    highlighted = {k for k, m in enumerate(members) if m.nominal}
    return _table(
        "Parameters of the family, with 95 % intervals", members, shown, highlighted
    )


def _parameter_cell(q: ParameterFormat, member: Member) -> Cell:
    """A parameter of a candidate, with its interval if it is free."""
    if member.match is None or q.name not in member.match.free:
        return Cell(q.text(member.score.parameters.get(q.name, math.nan)))
    ends = _ends(member.match, q)
    value = q.text(value_of(member.match, q.name))
    return Cell(f"{value} ({ends})" if ends else value)


def _samples(score: CandidateScore) -> str:
    return f"{score.first} to {score.last}"


def _formats(members: Sequence[Member]) -> list[ParameterFormat]:
    """The free parameters of all matches; without matches those of the structures."""
    free = [m.match.free for m in members if m.match is not None]
    free = free or [m.score.parameters.model.structure.free for m in members]
    plant = members[0].score.parameters.model.plant
    return [
        parameter_format(plant, name)
        for name in in_order(plant, {n for names in free for n in names})
    ]


def match_table(
    matches: Sequence[MatchReport],
    verdicts: Sequence[Verdict],
    period: float,
    *,
    closed: bool = True,
) -> ReportTable | None:
    """Every match, admitted or refused, and why, None without one; `closed`: whether the loop is known.

    A window that was refused before anything was fitted to it has a row without values.
    """
    reasons = {v.sample: refusal(v) for v in verdicts if v.match == REFUSED}
    fitted = {m.sample for m in matches}
    rows = [_MatchRow(m.sample, m) for m in matches]
    rows += [_MatchRow(sample, None) for sample in reasons if sample not in fitted]
    if not rows:
        return None

    def result(row: _MatchRow) -> Cell:
        word = REFUSED if row.report is None else match_word(row.report, verdicts)
        return _words(word, css_class=word.partition(":")[0])

    def why(row: _MatchRow) -> Cell:
        return _words(
            reasons.get(row.sample, row.report.match.reason if row.report else "")
        )

    shown: list[tuple[str, Callable[[_MatchRow], Cell]]] = [
        ("t / s", lambda row: Cell(time_text(row.sample, period))),
        (
            "set-point" if closed else "operating point",
            _of_report(lambda report: Cell(point_text(report.operating_point))),
        ),
        ("match", result),
    ]
    if matches:
        plant = matches[0].match.parameters.model.plant
        for name in in_order(plant, {name for m in matches for name in m.match.free}):
            q = parameter_format(plant, name)
            shown.append((q.label, _of_report(partial(_matched_cell, q))))
    shown.append(
        ("fit y / %", _of_report(lambda report: Cell(percent(report.match.fit.y))))
    )
    if closed:
        shown.append(
            ("fit u / %", _of_report(lambda report: Cell(percent(report.match.fit.u))))
        )
    shown.append(("why", why))
    return _table(
        "Every match of the session", sorted(rows, key=lambda row: row.sample), shown
    )


class _MatchRow(NamedTuple):
    """A window that was to be matched."""

    sample: int
    report: MatchReport | None
    """What was fitted to it; None: it was refused before."""


def _of_report(cell: Callable[[MatchReport], Cell]) -> Callable[[_MatchRow], Cell]:
    """A cell of what was fitted; a dash where nothing was."""
    return lambda row: Cell("–") if row.report is None else cell(row.report)


def _matched_cell(q: ParameterFormat, report: MatchReport) -> Cell:
    """A parameter as it was matched; a dash where it was not fitted."""
    is_fitted = math.isfinite(report.match.chi2) and q.name in report.match.free
    return Cell(q.text(value_of(report.match, q.name)) if is_fitted else "–")


def signal_table(verdict: Verdict | None) -> ReportTable | None:
    """How far to trust the forecasts of each of several signals; None for a single loop."""
    rows = trust_by_signal(verdict)
    if not rows:
        return None
    cells = (
        tuple(map(_head, row.values()))[:1] + tuple(map(Cell, row.values()))[1:]
        for row in rows
    )
    return ReportTable(
        "How far to trust the leader's forecasts of each signal",
        tuple(rows[0]),
        tuple(cells),
    )


def criterion_tables(verdict: Verdict) -> list[ReportTable]:
    """One table per candidate; the best order by each criterion and output is bold."""
    shown = computed(verdict.candidates)
    names = ("output", "order", *(c.label for c in shown))
    tables = []
    for candidate in verdict.modelled:
        titles = dict(outputs_of(candidate.orders))
        count = len(candidate.orders)
        criteria = criterion_rows(candidate, shown)
        rows = []
        for k, row in enumerate(criteria):
            first = () if k % count else (_head(titles[row.output], count),)
            order = Cell(row.order, best=row.chosen, number=False)
            rows.append(
                (*first, order, *(Cell(c.text, best=c.best) for c in row.cells))
            )
        mark = ", nominal" if candidate.name == verdict.nominal else ""
        caption = (
            f"Candidate {candidate.name}{mark}: order {candidate.chosen_order} chosen"
        )
        chosen = frozenset(k for k, row in enumerate(criteria) if row.chosen)
        tables.append(ReportTable(caption, names, tuple(rows), chosen))
    return tables


def order_table(verdict: Verdict) -> ReportTable | None:
    """Akaike weights of the orders, for both outputs together; None where they were not computed."""
    if not any(math.isfinite(o.weight) for c in verdict.candidates for o in c.orders):
        return None
    names = [o.order for o in verdict.modelled[0].orders]
    rows = []
    for c in verdict.modelled:
        largest = max(o.weight for o in c.orders)
        best = [o.weight == largest for o in c.orders]
        texts = [number(o.weight, 3) for o in c.orders] + [
            number(o.aic_difference, 1) for o in c.orders
        ]
        rows.append((_head(c.name), *map(Cell, texts, best + best)))
    called = (
        "candidate",
        *(f"weight {n}" for n in names),
        *(f"ΔAIC {n}" for n in names),
    )
    return ReportTable("Akaike weights of the orders", called, tuple(rows))


_TO_NOMINAL: Final = FigureColumn(
    "plant_gap_to_nominal",
    "to the nominal, scaled like the margin",
    "",
    3,
    "from input to output alone",
)
_IDENTIFIED: Final = FigureColumn(
    "identified_gap_to_plant", "to the newest window's model", "", 3, "as in the paper"
)


def gap_table(verdict: Verdict) -> ReportTable:
    """The ν-gaps, their sums, and the further distances and probabilities that a candidate has."""
    columns = (*FIGURES[1:], _TO_NOMINAL)
    extra = [column for column in columns if _has_figures(column, verdict.candidates)]
    sums = [c.nu_gap_sum for c in verdict.candidates]
    title = "ν-gap between the plants"
    return _distances(
        title, verdict, verdict.candidates, verdict.nu_gap, sums=sums, extra=extra
    )


def identified_table(verdict: Verdict) -> ReportTable:
    """The ν-gaps between the models identified on the twins, as in the paper."""
    sums = [c.identified_gap_sum for c in verdict.modelled]
    title = f"ν-gap between the models of order {verdict.order}"
    gaps = verdict.identified_gap
    return _distances(
        title, verdict, verdict.modelled, gaps, sums=sums, extra=[_IDENTIFIED]
    )


def _has_figures(column: FigureColumn, candidates: Sequence[CandidateScore]) -> bool:
    return any(column.text(candidate) != number(None) for candidate in candidates)


def _distances(
    title: str,
    verdict: Verdict,
    candidates: Sequence[CandidateScore],
    matrix: Sequence[Sequence[float]],
    *,
    sums: Sequence[float],
    extra: Sequence[FigureColumn],
) -> ReportTable:
    """A matrix of distances with its column sums, followed by more columns."""
    rows = []
    for c, gaps, total in zip(candidates, matrix, sums, strict=True):
        further_cells = (Cell(column.text(c)) for column in extra)
        total_cell = Cell(number(total, 3), best=total == min(sums))
        rows.append(
            (
                _head(c.name),
                *(Cell(number(v, 3)) for v in gaps),
                total_cell,
                *further_cells,
            )
        )
    names = [c.name for c in candidates]
    highlighted = frozenset(
        k for k, name in enumerate(names) if name == verdict.nominal
    )
    return ReportTable(
        title,
        ("candidate", *names, "Σ", *(c.label for c in extra)),
        tuple(rows),
        highlighted,
    )


def coefficient_table(member: Member) -> ReportTable:
    """B, C, D and F of every order as in the paper's table: set-point to output and input, or, where the
    loop is not known, input to output."""
    models = member.models
    rows = []
    for output, title in outputs_of(member.score.orders)[:2]:
        for k, polynomial in enumerate("BCDF"):
            first = (_head(title, 4),) if k == 0 else ()
            of_orders = [m.y if output == "y" else m.u for m in models]
            cells = [
                _polynomial_cell(getattr(model, polynomial))
                for model in of_orders
                if model is not None
            ]
            rows.append((*first, _head(polynomial), *cells))
    names = ("output", "", *(f"order {m.order}" for m in models))
    mark = ", nominal" if member.nominal else ""
    return ReportTable(
        f"Box–Jenkins models of candidate {member.score.name}{mark}", names, tuple(rows)
    )


def _polynomial_cell(coefficients: FloatArray) -> Cell:
    """The coefficients of a polynomial in q⁻¹, constant term first, to six significant digits."""
    text = "  ".join(
        f"{value:.6g}".replace("-", "−") for value in coefficients.tolist()
    )
    return _words(text, css_class="poly")


def forecast_tables(tested: Backtest) -> list[ReportTable]:
    """One table per horizon: errors and bands of every forecaster; the smallest error of those that can be
    used live is bold."""
    columns = card_columns(tested.plant, driven=tested.driven)
    tables = []
    for horizon, cards in tested.at_horizons.items():
        live = [card for card in cards if card.who not in TWINS[1:]]
        least = min((card.median for card in live), default=math.nan)
        best = {card.who for card in live if card.median == least}
        rows = []
        for card in cards:
            forecaster, *figures = (text(card) for _, text in columns)
            error = Cell(figures[0], best=card.who in best)
            rows.append((_head(forecaster), error, *map(Cell, figures[1:])))
        caption = f"{horizon:g} s ahead, {cards[0].count} forecasts"
        highlighted = frozenset(k for k, card in enumerate(cards) if card.who == LEADER)
        tables.append(
            ReportTable(
                caption, tuple(name for name, _ in columns), tuple(rows), highlighted
            )
        )
    return tables


def leader_forecast_table(
    fans: Sequence[Fan], plant: type[Plant]
) -> ReportTable | None:
    """Forecasts of the leader in numbers, beside the measurements; None without forecasts."""
    if not fans:
        return None
    signals = signal_names(plant)
    closed = fans[0].forecast.closed
    decimals = plant.output.decimals
    moves = (
        ("set-points", signals.output.unit)
        if closed
        else ("inputs", signals.input.unit)
    )

    def ends(fan: Fan) -> Cell:
        band = fan.forecast.output
        return Cell(span_text(float(band.low[-1]), float(band.high[-1]), decimals))

    def share(fan: Fan, signal: int) -> Cell:
        inside = fan.in_band[signal]
        return Cell(f"{percent(float(inside.mean()), 0)} %" if inside.size else "–")

    def last(fan: Fan) -> Cell:
        return Cell(
            number(None if fan.measured is None else fan.measured.output[-1], decimals)
        )

    def error(fan: Fan) -> Cell:
        return Cell(number(root_mean_square([fan.error]), decimals + 1))

    unit = signals.output.unit
    shown: list[tuple[str, Callable[[Fan], Cell]]] = [
        (
            "made at / s",
            lambda fan: _head(time_text(fan.forecast.sample, fan.past.period)),
        ),
        ("by", lambda fan: _words(fan.forecast.candidate)),
        (with_unit(*moves), lambda fan: _words(levels_words(fan.forecast))),
        (with_unit("forecast at its end", unit), ends),
        (with_unit("measured", unit), last),
        (with_unit("RMS error", unit), error),
        (f"{signals.output} within band", lambda fan: share(fan, 0)),
    ]
    if closed:
        shown.append((f"{signals.input} within band", lambda fan: share(fan, 1)))
    return _table("Forecasts of the leader, and the measurements", fans, shown)
