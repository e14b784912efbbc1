"""Samples in, matches and verdicts out: one object for the live nodes and for replay.

`Discriminator` keeps schedule and family: it says when parameters are to be matched and judges the
candidates. `answer` makes a match of such a `MatchRequest`. `Mirror` runs the nominal twin beside the
plant. `Twin` is the first two on one stream. `choose_structure` says what the plant is made of as far as
its samples pay for it, and `StructureWatch` asks that again and again. All of them are synchronous and
depend on nothing but the samples they are given: no clock, no thread, no random state, so a recorded
session judges itself again exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from twinmatch.discrimination import Candidate, Verdict
from twinmatch.signals import Sample
from twinmatch.twin.discriminator import Discriminator, Step
from twinmatch.twin.entrant import ForecastSettings
from twinmatch.twin.forecaster import Forecaster
from twinmatch.twin.matcher import MatchReport, MatchRequest, answer
from twinmatch.twin.mirror import Mirror, MirrorState
from twinmatch.twin.residuals import Residuals, nrmse, residuals, window_fit
from twinmatch.twin.schedule import Schedule, ScheduleError, ScheduleSettings, Trigger
from twinmatch.twin.settings import TrustLimits, TwinError, TwinSettings
from twinmatch.twin.snapshot import Snapshot
from twinmatch.twin.structure_watch import StructureSettings, StructureWatch, watched
from twinmatch.twin.structures import StructureChoice, StructureScore, choose_structure

__all__ = [
    "Discriminator",
    "ForecastSettings",
    "Forecaster",
    "MatchReport",
    "MatchRequest",
    "Mirror",
    "MirrorState",
    "Outcome",
    "Residuals",
    "Schedule",
    "ScheduleError",
    "ScheduleSettings",
    "Snapshot",
    "Step",
    "StructureChoice",
    "StructureScore",
    "StructureSettings",
    "StructureWatch",
    "Trigger",
    "TrustLimits",
    "Twin",
    "TwinError",
    "TwinSettings",
    "answer",
    "choose_structure",
    "nrmse",
    "residuals",
    "watched",
    "window_fit",
]


class Outcome(NamedTuple):
    """What one sample brought about."""

    match: MatchReport | None
    verdicts: tuple[Verdict, ...]


class Twin:
    """A discriminator whose requests are answered at once, on one stream of samples."""

    def __init__(
        self,
        settings: TwinSettings | None = None,
        given: Sequence[Candidate] = (),
        *,
        matching: TwinSettings | None = None,
    ) -> None:
        """Begin with no samples and with the candidates given, if any.

        `matching` are the settings of matches, if they have their own.
        """
        self.settings = settings or TwinSettings()
        self.discriminator = Discriminator(self.settings, given)
        self._matching = matching or self.settings

    def push(self, sample: Sample) -> Outcome:
        """Take one sample; return the match and the verdicts it sets off."""
        step = self.discriminator.push_sample(sample)
        if step.request is None:
            return Outcome(None, step.verdicts)
        report = answer(step.request, self._matching)
        return Outcome(report, step.verdicts + self.discriminator.push_match(report).verdicts)
