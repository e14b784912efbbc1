"""Verdicts as lines of a table, for terminals and pipes."""

from __future__ import annotations

from twinmatch.comparing import TrustLevel, Verdict
from twinmatch.showing.quantities import number
from twinmatch.showing.standing import nominal_score

__all__ = ["COLUMNS", "STYLES", "row"]

COLUMNS = (
    "t / s",
    "level",
    "leader",
    "nominal",
    "order",
    "gain",
    "ν-gap sum",
    "ν-gap now",
    "miss y",
    "miss u",
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
    """The cells of one verdict, in the order of `COLUMNS`.

    The misses are those of the leader, in half widths of its bands; order, gain and ν-gaps those of the
    nominal candidate.
    """
    nominal = nominal_score(verdict)
    order = gain = total = now = "–"
    if nominal is not None:
        score = next((o for o in nominal.orders if o.order == nominal.chosen_order), None)
        if score is not None:  # a structure has no Box–Jenkins models
            order, gain = score.order, number(score.total.gain, 0)
        total = number(nominal.nu_gap_sum, 3)
        now = number(nominal.nu_gap_to_plant, 3)
    return (
        number(verdict.sample * period, 0),
        verdict.level.value,
        verdict.leader or "–",
        verdict.nominal or "–",
        order,
        gain,
        total,
        now,
        number(verdict.miss_y, 2),
        number(verdict.miss_u, 2),
        verdict.reason,
    )
