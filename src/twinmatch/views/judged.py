"""What a view needs of a judged session."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from twinmatch.discrimination import CandidateScore, Verdict
from twinmatch.signals import Sample
from twinmatch.twin import MatchReport, TwinSettings
from twinmatch.views.summary import Summary

__all__ = ["Judged", "last_verdict", "nominal_score"]


class Judged(Protocol):
    """A session and everything that came out of it."""

    @property
    def name(self) -> str:
        """Of the session."""

    @property
    def samples(self) -> Sequence[Sample]:
        """All of them, in order."""

    @property
    def settings(self) -> TwinSettings:
        """With which it was judged."""

    @property
    def matches(self) -> Sequence[MatchReport]:
        """Accepted and refused, in order."""

    @property
    def verdicts(self) -> Sequence[Verdict]:
        """In order."""

    @property
    def summary(self) -> Summary:
        """What it comes down to."""


def last_verdict(verdicts: Sequence[Verdict]) -> Verdict | None:
    """The verdict that stands at the end; None if there is none or it names no candidate."""
    return verdicts[-1] if verdicts and verdicts[-1].candidates else None


def nominal_score(verdict: Verdict | None) -> CandidateScore | None:
    """The nominal candidate of a verdict, if it has one."""
    if verdict is None:
        return None
    return next((c for c in verdict.candidates if c.name == verdict.nominal), None)
