"""The family as a table for a terminal of any width."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import nan
from typing import NamedTuple

from rich.cells import cell_len
from rich.table import Table

from twinmatch.comparing import CandidateScore, Verdict
from twinmatch.fitting import Match
from twinmatch.showing.criteria import CRITERIA
from twinmatch.showing.quantities import Quantity, number, quantity
from twinmatch.twin import MatchReport

__all__ = ["LEGEND", "believed_of", "family_table"]

LEGEND = "▶ leader; ○ nominal; * known within a factor of two from its window"
"""Meaning of the marks in the table."""

Believed = Mapping[tuple[int, int], Sequence[str]]
"""Names of well determined parameters, by first and last sample of the window they were matched on."""

_GAP = 2
"""Spaces between two columns."""
_CRITERIA = {c.attribute: c for c in CRITERIA}


class Column(NamedTuple):
    """One column, and its priority where there is no room for all."""

    header: str
    """Name, and on the next line its unit."""
    priority: float
    """Columns with the largest value are left out first."""
    cell: Callable[[CandidateScore, Sequence[str]], str]
    """Its text, from a candidate and the names of its well determined parameters."""


def family_table(verdict: Verdict, believed: Believed, width: int) -> Table:
    """The candidates with the columns that fit into `width` characters, chosen by priority."""
    rows = [(c, believed.get((c.first, c.last), ())) for c in verdict.modelled]
    columns = _columns(verdict) if verdict.modelled else (CANDIDATE,)
    cells = {column: _cells(column, rows, verdict) for column in columns}
    table = Table(box=None, padding=(0, _GAP, 0, 0), pad_edge=False, header_style="bold")
    chosen = _fitting({column: _width(column, texts) for column, texts in cells.items()}, width)
    for column in chosen:
        table.add_column(column.header, no_wrap=True, justify="left" if column is CANDIDATE else "right")
    for place, (candidate, _) in enumerate(rows):
        style = "bold" if candidate.name in {verdict.leader, verdict.nominal} else ""
        table.add_row(*(cells[column][place] for column in chosen), style=style)
    return table


def believed_of(matches: Sequence[MatchReport]) -> dict[tuple[int, int], tuple[str, ...]]:
    """The well determined parameters of every accepted match, by its window."""
    found: list[Match] = [report.match for report in matches if report.match.accepted]
    return {match.samples: match.believed for match in found if match.samples is not None}


def _cells(
    column: Column, rows: Sequence[tuple[CandidateScore, Sequence[str]]], verdict: Verdict
) -> list[str]:
    texts = [column.cell(candidate, believed) for candidate, believed in rows]
    if column is not CANDIDATE:
        return texts
    marks = [
        f"{'▶' if c.name == verdict.leader else ' '}{'○' if c.name == verdict.nominal else ' '}"
        for c, _ in rows
    ]
    return [f"{mark} {text}" for mark, text in zip(marks, texts, strict=True)]


def _width(column: Column, texts: Sequence[str]) -> int:
    return max(cell_len(text) for text in (*column.header.split("\n"), *texts))


def _fitting(widths: Mapping[Column, int], room: int) -> list[Column]:
    """As many columns as have room, chosen by priority, in the order of the table; always at least one."""
    room += _GAP  # there is none after the last column
    chosen: set[Column] = set()
    for column in sorted(widths, key=lambda c: c.priority):
        if not chosen or widths[column] + _GAP <= room:
            chosen.add(column)
            room -= widths[column] + _GAP
    return [column for column in widths if column in chosen]


def _parameter(shown: Quantity) -> Callable[[CandidateScore, Sequence[str]], str]:
    def text(candidate: CandidateScore, believed: Sequence[str]) -> str:
        value = shown.text(candidate.parameters.get(shown.name, nan))
        return f"{value}{'*' if shown.name in believed else ' '}"

    return text


def _criterion(name: str) -> Callable[[CandidateScore, Sequence[str]], str]:
    def text(candidate: CandidateScore, _: Sequence[str]) -> str:
        chosen = next((o for o in candidate.orders if o.order == candidate.chosen_order), None)
        return number(None) if chosen is None else _CRITERIA[name].text(getattr(chosen.total, name))

    return text


def _sum_interval(candidate: CandidateScore) -> str:
    low, high = (number(v, 2) for v in (candidate.nu_gap_sum_low, candidate.nu_gap_sum_high))
    return low if low == high == number(None) else f"{low}…{high}"


CANDIDATE = Column("candidate", 0, lambda c, _: c.name)


def _columns(verdict: Verdict) -> tuple[Column, ...]:
    """All columns, in the order of the table; the parameters are those that the structure leaves free."""
    model = verdict.candidates[0].parameters.model
    y, u = model.plant.output, model.plant.drive
    shown = [quantity(model.plant, name) for name in model.structure.free]
    return (
        CANDIDATE,
        Column(f"at\n{y.unit}", 8, lambda c, _: number(c.operating_point, y.decimals)),
        # The trailing space leaves room for the mark after the value.
        *(Column(f"{q.symbol} \n{q.unit} ", 4 + k / len(shown), _parameter(q)) for k, q in enumerate(shown)),
        Column("order", 1, lambda c, _: c.chosen_order),
        Column("gain\ncharacters", 7, _criterion("gain")),
        Column("nAIC", 11, _criterion("naic")),
        Column("BIC", 12, _criterion("bic")),
        Column(f"MDL\n{y.unit}²+{u.unit or u.name}²", 13, _criterion("mdl")),
        Column("ν-gap\nsum", 2, lambda c, _: number(c.nu_gap_sum, 3)),
        Column("90 %\ninterval", 10, lambda c, _: _sum_interval(c)),
        Column("P\nnominal", 3, lambda c, _: number(c.nominal_probability, 2)),
        Column("margin\nb(P, C)", 9, lambda c, _: number(c.margin, 3)),
    )
