"""Intervals of the ν-gap: what they promise, checked on families whose truth is known.

`python tests/comparing/test_uncertainty.py 200` repeats the check with 200 families.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from twinmatch.comparing import (
    Candidate,
    DiscriminationError,
    LoopConditions,
    plant_gaps,
    spans_of,
)
from twinmatch.comparing.certainty import DECIDED_FROM
from twinmatch.comparing.plant_gap import PlantGaps
from twinmatch.comparing.uncertainty import covariance_root, family_uncertainty
from twinmatch.dynamics import Parameters, begin, law_of, simulate_closed_loop
from twinmatch.fitting import match
from twinmatch.plants import Peltier
from twinmatch.signals import FloatArray, Window

MODEL = Peltier.model()
TERMS = LoopConditions(law_of(Peltier, 1.0), spans_of(Peltier))
POINTS = (30.0, 50.0, 70.0, 85.0)
RIGS = (
    MODEL.parameters(seebeck=0.060, conductance=0.60, heat_capacity=28.0),
    MODEL.parameters(seebeck=0.050, conductance=0.50, heat_capacity=31.0),
    MODEL.parameters(seebeck=0.065, conductance=0.50, heat_capacity=22.0),
)
STEPS = ((30.0, 50.0), (50.0, 70.0), (60.0, 85.0))


def matched(
    rig: Parameters, step: tuple[float, float], rng: np.random.Generator
) -> Candidate:
    """What a match makes of five minutes of a rig, seen through the camera; the next ones if it refuses."""
    while True:
        reference = np.repeat(step, [60, 240])
        sensor = Peltier.sensor.realise(reference.size, 1.0, int(rng.integers(10**9)))
        run = simulate_closed_loop(
            rig, reference, states=begin(rig, step[0]), sensor=sensor
        )
        a_match = match(
            Window(reference, run.output, run.input), start=MODEL.parameters()
        )
        if a_match.accepted:
            return Candidate(
                "", 0.0, a_match.parameters, None, *a_match.of_parameters()
            )


def apart(twins: Sequence[Candidate | Parameters]) -> PlantGaps:
    plain = [t.parameters if isinstance(t, Candidate) else t for t in twins]
    return plant_gaps(plain, POINTS, TERMS)


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


def coverage(rigs: Sequence[Parameters], families: int, seed: int = 1) -> Coverage:
    rng = np.random.default_rng(seed)
    true = apart(rigs).matrix
    pairs = np.triu_indices(len(true), 1)
    total = true.sum(axis=0)
    gaps = []
    sums = []
    chosen = []
    right = []
    for _ in range(families):
        twins = [matched(rig, step, rng) for rig, step in zip(rigs, STEPS, strict=True)]
        twin_gaps = apart(twins)
        uncertainty = family_uncertainty(twins, twin_gaps, TERMS)
        gaps.append(
            ((uncertainty.nu_gap_low <= true) & (true <= uncertainty.nu_gap_high))[
                pairs
            ]
        )
        sums.append((uncertainty.sum_low <= total) & (total <= uncertainty.sum_high))
        choice = int(np.argmin(twin_gaps.matrix.sum(axis=0)))
        chosen.append(uncertainty.nominal_probability[choice])
        right.append(choice == np.argmin(total))
    sure = np.array(chosen) >= DECIDED_FROM
    sure_right = np.array(right)[sure] if sure.any() else [np.nan]
    return Coverage(
        *(float(np.mean(v)) for v in (gaps, sums, chosen, right, sure, sure_right))
    )


def test_nine_in_ten_intervals_hold_the_truth() -> None:
    """With 12 families and 3 gaps each the share itself is uncertain by 0.06 or so."""
    shares = coverage(RIGS, 12)
    assert 0.8 <= shares.gaps <= 1.0
    assert 0.8 <= shares.sums <= 1.0
    # these rigs differ by more than what a match leaves open
    assert shares.right == 1.0
    assert shares.chosen > 0.9


def test_matches_of_one_rig_may_be_equal_and_decide_nothing() -> None:
    """Their ν-gap is never found to be 0, but the intervals say that it may be."""
    shares = coverage([RIGS[0]] * 3, 8, seed=2)
    assert shares.gaps >= 0.8
    assert shares.decided <= 0.3


@cache
def estimates() -> tuple[Candidate, ...]:
    rng = np.random.default_rng(8)
    return tuple(matched(rig, step, rng) for rig, step in zip(RIGS, STEPS, strict=True))


def family(factor: float = 1.0) -> tuple[list[Candidate], PlantGaps]:
    twins = [replace(t, covariance=t.covariance * factor) for t in estimates()]
    return twins, apart(twins)


def test_it_is_consistent_in_itself() -> None:
    twins, twin_gaps = family()
    gaps = twin_gaps.matrix
    uncertainty = family_uncertainty(twins, twin_gaps, TERMS)
    for matrix in (uncertainty.nu_gap_low, uncertainty.nu_gap_high):
        np.testing.assert_array_equal(matrix, matrix.T)
        assert np.all(np.diag(matrix) == 0)
    assert np.all((uncertainty.nu_gap_low <= gaps) & (gaps <= uncertainty.nu_gap_high))
    assert np.all(
        (uncertainty.sum_low <= gaps.sum(axis=0))
        & (gaps.sum(axis=0) <= uncertainty.sum_high)
    )
    # errors of different pairs do not all go the same way; ends near zero are coarse
    assert np.all(uncertainty.sum_low >= uncertainty.nu_gap_low.sum(axis=0) - 0.03)
    assert np.all(uncertainty.sum_high <= uncertainty.nu_gap_high.sum(axis=0) + 0.03)
    assert uncertainty.nominal_probability.sum() == pytest.approx(1.0)


def test_the_same_seed_gives_the_same_bits_and_another_nearly_the_same() -> None:
    twins, gaps = family()
    first, repeated, another_seed = (
        family_uncertainty(twins, gaps, TERMS, seed=s) for s in (5, 5, 6)
    )
    np.testing.assert_array_equal(first.nu_gap_high, repeated.nu_gap_high)
    np.testing.assert_array_equal(
        first.nominal_probability, repeated.nominal_probability
    )
    assert not np.array_equal(first.nu_gap_high, another_seed.nu_gap_high)
    np.testing.assert_allclose(first.nu_gap_high, another_seed.nu_gap_high, rtol=0.25)


def test_the_width_goes_with_the_standard_errors() -> None:
    pair = np.triu_indices(3, 1)
    uncertainties = [family_uncertainty(*family(f), TERMS) for f in (1e-2, 1e-4)]
    widths = [(k.nu_gap_high - k.nu_gap_low)[pair] for k in uncertainties]
    np.testing.assert_allclose(widths[1], widths[0] / 10, rtol=0.2)


@pytest.mark.parametrize("covariance", [np.empty((0, 0)), np.zeros((3, 3))])
def test_what_is_exact_has_no_interval(covariance: FloatArray) -> None:
    """Candidates that were given have no covariance."""
    twins = [replace(t, covariance=covariance) for t in estimates()]
    twin_gaps = apart(twins)
    uncertainty = family_uncertainty(twins, twin_gaps, TERMS)
    np.testing.assert_array_equal(uncertainty.nu_gap_low, twin_gaps.matrix)
    np.testing.assert_array_equal(uncertainty.nu_gap_high, twin_gaps.matrix)
    assert (
        uncertainty.nominal_probability[np.argmin(twin_gaps.matrix.sum(axis=0))] == 1.0
    )


def test_what_nothing_tells_is_as_uncertain_as_its_scale() -> None:
    """A match that sees no end of a combination has an infinite covariance."""
    twins, twin_gaps = family()
    huge = [replace(t, covariance=t.covariance * 1e12) for t in twins]
    endless = [replace(t, covariance=np.full((3, 3), np.inf)) for t in twins]
    for loose in (huge, endless):
        uncertainty = family_uncertainty(loose, twin_gaps, TERMS)
        assert np.isfinite(uncertainty.nu_gap_high).all()
        assert uncertainty.nominal_probability.max() < DECIDED_FROM
    scales = [
        p.scale for name, p in MODEL.declared.items() if name in MODEL.structure.free
    ]
    np.testing.assert_array_equal(covariance_root(endless[0]), np.diag(scales))


def test_of_two_candidates_the_plant_decides() -> None:
    twins, _ = family(1e-2)
    two = twins[:2]
    assert family_uncertainty(two, apart(two), TERMS).nominal_probability.tolist() == [
        0.5,
        0.5,
    ]
    for k in (0, 1):
        uncertainty = family_uncertainty(two, apart(two), TERMS, plant=RIGS[k])
        assert uncertainty.nominal_probability[k] > 0.95


def test_one_candidate_is_certain() -> None:
    twins, _ = family()
    uncertainty = family_uncertainty(twins[:1], apart(twins[:1]), TERMS)
    assert uncertainty.nominal_probability.tolist() == [1.0]
    assert uncertainty.sum_low.tolist() == uncertainty.sum_high.tolist() == [0.0]


def test_twins_without_a_common_point_stay_as_far_apart_as_can_be() -> None:
    twins, _ = family()
    nowhere = plant_gaps([t.parameters for t in twins], [], TERMS)
    uncertainty = family_uncertainty(twins, nowhere, TERMS)
    np.testing.assert_array_equal(uncertainty.nu_gap_low, 1.0 - np.eye(3))
    np.testing.assert_array_equal(uncertainty.nu_gap_high, 1.0 - np.eye(3))


def test_what_cannot_be_judged_is_refused() -> None:
    twins, gaps = family()
    with pytest.raises(DiscriminationError, match="give at least one"):
        family_uncertainty([], plant_gaps([], POINTS, TERMS), TERMS)
    with pytest.raises(
        DiscriminationError, match=r"2 twins and ν-gaps of shape \(4, 3, 3\)"
    ):
        family_uncertainty(twins[:2], gaps, TERMS)
    for wrong in (np.full((3, 3), np.nan), np.eye(2)):
        with pytest.raises(
            DiscriminationError,
            match=r"a covariance of shape \(\d, \d\) for 3 parameters",
        ):
            family_uncertainty(
                [replace(twins[0], covariance=wrong), *twins[1:]], gaps, TERMS
            )


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    near = [
        RIGS[0],
        RIGS[0].replace(seebeck=0.058),
        RIGS[0].replace(conductance=0.55, heat_capacity=27.0),
    ]
    for rigs in (list(RIGS), near, [RIGS[0]] * 3):
        print(apart(rigs).matrix[np.triu_indices(3, 1)].round(3), coverage(rigs, count))
