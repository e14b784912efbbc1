"""The table of candidates over many sessions."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table

    from twinmatch.archive.archive import Archive

__all__ = ["COLUMNS", "cells", "table"]

COLUMNS = (
    "session",
    "at / °C",
    "candidate",
    "α / mV/K",
    "R / Ω",
    "K / W/K",
    "C / J/K",
    "order",
    "gain",
    "Σ ν-gap",
    "ν-gap now",
    "fit y",
    "fit u",
)


def table(archive: Archive) -> Table:
    """All candidates, session by session; the nominal ones stand out."""
    from rich.table import Table  # noqa: PLC0415 — only who prints needs it

    shown = Table(title="Candidates over all sessions (* nominal)", box=None, pad_edge=False)
    for number, column in enumerate(COLUMNS):
        text = column in ("session", "candidate")
        shown.add_column(column, justify="left" if text else "right", no_wrap=number > 0, overflow="fold")
    before = ""
    for row in archive.candidates:
        first, *others = cells(row)
        shown.add_row("" if first == before else first, *others, style="bold" if row["nominal"] else "")
        before = first
    return shown


def cells(row: dict[str, Any]) -> tuple[str, ...]:
    """One row as text, a cell per column."""
    p, fit = row["parameters"], row["fit"]
    return (
        row["session"],
        f"{row['operating_point']:g}",
        f"{row['name']}{' *' if row['nominal'] else ''}",
        f"{1000 * p['seebeck']:.1f}",
        f"{p['resistance']:.2f}",
        f"{p['conductance']:.3f}",
        f"{p['heat_capacity']:.1f}",
        row["chosen_order"],
        _number(row["criteria"]["gain"], ".0f"),
        _number(row["nu_gap_sum"], ".3f"),
        _number(row["nu_gap_to_plant"], ".3f"),
        _number(fit["y"], ".1%"),
        _number(fit["u"], ".1%"),
    )


def _number(value: float | None, form: str) -> str:
    return "–" if value is None or not math.isfinite(value) else format(value, form)
