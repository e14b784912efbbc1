"""The table of candidates over many sessions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table

    from twinmatch.offline.archive.archive import Archive
    from twinmatch.showing.quantities import ParameterFormat

__all__ = ["cells", "columns", "table"]

BEFORE = ("session", "at", "candidate")
BEHIND = ("order", "gain", "Σ ν-gap", "ν-gap now", "fit y", "fit u")


def table(archive: Archive) -> Table:
    """All candidates, session by session; the nominal ones are bold."""
    from rich.table import Table  # noqa: PLC0415 — needed only to print

    shown = Table(title="Candidates over all sessions (* nominal)", box=None, pad_edge=False)
    matched = _matched(archive)
    for number, column in enumerate(columns(archive)):
        text = column in ("session", "candidate")
        shown.add_column(column, justify="left" if text else "right", no_wrap=number > 0, overflow="fold")
    before = ""
    for row in archive.candidates:
        first, *others = cells(row, matched)
        shown.add_row("" if first == before else first, *others, style="bold" if row["nominal"] else "")
        before = first
    return shown


def columns(archive: Archive) -> tuple[str, ...]:
    """Names of the columns, with the free parameters of the first candidate's structure."""
    return (*BEFORE, *(q.label for q in _matched(archive)), *BEHIND)


def cells(row: dict[str, Any], matched: Sequence[ParameterFormat]) -> tuple[str, ...]:
    """One row as text, a cell per column."""
    fit = row["fit"]
    return (
        row["session"],
        f"{row['operating_point']:g}",
        f"{row['name']}{' *' if row['nominal'] else ''}",
        *(q.text(row["parameters"].get(q.name, math.nan)) for q in matched),
        row["chosen_order"],
        _number(row["criteria"]["gain"], ".0f"),
        _number(row["nu_gap_sum"], ".3f"),
        _number(row["nu_gap_to_plant"], ".3f"),
        _number(fit["y"], ".1%"),
        _number(fit["u"], ".1%"),
    )


def _matched(archive: Archive) -> list[ParameterFormat]:
    if not archive.candidates:
        return []
    from twinmatch.plants import plant_named  # noqa: PLC0415 — as `rich`
    from twinmatch.showing.quantities import parameter_format  # noqa: PLC0415

    first = archive.candidates[0]
    plant = plant_named(first["plant"])
    return [parameter_format(plant, name) for name in plant.structures[first["structure"]].free]


def _number(value: float | None, form: str) -> str:
    return "–" if value is None or not math.isfinite(value) else format(value, form)
