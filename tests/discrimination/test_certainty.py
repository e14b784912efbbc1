"""What a verdict is told about how sure it is, on twins of simulated rigs."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from twinmatch.discrimination import (
    CandidateScore,
    Certainty,
    SimoModel,
    family_uncertainty,
    identify,
    judge_uncertainty,
    loop_margin,
    loop_plant,
    nu_gap_matrix,
    nu_gap_of,
    twin_response,
)
from twinmatch.dynamics import Parameters, PidGains, begin, simulate_closed_loop
from twinmatch.plants import Peltier
from twinmatch.signals import FloatArray, Window

REFERENCE = np.repeat([30.0, 50.0, 70.0, 55.0], [40, 120, 140, 120])
MODEL = Peltier.model()
RIGS = {
    "50 °C": MODEL.parameters(seebeck=0.060, conductance=0.60, heat_capacity=28.0),
    "70 °C": MODEL.parameters(seebeck=0.055, conductance=0.55, heat_capacity=28.0),
    "90 °C": MODEL.parameters(seebeck=0.065, conductance=0.50, heat_capacity=22.0),
}


def scored(name: str, rig: Parameters, operating_point: float | None = None) -> CandidateScore:
    point = float(name.split(maxsplit=1)[0]) if operating_point is None else operating_point
    return CandidateScore(name, point, rig, 0, 100, (), "22221", 0.1, None, 0.1)


@cache
def models() -> tuple[SimoModel, ...]:
    run = simulate_closed_loop(RIGS["50 °C"], REFERENCE, states=begin(RIGS["50 °C"], 30.0))
    window = Window(REFERENCE, run.output, run.input)
    twins = (
        twin_response(rig, window, Peltier.loop, Peltier.sensor, k) for k, rig in enumerate(RIGS.values())
    )
    return tuple(identify(twin, ["22221"])[0] for twin in twins)


def gaps(family: tuple[SimoModel, ...]) -> FloatArray:
    return nu_gap_matrix([m.symbol for m in family])


def judged(nominal: str = "70 °C", factor: float = 1.0, gains: PidGains | None = None) -> Certainty:
    family = tuple(with_covariance(m, factor) for m in models())
    candidates = [scored(name, rig) for name, rig in RIGS.items()]
    return judge_uncertainty(candidates, family, gaps(family), nominal, gains=gains)


def with_covariance(model: SimoModel, factor: float) -> SimoModel:
    parts = [replace(part, covariance=part.covariance * factor) for part in (model.y, model.u)]
    return SimoModel(model.order, *parts)


def smallest_sum() -> str:
    return list(RIGS)[int(np.argmin(gaps(models()).sum(axis=0)))]


def test_every_field_is_filled_with_what_its_source_says() -> None:
    found = judged()
    known = family_uncertainty(models(), gaps(models()))
    nominal = loop_plant(RIGS["70 °C"], 70.0)
    for k, (candidate, (name, rig)) in enumerate(zip(found.candidates, RIGS.items(), strict=True)):
        point = float(name.split(maxsplit=1)[0])
        assert candidate.margin == loop_margin(rig, point)
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
        f"{name} is nominal with probability above 0.99; the controller holds it"
    )
    assert "so all candidates (the farthest is 0." in found.certainty


def test_when_the_data_cannot_tell_it_says_so() -> None:
    found = judged(smallest_sum(), factor=100.0)
    assert not found.decided
    assert found.certainty.startswith(
        f"the data do not tell which candidate is nominal: {smallest_sum()} with probability 0."
    )
    chosen = next(c for c in found.candidates if c.name == smallest_sum())
    assert chosen.nominal_probability < 0.9


def test_a_choice_against_the_probabilities_is_not_decided() -> None:
    other = next(name for name in RIGS if name != smallest_sum())
    found = judged(other, factor=1e-4)
    assert not found.decided
    assert f"{other} with probability below 0.01, {smallest_sum()} with above 0.99" in found.certainty


def test_a_single_candidate_leaves_no_choice() -> None:
    found = judge_uncertainty([scored("50 °C", RIGS["50 °C"])], models()[:1], gaps(models()[:1]), "50 °C")
    assert found.decided
    margin = loop_margin(RIGS["50 °C"], 50.0)
    assert found.certainty == (
        f"50 °C is the only candidate; the controller holds it and every plant within a ν-gap of {margin:.2f}"
    )


def test_a_controller_that_is_too_hot_holds_nothing() -> None:
    hot = replace(Peltier.loop, proportional=38.57 * 400, integral=1.46877 * 400, derivative=6.66875 * 400)
    found = judged(gains=hot)
    assert [c.margin for c in found.candidates] == [0.0, 0.0, 0.0]
    assert found.certainty.endswith("; the controller does not hold it")


def test_plants_beyond_the_margin_and_lost_ones_are_named() -> None:
    family, matrix = models(), gaps(models())
    candidates = [scored(name, rig) for name, rig in RIGS.items()]
    # half the heat capacity, twice the gain: held, but far away
    light = replace(candidates[2], parameters=RIGS["90 °C"].replace(heat_capacity=12.0))
    found = judge_uncertainty([*candidates[:2], light], family, matrix, "70 °C")
    assert found.candidates[2].plant_gap_to_nominal > found.candidates[1].margin > 0
    assert found.candidates[2].margin > 0
    assert "which does not reach 90 °C (0." in found.certainty
    lighter = replace(candidates[2], parameters=RIGS["90 °C"].replace(heat_capacity=0.4))
    found = judge_uncertainty([*candidates[:2], lighter], family, matrix, "70 °C")
    assert found.candidates[2].margin == 0.0
    assert found.certainty.endswith(", but not 90 °C")


def test_a_candidate_out_of_reach_has_no_margin() -> None:
    candidates = [scored(name, rig) for name, rig in RIGS.items()]
    candidates[0] = scored("50 °C", RIGS["50 °C"], operating_point=300.0)
    found = judge_uncertainty(candidates, models(), gaps(models()), "70 °C")
    assert found.candidates[0].margin is None
    assert found.candidates[0].plant_gap_to_nominal is None
    assert found.candidates[1].margin is not None
    found = judge_uncertainty(candidates, models(), gaps(models()), "50 °C")
    assert "the controller has no margin on it, because no input holds it at its set-point" in found.certainty
    assert found.candidates[1].plant_gap_to_nominal is None


def test_without_covariances_the_margins_remain() -> None:
    found = judged(factor=np.nan)
    assert not found.decided
    assert found.certainty.startswith("nothing tells how sure the choice is (uncertainty: the model of order")
    assert all(c.margin for c in found.candidates)
    assert all(c.nu_gap_low == () for c in found.candidates)


def test_without_a_nominal_there_is_nothing_to_say() -> None:
    assert judge_uncertainty([], [], np.zeros((0, 0)), None) == Certainty((), False, "")


def test_of_two_the_plant_is_asked() -> None:
    family = tuple(with_covariance(m, 1e-2) for m in models()[:2])
    candidates = [scored(name, RIGS[name]) for name in list(RIGS)[:2]]
    found = judge_uncertainty(candidates, family, gaps(family), "50 °C", plant=family[0])
    assert found.decided
    found = judge_uncertainty(candidates, family, gaps(family), "50 °C")
    assert not found.decided
    assert found.candidates[0].nominal_probability == pytest.approx(0.5)
