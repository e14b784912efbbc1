"""Samples in, matches and verdicts out: one object for the live nodes and for replay.

`Matcher` fits rig parameters when the schedule says that a window excited the loop, `Discriminator`
judges the family of accepted matches, `Mirror` runs the nominal twin beside the plant. `Twin` is the
first two, fed from one stream. `choose_structure` says what the plant is made of as far as its samples pay
for it, and `StructureWatch` asks that again and again. All of them are synchronous and depend on nothing
but the samples they are given: no clock, no thread, no random state, so a recorded session judges itself
again exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from twinmatch.discrimination import Candidate, Verdict
from twinmatch.signals import Sample
from twinmatch.twin.discriminator import Discriminator
from twinmatch.twin.matcher import Matcher, MatchReport
from twinmatch.twin.mirror import Mirror, MirrorState
from twinmatch.twin.residuals import Residuals, closed_loop_fit, nrmse, residuals
from twinmatch.twin.schedule import Schedule, ScheduleError, ScheduleSettings, Trigger
from twinmatch.twin.settings import TrustLimits, TwinError, TwinSettings
from twinmatch.twin.structure_watch import StructureSettings, StructureWatch, watched
from twinmatch.twin.structures import StructureChoice, StructureScore, choose_structure

__all__ = [
    "Discriminator",
    "MatchReport",
    "Matcher",
    "Mirror",
    "MirrorState",
    "Outcome",
    "Residuals",
    "Schedule",
    "ScheduleError",
    "ScheduleSettings",
    "StructureChoice",
    "StructureScore",
    "StructureSettings",
    "StructureWatch",
    "Trigger",
    "TrustLimits",
    "Twin",
    "TwinError",
    "TwinSettings",
    "choose_structure",
    "closed_loop_fit",
    "nrmse",
    "residuals",
    "watched",
]


class Outcome(NamedTuple):
    """What one sample brought about."""

    match: MatchReport | None
    verdicts: tuple[Verdict, ...]


class Twin:
    """Matcher and discriminator on one stream of samples."""

    def __init__(self, settings: TwinSettings | None = None, given: Sequence[Candidate] = ()) -> None:
        """Begin with no samples and with the candidates given, if any."""
        self.settings = settings or TwinSettings()
        self.matcher = Matcher(self.settings)
        self.discriminator = Discriminator(self.settings, given)

    def push(self, sample: Sample) -> Outcome:
        """Take one sample; return the match and the verdicts it sets off."""
        verdicts = self.discriminator.push_sample(sample)
        report = self.matcher.push(sample)
        if report is not None:
            verdicts += self.discriminator.push_match(report)
        return Outcome(report, tuple(verdicts))
