"""Intervals of the ν-gap: what they promise, checked on families whose truth is known.

`python tests/discrimination/test_uncertainty.py 200` repeats the check with 200 families.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from scipy.signal import lfilter

from twinmatch.discrimination import (
    DiscriminationError,
    SimoModel,
    family_uncertainty,
    identify,
    nu_gap_matrix,
)
from twinmatch.discrimination.certainty import DECIDED_FROM
from twinmatch.discrimination.models import ahead, deviations, operating_level
from twinmatch.dynamics import Parameters, begin, simulate_closed_loop
from twinmatch.identification import BoxJenkins, estimate
from twinmatch.plants import Peltier
from twinmatch.signals import FloatArray, Window

ORDER = "22221"
REFERENCE = np.repeat([30.0, 50.0, 70.0, 55.0], [40, 120, 140, 120])
MODEL = Peltier.model()
RIGS = (
    MODEL.parameters(seebeck=0.060, conductance=0.60, heat_capacity=28.0),
    MODEL.parameters(seebeck=0.050, conductance=0.50, heat_capacity=31.0),
    MODEL.parameters(seebeck=0.065, conductance=0.50, heat_capacity=22.0),
)


@cache
def truth() -> tuple[SimoModel, ...]:
    """Models such as the twin identifies, taken for the truth from here on."""
    return tuple(identify(seen(rig, seed), [ORDER])[0] for seed, rig in enumerate(RIGS))


def seen(rig: Parameters, seed: int) -> Window:
    sensor = Peltier.sensor.realise(len(REFERENCE), 1.0, seed)
    run = simulate_closed_loop(rig, REFERENCE, states=begin(rig, 30.0), sensor=sensor)
    return Window(REFERENCE, run.output, run.input)


def identified_again(rng: np.random.Generator) -> tuple[SimoModel, ...]:
    """Models of the same order estimated on data that the true ones generate, noise included."""
    window = seen(RIGS[0], 0)
    r = deviations(window, operating_level(window))[0]
    return tuple(SimoModel(ORDER, _again(m.y, r, rng), _again(m.u, ahead(r), rng)) for m in truth())


def _again(model: BoxJenkins, r: FloatArray, rng: np.random.Generator) -> BoxJenkins:
    white = rng.normal(0, np.sqrt(model.variance), r.size + 200)
    noise = lfilter(model.C, model.D, white)[200:]
    return estimate(r, lfilter(model.B, model.F, r) + noise, ORDER)


class Coverage(NamedTuple):
    gaps: float
    """Share of the true ν-gaps inside their intervals."""
    sums: float
    chosen: float
    """Mean probability that was given to the candidate with the smallest estimated sum."""
    right: float
    """Share of the families in which that candidate has the smallest true sum."""
    decided: float
    """Share of the families in which it was given 0.9 or more."""
    decided_right: float
    """Share of these in which it has the smallest true sum."""


def coverage(families: int, seed: int = 1) -> Coverage:
    rng = np.random.default_rng(seed)
    true = nu_gap_matrix([m.symbol for m in truth()])
    pairs = np.triu_indices(len(true), 1)
    gaps, sums, chosen, right = [], [], [], []
    for _ in range(families):
        models = identified_again(rng)
        found = nu_gap_matrix([m.symbol for m in models])
        known = family_uncertainty(models, found)
        gaps.append(((known.nu_gap_low <= true) & (true <= known.nu_gap_high))[pairs])
        total = true.sum(axis=0)
        sums.append((known.sum_low <= total) & (total <= known.sum_high))
        choice = int(np.argmin(found.sum(axis=0)))
        chosen.append(known.nominal_probability[choice])
        right.append(choice == np.argmin(total))
    sure = np.array(chosen) >= DECIDED_FROM
    sure_right = np.array(right)[sure] if sure.any() else [np.nan]
    return Coverage(*(float(np.mean(v)) for v in (gaps, sums, chosen, right, sure, sure_right)))


def test_nine_in_ten_intervals_hold_the_truth() -> None:
    """With 40 families and 3 gaps each the share itself is uncertain by 0.04 or so."""
    found = coverage(40)
    assert 0.80 <= found.gaps <= 0.99
    assert 0.80 <= found.sums <= 1.0
    # the probabilities mean what they say
    assert found.chosen == pytest.approx(found.right, abs=0.2)


def test_two_estimates_of_one_model_may_be_equal() -> None:
    """Their ν-gap is never found to be 0, but the interval says that it may be."""
    rng = np.random.default_rng(4)
    held = []
    for _ in range(25):
        models = (identified_again(rng)[0], identified_again(rng)[0])
        gaps = nu_gap_matrix([m.symbol for m in models])
        assert gaps[0, 1] > 0
        held.append(family_uncertainty(models, gaps).nu_gap_low[0, 1] == 0.0)
    assert np.mean(held) >= 0.75


def with_covariance(model: SimoModel, factor: float) -> SimoModel:
    parts = [replace(part, covariance=part.covariance * factor) for part in (model.y, model.u)]
    return SimoModel(model.order, *parts)


def family(factor: float = 1.0) -> tuple[list[SimoModel], FloatArray]:
    models = [with_covariance(m, factor) for m in truth()]
    return models, nu_gap_matrix([m.symbol for m in models])


def test_it_is_consistent_in_itself() -> None:
    models, gaps = family()
    known = family_uncertainty(models, gaps)
    for matrix in (known.nu_gap_low, known.nu_gap_high):
        np.testing.assert_array_equal(matrix, matrix.T)
        assert np.all(np.diag(matrix) == 0)
    assert np.all((known.nu_gap_low <= gaps) & (gaps <= known.nu_gap_high))
    assert np.all((known.sum_low <= gaps.sum(axis=0)) & (gaps.sum(axis=0) <= known.sum_high))
    # errors of different pairs do not all go the same way; ends near zero are coarse
    assert np.all(known.sum_low >= known.nu_gap_low.sum(axis=0) - 0.03)
    assert np.all(known.sum_high <= known.nu_gap_high.sum(axis=0) + 0.03)
    assert known.nominal_probability.sum() == pytest.approx(1.0)


def test_the_same_seed_gives_the_same_bits_and_another_nearly_the_same() -> None:
    models, gaps = family()
    first, again, other = (family_uncertainty(models, gaps, seed=s) for s in (5, 5, 6))
    np.testing.assert_array_equal(first.nu_gap_high, again.nu_gap_high)
    np.testing.assert_array_equal(first.nominal_probability, again.nominal_probability)
    assert not np.array_equal(first.nu_gap_high, other.nu_gap_high)
    np.testing.assert_allclose(first.nu_gap_high, other.nu_gap_high, rtol=0.25)


def test_the_width_goes_with_the_standard_errors() -> None:
    models, gaps = family()
    pair = np.triu_indices(3, 1)
    narrow, narrower = (family_uncertainty(family(f)[0], gaps) for f in (1e-2, 1e-4))
    widths = [(k.nu_gap_high - k.nu_gap_low)[pair] for k in (narrow, narrower)]
    np.testing.assert_allclose(widths[1], widths[0] / 10, rtol=0.2)
    sure = family_uncertainty([with_covariance(m, 0.0) for m in models], gaps)
    np.testing.assert_allclose(sure.nu_gap_low, gaps, rtol=5e-3)
    np.testing.assert_allclose(sure.nu_gap_high, gaps, rtol=5e-3)
    assert sure.nominal_probability[np.argmin(gaps.sum(axis=0))] == 1.0


def test_of_two_candidates_the_plant_decides() -> None:
    models, gaps = family(1e-2)
    two, apart = models[:2], gaps[:2, :2]
    assert family_uncertainty(two, apart).nominal_probability.tolist() == [0.5, 0.5]
    for k in (0, 1):
        known = family_uncertainty(two, apart, plant=truth()[k])
        assert known.nominal_probability[k] > 0.95


def test_one_candidate_is_certain() -> None:
    models, gaps = family()
    known = family_uncertainty(models[:1], gaps[:1, :1])
    assert known.nominal_probability.tolist() == [1.0]
    assert known.sum_low.tolist() == known.sum_high.tolist() == [0.0]


def test_a_failed_winding_condition_stays_at_one() -> None:
    """A lag of gain 2 against its negative: 1 + P2* P1 goes through zero where the gain is 1."""
    known_well = with_covariance(truth()[0], 1e-6)
    pole, small = np.array([1.0, -0.9, 0.0]), np.array([0.0, 0.01, 0.0])
    models = []
    for gain in (0.2, -0.2):
        y = replace(known_well.y, B=np.array([0.0, gain, 0.0]), F=pole)
        models.append(SimoModel(ORDER, y, replace(known_well.u, B=small, F=pole)))
    gaps = nu_gap_matrix([m.symbol for m in models])
    assert gaps[0, 1] == 1.0
    known = family_uncertainty(models, gaps)
    assert 0.9 < known.nu_gap_low[0, 1] <= known.nu_gap_high[0, 1] == 1.0
    assert np.all(known.sum_high == 1.0)


def test_what_cannot_be_judged_is_refused() -> None:
    models, gaps = family()
    with pytest.raises(DiscriminationError, match="give one model at least"):
        family_uncertainty([], np.zeros((0, 0)))
    with pytest.raises(DiscriminationError, match=r"3 models and ν-gaps of shape \(2, 2\)"):
        family_uncertainty(models, gaps[:2, :2])
    unknown = with_covariance(models[0], np.nan)
    with pytest.raises(DiscriminationError, match="has no covariance"):
        family_uncertainty([unknown, *models[1:]], gaps)


if __name__ == "__main__":
    print(coverage(int(sys.argv[1]) if len(sys.argv) > 1 else 200))
