"""Certainty of a verdict: intervals, probabilities and margins of its candidates, and their summary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twinmatch.comparing.graph_symbol import GraphSymbol
from twinmatch.comparing.held import Held
from twinmatch.comparing.loop import loop_controller, loop_plant
from twinmatch.comparing.margin import stability_margin
from twinmatch.comparing.nu_gap import nu_gap_of
from twinmatch.comparing.plant_gap import PlantGaps
from twinmatch.comparing.uncertainty import (
    CONFIDENCE,
    SEED,
    FamilyUncertainty,
    Uncertain,
    family_uncertainty,
)
from twinmatch.comparing.verdict import CandidateScore
from twinmatch.dynamics import Parameters, PidGains
from twinmatch.errors import TwinmatchError

__all__ = ["DECIDED_FROM", "Certainty", "judge_uncertainty", "with_margins"]

DECIDED_FROM = CONFIDENCE
"""Probability of being nominal from which the choice counts as decided; that of the intervals, too.

Of 200 simulated families whose plants have ν-gaps of 0.13 to 0.26, 199 reached this probability, and every
choice was right. With ν-gaps of 0.01 to 0.03, below the uncertainty of a match, one in fourteen did, by
chance.
"""


@dataclass(frozen=True)
class Certainty:
    """The part of a verdict that is filled in here; `Verdict` documents the fields."""

    candidates: tuple[CandidateScore, ...]
    decided: bool
    certainty: str


def judge_uncertainty(
    candidates: Sequence[CandidateScore],
    twins: Sequence[Uncertain],
    gaps: PlantGaps,
    nominal: str | None,
    terms: Held,
    *,
    plant: Parameters | None = None,
    seed: int = SEED,
) -> Certainty:
    """Add intervals, probabilities and margins to the scores of a family.

    A candidate that cannot be held at its operating point has no margin, and the reason for the first point
    at which one cannot be linearised is reported; neither is an error.

    Args:
        candidates: scores of the family.
        twins: the same candidates, with the covariances of their matches.
        gaps: ν-gaps between their plants.
        nominal: name of the chosen candidate.
        terms: the loop in which they are held; its controller, if known, gives the margins.
        plant: the plant as it is now, if known; it decides between two candidates.
        seed: seed of the random draws.
    """
    names = [c.name for c in candidates]
    if nominal not in names:
        return Certainty(tuple(candidates), False, "")
    chosen = names.index(nominal)
    uncertainty = family_uncertainty(twins, gaps, terms, plant=plant, seed=seed)
    scored = _with_intervals(with_margins(candidates, chosen, terms.gains), uncertainty)
    decided = bool(uncertainty.nominal_probability[chosen] >= DECIDED_FROM)
    sentences = [_choice(scored, chosen, decided)]
    sentences += [_reach(scored, chosen)] if terms.gains is not None else []
    sentences += [f"not compared everywhere: {reason}" for reason in gaps.left_out[:1]]
    return Certainty(scored, decided, "; ".join(sentences))


def with_margins(
    candidates: Sequence[CandidateScore], chosen: int, gains: PidGains | None
) -> tuple[CandidateScore, ...]:
    """Add the running controller's margin for each candidate, and its ν-gap from the chosen one.

    A candidate that cannot be held at its operating point has none; without a known controller, none has.
    """
    if gains is None:
        return tuple(candidates)
    try:
        controller = loop_controller(gains)
    except TwinmatchError:  # the controller has no proportional part to scale by
        return tuple(candidates)
    plants = [_plant(c, gains) for c in candidates]
    centre = plants[chosen]
    return tuple(
        replace(
            c,
            margin=None if p is None else stability_margin(p, controller),
            plant_gap_to_nominal=None if p is None or centre is None else nu_gap_of(p, centre),
        )
        for c, p in zip(candidates, plants, strict=True)
    )


def _plant(candidate: CandidateScore, gains: PidGains) -> GraphSymbol | None:
    try:
        return loop_plant(candidate.parameters, candidate.operating_point, gains)
    except TwinmatchError:
        return None


def _with_intervals(
    candidates: Sequence[CandidateScore], uncertainty: FamilyUncertainty
) -> tuple[CandidateScore, ...]:
    return tuple(
        replace(
            c,
            nu_gap_low=tuple(uncertainty.nu_gap_low[k].tolist()),
            nu_gap_high=tuple(uncertainty.nu_gap_high[k].tolist()),
            nu_gap_sum_low=float(uncertainty.sum_low[k]),
            nu_gap_sum_high=float(uncertainty.sum_high[k]),
            nominal_probability=float(uncertainty.nominal_probability[k]),
        )
        for k, c in enumerate(candidates)
    )


def _choice(candidates: Sequence[CandidateScore], chosen: int, decided: bool) -> str:
    name, share = candidates[chosen].name, candidates[chosen].nominal_probability
    if len(candidates) == 1:
        return f"{name} is the only candidate"
    if decided:
        return f"{name} is nominal with probability {_probability(share)}"
    others = [c for c in candidates if c.name != name]
    rival = others[int(np.argmax([c.nominal_probability for c in others]))]
    return (
        f"the data do not decide which candidate is nominal: {name} with probability {_probability(share)}, "
        f"{rival.name} with {_probability(rival.nominal_probability)}"
    )


def _probability(share: float) -> str:
    """Format a probability as finely as the draws resolve it."""
    if share > 0.99:
        return "above 0.99"
    return "below 0.01" if share < 0.01 else f"{share:.2f}"


def _reach(candidates: Sequence[CandidateScore], chosen: int) -> str:
    """Which candidates the controller is guaranteed to hold (Vinnicombe: ν-gap to nominal below margin)."""
    margin = candidates[chosen].margin
    lost = [c.name for c in candidates if c.margin == 0]
    if margin is None:
        return "the controller has no margin for it, because no input holds it at its set-point"
    if margin == 0:
        return "the controller does not stabilise it"
    begin = f"the controller stabilises it and every plant within a ν-gap of {margin:.2f}"
    gaps = {c.name: c.plant_gap_to_nominal for c in candidates if c.name != candidates[chosen].name}
    beyond = [f"{n} ({g:.2f} away)" for n, g in gaps.items() if g is not None and g >= margin]
    within = [g for g in gaps.values() if g is not None and g < margin]
    if lost:
        return f"{begin}, but not {', '.join(lost)}"
    if beyond:
        return f"{begin}, which excludes {', '.join(beyond)}"
    if within and len(within) == len(gaps):
        return f"{begin}, which covers all candidates (the farthest is {max(within):.2f} away)"
    return begin
