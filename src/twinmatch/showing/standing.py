"""The last verdict, its nominal candidate, and the twin to show."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from twinmatch.comparing import CandidateScore, Verdict
from twinmatch.dynamics import Parameters

__all__ = ["Shown", "last_verdict", "nominal_score", "shown_twin"]


class Shown(NamedTuple):
    """The twin that displays show."""

    name: str
    parameters: Parameters

    @property
    def is_structure(self) -> bool:
        """Whether it is a structure under its own name, and not a match named after an operating point."""
        return self.name == self.parameters.model.structure_name


def last_verdict(verdicts: Sequence[Verdict]) -> Verdict | None:
    """The last verdict; None without one, or if it has no candidate."""
    return verdicts[-1] if verdicts and verdicts[-1].candidates else None


def nominal_score(verdict: Verdict | None) -> CandidateScore | None:
    """The nominal candidate of a verdict; None without one."""
    if verdict is None:
        return None
    return next((c for c in verdict.candidates if c.name == verdict.nominal), None)


def shown_twin(verdict: Verdict | None) -> Shown | None:
    """The leader, or the nominal candidate in old recordings without leaders; None without both."""
    if verdict is None:
        return None
    known = {c.name: c.parameters for c in verdict.candidates}
    known |= {s.name: s.parameters for s in verdict.forecasts}
    name = verdict.leader or verdict.nominal
    return Shown(name, known[name]) if name in known else None
