"""The verdict that stands at the end, and its nominal candidate."""

from __future__ import annotations

from collections.abc import Sequence

from twinmatch.discrimination import CandidateScore, Verdict

__all__ = ["last_verdict", "nominal_score"]


def last_verdict(verdicts: Sequence[Verdict]) -> Verdict | None:
    """The verdict that stands at the end; None if there is none or it names no candidate."""
    return verdicts[-1] if verdicts and verdicts[-1].candidates else None


def nominal_score(verdict: Verdict | None) -> CandidateScore | None:
    """The nominal candidate of a verdict, if it has one."""
    if verdict is None:
        return None
    return next((c for c in verdict.candidates if c.name == verdict.nominal), None)
