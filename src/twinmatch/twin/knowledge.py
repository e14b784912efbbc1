"""The verdict at a sample: made of what all parts of a twin know when they have taken it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple, Protocol, TypedDict

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
from twinmatch.health import SLOW, Fault, Health
from twinmatch.twin.candidates import CandidatePool
from twinmatch.twin.family_scores import UNSCORED
from twinmatch.twin.mirror import Residuals
from twinmatch.twin.trust import BandCheck, BandHistory

_ADAPTABLE: Final = SLOW | {Fault.DISTURBANCE}
"""Faults of a plant that still obeys its drive: its next matches adapt the twin."""
_LEFT: Final = "measurements have just left the forecast bands, perhaps by chance"
_AS_BEFORE: Final = (
    "its forecasts have held so far, and were trusted in earlier sessions"
)


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


class SaysOfHealth(Protocol):
    """What a monitor says beside its judgement of each sample."""

    @property
    def reservation(self) -> str:
        """Why nobody can be accused of a fault yet; empty if somebody can."""

    @property
    def doubt(self) -> str:
        """Why no reading can be relied on; empty unless they seem to have shifted."""


@dataclass(frozen=True, eq=False)
class Knowledge:
    """Who is asked for a verdict at one sample, when all have taken it, and what is asked of them."""

    sample: int
    window: tuple[int, int]
    """First and last sample of the window that is judged."""
    match: MatchResult
    scored: bool
    """Whether the candidates were scored on this window."""
    dismissed: tuple[str, ...]
    """Names of the candidates removed at this sample."""
    pool: CandidatePool
    """Knows the candidates' scores, who leads, and which structure the samples justify."""
    bands: BandCheck
    """How the newest readings lie in the leader's bands."""
    history: BandHistory
    """Knows since when readings lie outside, and at which levels they did not."""
    residuals: Residuals
    health: Health | None
    monitor: SaysOfHealth
    trial: str
    """Why a law on trial keeps the newest samples from being compared with forecasts; empty if none does."""
    trusted: tuple[float, ...]
    """The horizons, s, at which the verdict before trusted its leader."""
    decimals: int

    @property
    def fault(self) -> Fault | None:
        """The fault of the plant, if there is one."""
        return self.health.confirmed_fault if self.health else None

    @property
    def horizons(self) -> tuple[float, ...]:
        """Horizons of the forecasts, s."""
        return self.pool.forecaster.settings.horizons

    @cached_property
    def alone(self) -> dict[str, ForecastScore]:
        """How well the leader has forecast each signal, by its name: outputs, then inputs."""
        return self.pool.forecaster.standings.alone

    @cached_property
    def doubts(self) -> dict[float, Shortfall]:
        """Where the leader's forecasts do not pass the test, and why, by horizon, s."""
        leading = self.pool.forecaster.standings.leading
        if leading is None:
            return dict.fromkeys(self.horizons, FEW)
        doubts = leading.doubts(self.horizons, self.trusted)
        plant = leading.parameters.model.plant
        if len(plant.outputs) == 1:
            return doubts
        for name, output in plant.outputs.items():
            doubts_of_output = self.alone[name].doubts(self.horizons, self.trusted)
            named = {
                horizon: doubt.of(output.text or name)
                for horizon, doubt in doubts_of_output.items()
            }
            doubts = named | doubts  # at a horizon with a doubt already, that one stays
        return doubts


def trust_of(known: Knowledge) -> Trust:
    """How far to trust the leader: the first reason against it that applies."""
    fault_in_words = (
        f"the plant shows {known.fault.value}" if known.fault is not None else ""
    )
    if known.fault is not None and known.fault not in _ADAPTABLE:
        return Trust(TrustLevel.FAULT, fault_in_words)
    if doubt := known.monitor.doubt:
        return Trust(TrustLevel.DOUBTFUL, doubt)
    if known.fault is not None:
        return Trust(TrustLevel.DOUBTFUL, fault_in_words)
    if math.isnan(known.bands.miss):
        reservation = known.trial or known.monitor.reservation
        return Trust(TrustLevel.UNKNOWN, reservation or LEVEL_WORDS[TrustLevel.UNKNOWN])
    if known.history.lasts:
        return Trust(TrustLevel.DOUBTFUL, LEVEL_WORDS[TrustLevel.DOUBTFUL])
    return _tested(known.doubts, known)


def _tested(doubts: Mapping[float, Shortfall], known: Knowledge) -> Trust:
    """What the test says of a leader with nothing else against it."""
    doubts_in_words = doubt_words(doubts)
    trusted_in_words = _LEFT if known.history.since else LEVEL_WORDS[TrustLevel.TRUSTED]
    passes_somewhere = len(doubts) < len(known.horizons)
    if passes_somewhere and doubts_in_words:
        return Trust(TrustLevel.TRUSTED, f"{trusted_in_words}, but {doubts_in_words}")
    if passes_somewhere:
        return Trust(TrustLevel.TRUSTED, trusted_in_words)
    if doubts_in_words and all(
        doubt.certain for doubt in doubts.values() if doubt != FEW
    ):
        return Trust(TrustLevel.DOUBTFUL, doubts_in_words)
    is_remembered = known.pool.rests_on_memory(known.pool.forecaster.leader)
    if is_remembered and FEW in doubts.values():
        return Trust(TrustLevel.TRUSTED, _AS_BEFORE)
    return Trust(TrustLevel.UNKNOWN, doubts_in_words or FEW.words)


def verdict_of(known: Knowledge) -> Verdict:
    """The verdict that follows from what all parts know."""
    trust = trust_of(known)
    scores = known.pool.scores or UNSCORED
    forecaster = known.pool.forecaster
    leader = forecaster.leader
    confidence = math.nan if leader is None else forecaster.confidence
    standing = (forecaster.sentence, known.pool.estranged, scores.certainty)
    choice = known.pool.structures.choice
    structure = choice.chosen if choice is not None else ""
    bands = known.bands
    held_low, held_high = known.history.levels or (math.nan, math.nan)
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
        leader=leader,
        leader_confidence=confidence,
        decided=confidence >= DECIDED_FROM,
        certainty="; ".join(filter(None, standing)),
        **_named_fault(known.health),
        structure=structure,
        structure_parameters=_parameters_in(structure, forecaster.scores),
        miss_y=bands.miss_y,
        miss_u=bands.miss_u,
        inside_y=bands.inside_y,
        inside_u=bands.inside_u,
        miss_since=known.history.since,
        held_low=held_low,
        held_high=held_high,
        horizons=known.horizons,
        forecasts=forecaster.scores,
        trusted=tuple(
            horizon for horizon in known.horizons if horizon not in known.doubts
        ),
        signals=signal_scores(known),
    )


class NamedFault(TypedDict):
    """The fields of a verdict that name a fault."""

    fault: str
    fault_signal: str
    fault_since: int | None


def _named_fault(health: Health | None) -> NamedFault:
    if health is None or health.confirmed_fault is None:
        return NamedFault(fault="", fault_signal="", fault_since=None)
    return NamedFault(
        fault=health.confirmed_fault.value,
        fault_signal=health.signal,
        fault_since=health.since,
    )


def _parameters_in(
    structure: str, scores: Sequence[ForecastScore]
) -> Parameters | None:
    """Parameters of the twin in a structure whose forecasts have saved the most; None without one.

    Those that were fitted to compare the structures are not a twin's: no forecast has tested them.
    """
    in_structure = [
        score for score in scores if score.parameters.model.structure_name == structure
    ]
    gains = [
        -math.inf if math.isnan(score.gain) else score.gain for score in in_structure
    ]
    return in_structure[gains.index(max(gains))].parameters if in_structure else None


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
        **_named_fault(health),
        horizons=horizons,
    )


def signal_scores(known: Knowledge) -> tuple[SignalScore, ...]:
    """How far to trust the forecasts of each signal; figures of the newest bands are NaN without any."""
    newest = known.bands.each or ((math.nan, math.nan),) * len(known.alone)
    scores = []
    for (name, score), (miss, inside) in zip(known.alone.items(), newest, strict=True):
        doubts = score.doubts(known.horizons, known.trusted)
        trusted = tuple(horizon for horizon in known.horizons if horizon not in doubts)
        skills = score.persistence_skill, score.arx_skill
        scores.append(SignalScore(name, miss, inside, score.coverage, *skills, trusted))
    return tuple(scores)
