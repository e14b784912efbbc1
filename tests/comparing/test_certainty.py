"""How certain a verdict is, on twins of simulated rigs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twinmatch.comparing import (
    CandidateScore,
    Certainty,
    LoopConditions,
    PlantGaps,
    Uncertain,
    family_uncertainty,
    judge_uncertainty,
    loop_controller,
    loop_plant,
    nu_gap_of,
    plant_gaps,
    spans_of,
    stability_margin,
)
from twinmatch.dynamics import Parameters, PidGains, gains_of
from twinmatch.plants import Peltier

MODEL = Peltier.model()
POINTS = (30.0, 50.0, 70.0, 90.0)
RIGS = {
    "50 °C": MODEL.parameters(seebeck=0.060, conductance=0.60, heat_capacity=28.0),
    "70 °C": MODEL.parameters(seebeck=0.055, conductance=0.55, heat_capacity=28.0),
    "90 °C": MODEL.parameters(seebeck=0.065, conductance=0.50, heat_capacity=22.0),
}
TERMS = LoopConditions(gains_of(Peltier, 1.0), spans_of(Peltier))
COVARIANCE = np.diag([0.002, 0.03, 0.8]) ** 2
"""Of Seebeck coefficient, conductance and heat capacity, as a good window leaves them."""


def scored(name: str, rig: Parameters, operating_point: float | None = None) -> CandidateScore:
    point = float(name.split(maxsplit=1)[0]) if operating_point is None else operating_point
    return CandidateScore(name, point, rig, 0, 100, (), "22221", 0.1, None, 0.1)


def twins(factor: float = 1.0) -> list[Uncertain]:
    return [Uncertain(rig, MODEL.structure.free, factor * COVARIANCE) for rig in RIGS.values()]


def gaps(family: list[Uncertain]) -> PlantGaps:
    return plant_gaps([t.parameters for t in family], POINTS, TERMS)


def judged(
    nominal: str = "70 °C", factor: float = 1.0, gains: PidGains | None = None, family: int = 3
) -> Certainty:
    candidates = [scored(name, rig) for name, rig in RIGS.items()][:family]
    terms = TERMS if gains is None else TERMS._replace(gains=gains)
    known = twins(factor)[:family]
    return judge_uncertainty(candidates, known, gaps(known), nominal, terms)


def smallest_sum() -> str:
    return list(RIGS)[int(np.argmin(gaps(twins()).matrix.sum(axis=0)))]


def test_every_field_is_filled_with_what_its_source_says() -> None:
    found = judged()
    known = family_uncertainty(twins(), gaps(twins()), TERMS)
    nominal = loop_plant(RIGS["70 °C"], 70.0)
    for k, (candidate, (name, rig)) in enumerate(zip(found.candidates, RIGS.items(), strict=True)):
        point = float(name.split(maxsplit=1)[0])
        assert candidate.margin == stability_margin(
            loop_plant(rig, point), loop_controller(gains_of(Peltier, 1.0))
        )
        assert candidate.plant_gap_to_nominal == nu_gap_of(loop_plant(rig, point), nominal)
        assert candidate.nu_gap_low == tuple(known.nu_gap_low[k])
        assert candidate.nu_gap_high == tuple(known.nu_gap_high[k])
        assert candidate.nu_gap_sum_low == known.sum_low[k]
        assert candidate.nu_gap_sum_high == known.sum_high[k]
        assert candidate.nominal_probability == known.nominal_probability[k]
        assert candidate.nu_gap_sum == 0.1  # what was there stays


def test_a_clear_choice_is_decided_and_the_controller_holds_all() -> None:
    name = smallest_sum()
    found = judged(name, factor=1e-4)
    assert found.decided
    assert found.certainty.startswith(
        f"{name} is nominal with probability above 0.99; the controller stabilises it"
    )
    assert "which covers all candidates (the farthest is 0." in found.certainty


def test_when_the_data_cannot_tell_it_says_so() -> None:
    found = judged(smallest_sum(), factor=100.0)
    assert not found.decided
    assert found.certainty.startswith(
        f"the data do not decide which candidate is nominal: {smallest_sum()} with probability 0."
    )
    chosen = next(c for c in found.candidates if c.name == smallest_sum())
    assert chosen.nominal_probability < 0.9


def test_a_choice_against_the_probabilities_is_not_decided() -> None:
    other = next(name for name in RIGS if name != smallest_sum())
    found = judged(other, factor=1e-4)
    assert not found.decided
    assert f"{other} with probability below 0.01, {smallest_sum()} with above 0.99" in found.certainty


def test_a_single_candidate_leaves_no_choice() -> None:
    found = judged("50 °C", family=1)
    assert found.decided
    margin = stability_margin(loop_plant(RIGS["50 °C"], 50.0), loop_controller(gains_of(Peltier, 1.0)))
    assert found.certainty == (
        "50 °C is the only candidate; the controller stabilises it and every plant "
        f"within a ν-gap of {margin:.2f}"
    )


def test_a_controller_that_is_too_hot_holds_nothing() -> None:
    hot = replace(Peltier.loop, proportional=38.57 * 400, integral=1.46877 * 400, derivative=6.66875 * 400)
    found = judged(gains=hot)
    assert [c.margin for c in found.candidates] == [0.0, 0.0, 0.0]
    assert found.certainty.endswith("; the controller does not stabilise it")


def test_plants_beyond_the_margin_and_lost_ones_are_named() -> None:
    family, matrix = twins(), gaps(twins())
    candidates = [scored(name, rig) for name, rig in RIGS.items()]
    # half the heat capacity, twice the gain: held, but far away
    light = replace(candidates[2], parameters=RIGS["90 °C"].replace(heat_capacity=12.0))
    found = judge_uncertainty([*candidates[:2], light], family, matrix, "70 °C", TERMS)
    assert found.candidates[2].plant_gap_to_nominal > found.candidates[1].margin > 0
    assert found.candidates[2].margin > 0
    assert "which excludes 90 °C (0." in found.certainty
    lighter = replace(candidates[2], parameters=RIGS["90 °C"].replace(heat_capacity=0.4))
    found = judge_uncertainty([*candidates[:2], lighter], family, matrix, "70 °C", TERMS)
    assert found.candidates[2].margin == 0.0
    assert found.certainty.endswith(", but not 90 °C")


def test_a_candidate_out_of_reach_has_no_margin() -> None:
    candidates = [scored(name, rig) for name, rig in RIGS.items()]
    candidates[0] = scored("50 °C", RIGS["50 °C"], operating_point=300.0)
    found = judge_uncertainty(candidates, twins(), gaps(twins()), "70 °C", TERMS)
    assert found.candidates[0].margin is None
    assert found.candidates[0].plant_gap_to_nominal is None
    assert found.candidates[1].margin is not None
    found = judge_uncertainty(candidates, twins(), gaps(twins()), "50 °C", TERMS)
    assert (
        "the controller has no margin for it, because no input holds it at its set-point" in found.certainty
    )
    assert found.candidates[1].plant_gap_to_nominal is None


def test_given_candidates_are_exact() -> None:
    """They have no covariance, so nothing is left open."""
    candidates = [scored(name, rig) for name, rig in RIGS.items()]
    exact = [Uncertain(rig) for rig in RIGS.values()]
    found = judge_uncertainty(candidates, exact, gaps(exact), smallest_sum(), TERMS)
    assert found.decided
    assert all(c.nu_gap_low == c.nu_gap_high for c in found.candidates)


def test_points_at_which_a_candidate_has_no_plant_are_reported() -> None:
    hopeless = {**RIGS, "90 °C": RIGS["90 °C"].replace(heat_capacity=1e-9)}
    family = [Uncertain(rig) for rig in hopeless.values()]
    candidates = [scored(name, rig) for name, rig in hopeless.items()]
    found = judge_uncertainty(candidates, family, gaps(family), "50 °C", TERMS)
    assert "; not compared everywhere: Peltier rig, held sink: its shortest time constant" in found.certainty


def test_without_a_nominal_there_is_nothing_to_say() -> None:
    assert judge_uncertainty([], [], gaps([]), None, TERMS) == Certainty((), False, "")


def test_of_two_the_plant_is_asked() -> None:
    family = twins(1e-2)[:2]
    candidates = [scored(name, RIGS[name]) for name in list(RIGS)[:2]]
    found = judge_uncertainty(candidates, family, gaps(family), "50 °C", TERMS, plant=RIGS["50 °C"])
    assert found.decided
    found = judge_uncertainty(candidates, family, gaps(family), "50 °C", TERMS)
    assert not found.decided
    assert found.candidates[0].nominal_probability == pytest.approx(0.5)
