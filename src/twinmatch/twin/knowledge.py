"""What is known at a sample, and the verdict that it makes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from twinmatch.comparing import (
    DECIDED_FROM,
    FEW,
    LEVEL_WORDS,
    ForecastScore,
    Shortfall,
    SignalScore,
    TrustLevel,
    Verdict,
    doubt_words,
)
from twinmatch.defects import Defect
from twinmatch.dynamics import Parameters
from twinmatch.health import SLOW, Fault, Health, HealthState
from twinmatch.twin.candidates import FamilyScores
from twinmatch.twin.mirror import Residuals
from twinmatch.twin.trust import BandCheck

_ADAPTABLE: Final = SLOW | {Fault.DISTURBANCE}
"""Faults of a plant that still obeys its drive: its next matches adapt the twin."""
_LEFT: Final = "measurements have just left the forecast bands, perhaps by chance"
_AS_BEFORE: Final = "its forecasts have held so far, and were trusted in earlier sessions"


class MatchResult(NamedTuple):
    """What became of the match of a window."""

    word: str = ""
    """`ADMITTED` or `REFUSED`; empty if no match was requested."""
    reason: str = ""
    """What caused the verdict, in one sentence."""


class Trust(NamedTuple):
    """How far to trust the leader, and why."""

    level: TrustLevel
    reason: str


@dataclass(frozen=True)
class Knowledge:
    """Everything that a verdict is made from, as it is at one sample."""

    sample: int
    window: tuple[int, int]
    """First and last sample of the window that is judged."""
    match: MatchResult
    scored: bool
    """Whether the candidates were scored on this window."""
    dismissed: tuple[str, ...]
    """Names of the candidates removed at this sample."""
    scores: FamilyScores
    leader: str | None
    confidence: float
    """How often the leader was nearly the best, 0 to 1."""
    forecasts: tuple[ForecastScore, ...]
    """How well all candidates have forecast, also compared with forecasts that need no twin."""
    alone: Mapping[str, ForecastScore]
    """How well the leader has forecast each signal, by its name: outputs, then inputs."""
    standing: str
    """A sentence on who leads."""
    remembered: bool
    """Whether the leader was trusted in earlier sessions."""
    trusted: tuple[float, ...]
    """The horizons, s, at which the verdict before trusted its leader."""
    horizons: tuple[float, ...]
    """Horizons of the forecasts, s."""
    bands: BandCheck
    """How the newest readings lie in the leader's bands."""
    outside: bool
    """Whether readings lie outside the bands by more than chance."""
    miss_since: int | None
    """First sample of the current stretch outside the bands."""
    held: tuple[float, float]
    """Lowest and highest output of the range in which the bands have held; NaN without one."""
    residuals: Residuals
    health: Health | None
    reservation: str
    """Why nobody can be accused of a fault yet; empty if somebody can."""
    doubt: str
    """Why no reading can be relied on; empty unless they seem to have shifted."""
    structure: str
    """The structure that the samples justify; empty before the first comparison."""
    decimals: int

    @property
    def fault(self) -> Fault | None:
        """The fault of the plant, if there is one."""
        return self.health.fault if self.health and self.health.state is HealthState.FAULT else None

    @property
    def signal(self) -> str:
        """What the fault concerns, by its name in the plant file."""
        return self.health.signal if self.health is not None and self.fault is not None else ""

    @property
    def leading(self) -> ForecastScore | None:
        """The leader's score."""
        return next((score for score in self.forecasts if score.name == self.leader), None)

    @property
    def doubts(self) -> dict[float, Shortfall]:
        """Where the leader's forecasts do not pass the test, and why, by horizon, s."""
        leading = self.leading
        if leading is None:
            return dict.fromkeys(self.horizons, FEW)
        doubts = leading.doubts(self.horizons, self.trusted)
        plant = leading.parameters.model.plant
        if len(plant.outputs) == 1:
            return doubts
        for name, output in plant.outputs.items():
            doubts_of_output = self.alone[name].doubts(self.horizons, self.trusted)
            named = {horizon: doubt.of(output.text or name) for horizon, doubt in doubts_of_output.items()}
            doubts = named | doubts  # at a horizon with a doubt already, that one stays
        return doubts

    @property
    def structure_parameters(self) -> Parameters | None:
        """Parameters of the twin in that structure whose forecasts have saved the most; None without one.

        Those that were fitted to compare the structures are not a twin's: no forecast has tested them.
        """
        having = [s for s in self.forecasts if s.parameters.model.structure_name == self.structure]
        gains = [-math.inf if math.isnan(score.gain) else score.gain for score in having]
        return having[gains.index(max(gains))].parameters if having else None


def trust_of(known: Knowledge) -> Trust:
    """How far to trust the leader: the first reason against it that applies."""
    fault_in_words = f"the plant shows {known.fault.value}" if known.fault is not None else ""
    if known.fault is not None and known.fault not in _ADAPTABLE:
        return Trust(TrustLevel.FAULT, fault_in_words)
    if known.doubt:
        return Trust(TrustLevel.DOUBTFUL, known.doubt)
    if known.fault is not None:
        return Trust(TrustLevel.DOUBTFUL, fault_in_words)
    if math.isnan(known.bands.miss):
        return Trust(TrustLevel.UNKNOWN, known.reservation or LEVEL_WORDS[TrustLevel.UNKNOWN])
    if known.outside:
        return Trust(TrustLevel.DOUBTFUL, LEVEL_WORDS[TrustLevel.DOUBTFUL])
    return _tested(known.doubts, known)


def _tested(doubts: Mapping[float, Shortfall], known: Knowledge) -> Trust:
    """What the test says of a leader with nothing else against it."""
    doubts_in_words = doubt_words(doubts)
    trusted_in_words = _LEFT if known.miss_since else LEVEL_WORDS[TrustLevel.TRUSTED]
    passes_somewhere = len(doubts) < len(known.horizons)
    if passes_somewhere and doubts_in_words:
        return Trust(TrustLevel.TRUSTED, f"{trusted_in_words}, but {doubts_in_words}")
    if passes_somewhere:
        return Trust(TrustLevel.TRUSTED, trusted_in_words)
    if doubts_in_words and all(doubt.certain for doubt in doubts.values() if doubt != FEW):
        return Trust(TrustLevel.DOUBTFUL, doubts_in_words)
    if known.remembered and FEW in doubts.values():
        return Trust(TrustLevel.TRUSTED, _AS_BEFORE)
    return Trust(TrustLevel.UNKNOWN, doubts_in_words or FEW.words)


def verdict_of(known: Knowledge) -> Verdict:
    """The verdict that what is known makes."""
    trust = trust_of(known)
    scores = known.scores
    bands = known.bands
    fault = known.fault
    doubts = known.doubts
    led = known.leader is not None
    return Verdict(
        sample=known.sample,
        first=known.window[0],
        last=known.window[1],
        level=trust.level,
        level_reason=trust.reason,
        stands=not known.scored,
        nominal=scores.nominal,
        reason=known.match.reason,
        match=known.match.word,
        dismissed=known.dismissed,
        decimals=known.decimals,
        candidates=scores.candidates,
        order=scores.order,
        nu_gap=scores.nu_gap,
        nu_gap_points=scores.nu_gap_points,
        identified_gap=scores.identified_gap,
        driven_rms_y=known.residuals.y,
        closed_rms_u=known.residuals.u,
        leader=known.leader,
        leader_confidence=known.confidence if led else math.nan,
        decided=led and known.confidence >= DECIDED_FROM,
        certainty="; ".join(sentence for sentence in (known.standing, scores.certainty) if sentence),
        fault="" if fault is None else fault.value,
        fault_signal=known.signal,
        fault_since=known.health.since if fault is not None and known.health else None,
        structure=known.structure,
        structure_parameters=known.structure_parameters,
        miss_y=bands.miss_y,
        miss_u=bands.miss_u,
        inside_y=bands.inside_y,
        inside_u=bands.inside_u,
        miss_since=known.miss_since,
        held_low=known.held[0],
        held_high=known.held[1],
        horizons=known.horizons,
        forecasts=known.forecasts,
        trusted=tuple(horizon for horizon in known.horizons if horizon not in doubts),
        signals=_signals(known),
    )


def no_verdict(
    sample: int,
    window: tuple[int, int],
    defect: Defect,
    *,
    health: Health | None,
    horizons: tuple[float, ...],
    decimals: int,
) -> Verdict:
    """The verdict at a sample at which none could be made; it repeats the newest fault, as nobody has seen
    its end."""
    fault = health if health is not None and health.state is HealthState.FAULT else None
    return Verdict(
        sample=sample,
        first=window[0],
        last=window[1],
        level=TrustLevel.UNKNOWN,
        level_reason="no verdict could be made, because of a defect of this program",
        stands=True,
        nominal=None,
        reason=f"no verdict could be made, because of a defect in {defect}",
        decimals=decimals,
        candidates=(),
        order=None,
        nu_gap=(),
        driven_rms_y=math.nan,
        closed_rms_u=math.nan,
        fault=fault.fault.value if fault is not None and fault.fault is not None else "",
        fault_signal=fault.signal if fault is not None else "",
        fault_since=fault.since if fault is not None else None,
        horizons=horizons,
    )


def _signals(known: Knowledge) -> tuple[SignalScore, ...]:
    """How far to trust the forecasts of each signal; figures of the newest bands are NaN without any."""
    newest = known.bands.each or ((math.nan, math.nan),) * len(known.alone)
    scores = []
    for (name, score), (miss, inside) in zip(known.alone.items(), newest, strict=True):
        doubts = score.doubts(known.horizons, known.trusted)
        trusted = tuple(horizon for horizon in known.horizons if horizon not in doubts)
        skills = score.persistence_skill, score.arx_skill
        scores.append(SignalScore(name, miss, inside, score.coverage, *skills, trusted))
    return tuple(scores)
