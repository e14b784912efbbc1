"""The twin engine: takes samples, returns matches and verdicts; shared by the live nodes and by replay.

`Discriminator` keeps schedule and family: it requests matches and judges the candidates. `answer` carries
out such a `MatchRequest`. `Mirror` runs the nominal twin beside the plant. `Twin` combines the first two on
one stream. `choose_structure` finds the plant structure that the samples support, and `StructureWatch`
repeats that at intervals. All of them are synchronous and depend only on the samples pushed: no clock, no
thread, no random state, so a replay of a recorded session gives exactly the recorded verdicts.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from twinmatch.comparing import Candidate, Verdict
from twinmatch.signals import Sample
from twinmatch.twin.discriminator import Discriminator, Step
from twinmatch.twin.entrant import ForecastSettings
from twinmatch.twin.forecaster import Forecaster
from twinmatch.twin.matcher import MatchReport, MatchRequest, answer
from twinmatch.twin.mirror import Mirror, MirrorState
from twinmatch.twin.residuals import Residuals, nrmse, residuals, response_on, window_fit
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
    "response_on",
    "watched",
    "window_fit",
]


class Outcome(NamedTuple):
    """The results of one sample."""

    match: MatchReport | None
    verdicts: tuple[Verdict, ...]


class Twin:
    """A discriminator whose match requests are answered immediately, on one stream of samples."""

    def __init__(
        self,
        settings: TwinSettings | None = None,
        given: Sequence[Candidate] = (),
        *,
        matching: TwinSettings | None = None,
    ) -> None:
        """Begin without samples, with the given candidates, if any.

        `matching`: settings for the matches; default: `settings`.
        """
        self.settings = settings or TwinSettings()
        self.discriminator = Discriminator(self.settings, given)
        self._matching = matching or self.settings

    def push(self, sample: Sample) -> Outcome:
        """Take one sample; return the match and the verdicts that it triggers."""
        step = self.discriminator.push_sample(sample)
        if step.request is None:
            return Outcome(None, step.verdicts)
        report = answer(step.request, self._matching)
        return Outcome(report, step.verdicts + self.discriminator.push_match(report).verdicts)
