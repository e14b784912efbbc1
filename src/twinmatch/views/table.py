"""Verdicts as lines of a table, for terminals and pipes."""

from __future__ import annotations

import math

from twinmatch.discrimination import TrustLevel, Verdict

__all__ = ["COLUMNS", "STYLES", "row"]

COLUMNS = (
    "t / s",
    "level",
    "nominal",
    "order",
    "gain",
    "ν-gap sum",
    "ν-gap now",
    "rms y / °C",
    "rms u",
    "why",
)

STYLES = {
    TrustLevel.UNKNOWN: "dim",
    TrustLevel.TRUSTED: "green",
    TrustLevel.DOUBTFUL: "yellow",
    TrustLevel.FAULT: "bold red",
}
"""rich style of each level."""


def row(verdict: Verdict, period: float = 1.0) -> tuple[str, ...]:
    """The cells of one verdict, in the order of `COLUMNS`."""
    nominal = next((c for c in verdict.candidates if c.name == verdict.nominal), None)
    order = gain = total = now = "–"
    if nominal is not None:
        order = nominal.chosen_order
        score = next(o for o in nominal.orders if o.order == order)
        gain = str(score.total.gain)
        total = f"{nominal.nu_gap_sum:.3f}"
        now = "–" if nominal.nu_gap_to_plant is None else f"{nominal.nu_gap_to_plant:.3f}"
    return (
        f"{verdict.sample * period:.0f}",
        verdict.level.value,
        verdict.nominal or "–",
        order,
        gain,
        total,
        now,
        _number(verdict.residual_y, ".2f"),
        _number(verdict.residual_u, ".1f"),
        verdict.reason,
    )


def _number(value: float, form: str) -> str:
    return "–" if math.isnan(value) else format(value, form)
