"""What a judged session comes down to, in figures and in plain words."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from twinmatch.discrimination import TrustLevel, Verdict
from twinmatch.plant import PidGains, RigParameters
from twinmatch.signals import Sample, Window, unbroken
from twinmatch.twin import MatchReport, closed_loop_fit

__all__ = ["Summary", "sentence", "summarise"]


@dataclass(frozen=True)
class Summary:
    """The end of a session: who is nominal and how well its twin follows the whole of it."""

    nominal: str | None
    level: TrustLevel
    """Of the last verdict."""
    parameters: RigParameters | None
    fit_y: float
    """NRMSE fit of the closed-loop twin's temperature over the whole session; NaN without a nominal."""
    fit_u: float
    verdicts: int
    identified: int
    """Verdicts whose window excited the loop."""
    matches: dict[str, int]
    """How many matches ended in each status."""
    notes: tuple[str, ...] = ()


def summarise(
    samples: Sequence[Sample],
    matches: Sequence[MatchReport],
    verdicts: Sequence[Verdict],
    gains: PidGains,
    notes: Sequence[str] = (),
) -> Summary:
    """Sum up a session from what came out of it."""
    last = verdicts[-1] if verdicts else None
    chosen = next((c for c in last.candidates if c.name == last.nominal), None) if last else None
    fit = (math.nan, math.nan)
    remarks = list(notes)
    if chosen is not None:
        stretches = unbroken(samples)
        longest = max(stretches, key=len)
        if len(stretches) > 1:
            remarks.append(
                f"the fit is that of samples {longest[0].index} to {longest[-1].index}, "
                f"the longest of {len(stretches)} unbroken stretches"
            )
        fit = closed_loop_fit(chosen.parameters, Window.from_samples(longest, gains.period), gains)
    return Summary(
        nominal=last.nominal if last else None,
        level=last.level if last else TrustLevel.UNKNOWN,
        parameters=chosen.parameters if chosen else None,
        fit_y=fit[0],
        fit_u=fit[1],
        verdicts=len(verdicts),
        identified=sum(not v.stands for v in verdicts),
        matches=dict(Counter(m.match.status.value for m in matches)),
        notes=tuple(remarks),
    )


def sentence(summary: Summary) -> str:
    """The summary as a person would say it."""
    if summary.nominal is None or summary.parameters is None:
        return (
            f"No nominal twin: {summary.verdicts} verdicts, but no match was accepted. "
            "The loop needs set-point steps of a few degrees, some minutes apart."
        )
    p = summary.parameters
    return (
        f"Nominal: the twin matched at {summary.nominal} "
        f"(α {1000 * p.seebeck:.1f} mV/K, R {p.resistance:.2f} Ω, K {p.conductance:.3f} W/K, "
        f"C {p.heat_capacity:.1f} J/K). Over the whole session it follows the temperature to "
        f"{100 * summary.fit_y:.1f} % and the control to {100 * summary.fit_u:.1f} %. "
        f"{_TRUST[summary.level]}"
    )


_TRUST = {
    TrustLevel.UNKNOWN: "How far to trust it is not known yet.",
    TrustLevel.TRUSTED: "At the end it can be trusted.",
    TrustLevel.DOUBTFUL: "At the end it is doubtful: plant and twin differ more than they should.",
    TrustLevel.FAULT: "It cannot be trusted now: the plant does what no twin explains. Look at the plant.",
}
