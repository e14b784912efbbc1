"""How certain the choice of the nominal candidate is, and which candidates the running controller holds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from twinmatch.comparing.graph_symbol import GraphSymbol
from twinmatch.comparing.margin import loop_controller, loop_plant, stability_margin
from twinmatch.comparing.matrix_gap import matrix_margin, matrix_nu_gap
from twinmatch.comparing.models import Candidate
from twinmatch.comparing.nu_gap import nu_gap
from twinmatch.comparing.plant_gap import LoopConditions, PlantGaps, spans_of
from twinmatch.comparing.scaling import best_scaling
from twinmatch.comparing.state_space import StateSpace
from twinmatch.comparing.uncertainty import (
    CONFIDENCE,
    SEED,
    FamilyUncertainty,
    family_uncertainty,
)
from twinmatch.comparing.undefined import UndefinedError
from twinmatch.comparing.verdict import CandidateScore
from twinmatch.dynamics import Law, LinearLaw, Parameters, PidGains, linearised
from twinmatch.errors import TwinmatchError
from twinmatch.signals import OperatingPoint, one_of_each, point_values


def nominal_of(candidates: tuple[CandidateScore, ...]) -> str | None:
    """The candidate nearest to the whole family.

    It has the smallest ν-gap sum (paper, section IV-C); of equal sums (two candidates always have
    equal ones), it is the one nearest to the plant as it is now.
    """
    if not candidates:
        return None

    def rank(candidate: CandidateScore) -> tuple[float, float, str]:
        to_plant = (
            1.0 if candidate.nu_gap_to_plant is None else candidate.nu_gap_to_plant
        )
        return candidate.nu_gap_sum, to_plant, candidate.name

    return min(candidates, key=rank).name


DECIDED_FROM = CONFIDENCE
"""Probability of being nominal from which the choice counts as decided; that of the intervals, too.

Of 200 simulated families whose plants have ν-gaps of 0.13 to 0.26, 199 reached this probability, and every
choice was right. With ν-gaps of 0.01 to 0.03, below the uncertainty of a match, one in fourteen did, by
chance.
"""


class Certainty(NamedTuple):
    """The part of a verdict that is filled in here; `Verdict` documents the fields."""

    candidates: tuple[CandidateScore, ...]
    certainty: str


def judge_uncertainty(
    candidates: Sequence[CandidateScore],
    twins: Sequence[Candidate],
    gaps: PlantGaps,
    nominal: str | None,
    loop: LoopConditions,
    *,
    plant: Parameters | None = None,
    seed: int = SEED,
) -> Certainty:
    """Add intervals and probabilities to the scores of a family, and margins to all candidates.

    A candidate that cannot be held at its operating point has no margin, and the reason for the first point
    at which one cannot be linearised is reported; neither is an error.

    Args:
        candidates: scores of the family, and after them of candidates beside it.
        twins: the family.
        gaps: ν-gaps between their plants.
        nominal: name of the candidate of the family that was chosen.
        loop: the loop in which they are held; its controller, if known, gives the margins.
        plant: the plant as it is now, if known; it decides between two candidates.
        seed: of the random draws.
    """
    names = [c.name for c in candidates]
    if nominal not in names:
        return Certainty(tuple(candidates), "")
    chosen = names.index(nominal)
    all_scores = with_margins(candidates, chosen, loop.law)
    scored = all_scores[: len(twins)]
    if twins[0].parameters.model.plant.single:
        scored = _with_intervals(
            scored, family_uncertainty(twins, gaps, loop, plant=plant, seed=seed)
        )
    sentences = [_choice(scored, chosen)]
    sentences += [_reach(scored, chosen)] if loop.law is not None else []
    sentences += [f"not compared everywhere: {reason}" for reason in gaps.left_out[:1]]
    return Certainty((*scored, *all_scores[len(twins) :]), "; ".join(sentences))


def _with_intervals(
    candidates: Sequence[CandidateScore], uncertainty: FamilyUncertainty
) -> tuple[CandidateScore, ...]:
    with_intervals = []
    for k, candidate in enumerate(candidates):
        score = replace(
            candidate,
            nu_gap_low=tuple(uncertainty.nu_gap_low[k].tolist()),
            nu_gap_high=tuple(uncertainty.nu_gap_high[k].tolist()),
            nu_gap_sum_low=float(uncertainty.sum_low[k]),
            nu_gap_sum_high=float(uncertainty.sum_high[k]),
            nominal_probability=float(uncertainty.nominal_probability[k]),
        )
        with_intervals.append(score)
    return tuple(with_intervals)


class _ReachOfLaw(NamedTuple):
    """How far the running controller reaches from one candidate; None where the candidate cannot be held."""

    margin: float | None = None
    """Stability margin with the candidate's plant."""
    gap: float | None = None
    """ν-gap from the chosen candidate's plant."""


def with_margins(
    candidates: Sequence[CandidateScore], chosen: int, law: Law | None
) -> tuple[CandidateScore, ...]:
    """Add the running controller's margin for each candidate, and its ν-gap from the chosen one.

    A candidate that cannot be held at its operating point has none; without a known controller, none has.
    """
    reaches = _reaches(candidates, chosen, law)
    if reaches is None:
        return tuple(candidates)
    return tuple(
        replace(candidate, margin=reach.margin, plant_gap_to_nominal=reach.gap)
        for candidate, reach in zip(candidates, reaches, strict=True)
    )


def _reaches(
    candidates: Sequence[CandidateScore], chosen: int, law: Law | None
) -> tuple[_ReachOfLaw, ...] | None:
    """The reach of the running controller from each candidate; None if it is not known or has none."""
    if isinstance(law, PidGains):
        return _reaches_of_pid(law, candidates, chosen)
    if not isinstance(law, LinearLaw):
        return None
    twins = tuple((c.parameters, c.operating_point) for c in candidates)
    try:
        return _reaches_of_linear_law(law, twins, chosen)
    except UndefinedError:
        return None


_margin = lru_cache(maxsize=64)(stability_margin)


def _reaches_of_pid(
    gains: PidGains, candidates: Sequence[CandidateScore], chosen: int
) -> tuple[_ReachOfLaw, ...] | None:
    """The reach of a PID controller from each candidate; None if it has no proportional part to scale by."""
    try:
        controller = loop_controller(gains)
    except TwinmatchError:
        return None
    plants = [_plant(candidate, gains) for candidate in candidates]
    centre = plants[chosen]
    reaches = []
    for plant in plants:
        if plant is None:
            reaches.append(_ReachOfLaw())
        else:
            margin = _margin(plant, controller)
            reaches.append(
                _ReachOfLaw(margin, nu_gap(plant, centre) if centre else None)
            )
    return tuple(reaches)


@lru_cache(maxsize=16)  # a family stays for many verdicts
def _reaches_of_linear_law(
    law: LinearLaw, twins: tuple[tuple[Parameters, OperatingPoint], ...], chosen: int
) -> tuple[_ReachOfLaw, ...]:
    """The reach of a linear law from each twin's plant, in the units in which its margin exceeds the ν-gaps by
    most; nothing is reached if the chosen one cannot be held.

    Raises:
        UndefinedError: margin or ν-gaps have no value.
    """
    systems = [_system(law, parameters, point) for parameters, point in twins]
    centre = systems[chosen]
    controller = StateSpace.of(law)
    if centre is None:
        return (_ReachOfLaw(),) * len(twins)
    spans = spans_of(twins[0][0].model.plant)
    family = [system for system in systems if system is not None]
    y, u, *_ = best_scaling(
        centre, family, controller, outputs=spans.output, inputs=spans.input
    )
    scaled_centre = centre.scaled(y, u)
    scaled_controller = controller.scaled(u, y)
    reaches = []
    for system in systems:
        if system is None:
            reaches.append(_ReachOfLaw())
        else:
            scaled = system.scaled(y, u)
            margin = matrix_margin(scaled, scaled_controller)
            reaches.append(_ReachOfLaw(margin, matrix_nu_gap(scaled_centre, scaled)))
    return tuple(reaches)


def _system(
    law: LinearLaw, parameters: Parameters, point: OperatingPoint
) -> StateSpace | None:
    """A twin's plant at an operating point, sampled as the law is; None if it cannot be held there."""
    try:
        return StateSpace.of(linearised(parameters, point, law.period))
    except TwinmatchError:
        return None


def _plant(candidate: CandidateScore, gains: PidGains) -> GraphSymbol | None:
    try:
        return loop_plant(
            candidate.parameters,
            one_of_each("set-point", point_values(candidate.operating_point)),
            gains,
        )
    except TwinmatchError:
        return None


def _choice(candidates: Sequence[CandidateScore], chosen: int) -> str:
    name = candidates[chosen].name
    share = candidates[chosen].nominal_probability
    if len(candidates) == 1:
        return f"{name} is the only candidate"
    if math.isnan(share):
        return f"{name} is nearest to the whole family"
    if share >= DECIDED_FROM:
        return f"{name} is nominal with probability {_probability(share)}"
    rivals = [c for c in candidates if c.name != name]
    rival = rivals[int(np.argmax([c.nominal_probability for c in rivals]))]
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
    begin = (
        f"the controller stabilises it and every plant within a ν-gap of {margin:.2f}"
    )
    gaps = {
        c.name: c.plant_gap_to_nominal
        for c in candidates
        if c.name != candidates[chosen].name
    }
    beyond = [
        f"{n} ({g:.2f} away)" for n, g in gaps.items() if g is not None and g >= margin
    ]
    within = [g for g in gaps.values() if g is not None and g < margin]
    if lost:
        return f"{begin}, but not {', '.join(lost)}"
    if beyond:
        return f"{begin}, which excludes {', '.join(beyond)}"
    if within and len(within) == len(gaps):
        return f"{begin}, which covers all candidates (the farthest is {max(within):.2f} away)"
    return begin
