"""The twin engine: takes samples, returns matches and verdicts; shared by the live nodes and by replay.

`Discriminator` keeps the schedule and the pool of candidates: it requests matches and judges the candidates.
`carry_out` answers such a `MatchRequest`. `Mirror` runs the nominal twin beside the plant. `Twin` combines
the first two on one stream. `StructureFits` fits the plant's structures to the newest samples, and
`choose_structure` finds the one that they support. All of them are synchronous and depend only on the samples
pushed: no clock, no thread, no random state, so a replay of a recorded session gives exactly the recorded
verdicts.
"""

from twinmatch.twin.candidates import FamilyModels
from twinmatch.twin.door import Door, filled_stretches
from twinmatch.twin.engine import Discriminator, Outcome, Step, Twin
from twinmatch.twin.forecaster import Forecaster, Snapshot
from twinmatch.twin.matcher import MatchReport, MatchRequest, carry_out
from twinmatch.twin.mirror import (
    Fits,
    Mirror,
    MirrorState,
    nrmse,
    response_on,
    window_fit,
    window_fits,
)
from twinmatch.twin.schedule import Schedule, ScheduleSettings
from twinmatch.twin.settings import (
    ForecastSettings,
    TrustLimits,
    TwinError,
    TwinSettings,
)
from twinmatch.twin.structure_fits import StructureFits, watched
from twinmatch.twin.structures import StructureScore, choose_structure

__all__ = [
    "Discriminator",
    "Door",
    "FamilyModels",
    "Fits",
    "ForecastSettings",
    "Forecaster",
    "MatchReport",
    "MatchRequest",
    "Mirror",
    "MirrorState",
    "Outcome",
    "Schedule",
    "ScheduleSettings",
    "Snapshot",
    "Step",
    "StructureFits",
    "StructureScore",
    "TrustLimits",
    "Twin",
    "TwinError",
    "TwinSettings",
    "carry_out",
    "choose_structure",
    "filled_stretches",
    "nrmse",
    "response_on",
    "watched",
    "window_fit",
    "window_fits",
]
