"""Experiments on the running plant in words."""

from __future__ import annotations

from collections.abc import Sequence

from twinmatch.description import UNDESCRIBED, Description
from twinmatch.twin.experiment import ExperimentPhase, ExperimentReport


def course_words(
    levels: Sequence[float],
    holds: Sequence[float],
    described: Description = UNDESCRIBED,
) -> str:
    """Set-points and how long each is held, without the last, at which the plant rests afterwards."""
    quantities = described.references
    rows = list(zip(*[iter(levels)] * len(quantities), strict=True))
    steps = []
    for row, hold in zip(rows[:-1], holds, strict=False):
        values = [
            f"{level:.4g} {q.unit}".rstrip()
            for level, q in zip(row, quantities, strict=True)
        ]
        steps.append(f"{' and '.join(values)} for {hold:.4g} s")
    return ", then ".join(steps)


def report_words(report: ExperimentReport, described: Description = UNDESCRIBED) -> str:
    """What an experiment has come to, in a sentence."""
    if not report.levels:
        return f"{report.phase.value}: {report.reason}"
    plan = course_words(report.levels, report.holds, described)
    so_far = f"{report.brought:.3g} of {report.expected:.3g} bits"
    brought = (
        so_far
        if report.phase is ExperimentPhase.RUNNING
        else f"{report.expected:.3g} bits"
    )
    return f"{report.phase.value}, for {report.goal}: {brought}; hold {plan} ({report.reason})"
