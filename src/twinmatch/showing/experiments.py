"""Experiments on the running plant in words."""

from __future__ import annotations

from collections.abc import Sequence

from twinmatch.description import UNDESCRIBED, Description
from twinmatch.twin.experiment import ExperimentPhase, ExperimentReport


def course_words(
    levels: Sequence[float], holds: Sequence[float], described: Description = UNDESCRIBED
) -> str:
    """Set-points and how long each is held, without the last, at which the plant rests afterwards."""
    of = described.references
    rows = list(zip(*[iter(levels)] * len(of), strict=True))
    return ", then ".join(
        f"{' and '.join(f'{v:.4g} {q.unit}'.rstrip() for v, q in zip(row, of, strict=True))} for {hold:.4g} s"
        for row, hold in zip(rows[:-1], holds, strict=False)
    )


def report_words(report: ExperimentReport, described: Description = UNDESCRIBED) -> str:
    """What an experiment has come to, in a sentence."""
    if not report.levels:
        return f"{report.phase.value}: {report.reason}"
    plan = course_words(report.levels, report.holds, described)
    so_far = f"{report.brought:.3g} of {report.expected:.3g} characters"
    brought = so_far if report.phase is ExperimentPhase.RUNNING else f"{report.expected:.3g} characters"
    return f"{report.phase.value}, for {report.goal}: {brought}; hold {plan} ({report.reason})"
