"""The gate, asked question by question."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.fitting import FittingError, GateLimits, Status
from twinmatch.fitting.gate import FitEvidence, first_excited, judge
from twinmatch.fitting.problem import Unknown, unknown_parameters
from twinmatch.plants import Peltier


def unknown(*names: str) -> tuple[Unknown, ...]:
    return unknown_parameters(Peltier.model(), names)


GOOD = FitEvidence(
    free=unknown("seebeck", "conductance", "heat_capacity"),
    values=np.array([0.075, 0.6, 30.0]),
    standard_errors=np.array([0.005, 0.03, 2.0]),
    condition=30.0,
    bounds_hit=(),
    converged=True,
    chi2=1.2,
    held_back_chi2=1.0,
    incumbent_chi2=1.5,
)

FLAWS = {
    Status.NOT_EXPLAINED: {"chi2": 130.0},
    Status.DID_NOT_CONVERGE: {"converged": False},
    Status.BOUNDS_HIT: {"bounds_hit": ("seebeck",)},
    Status.NOT_IDENTIFIABLE: {"condition": 1e5},
    Status.NOT_BETTER: {"held_back_chi2": 1.7},
}


def test_good_evidence_is_accepted() -> None:
    status, reason = judge(GOOD, GateLimits())
    assert status is Status.ACCEPTED
    assert "1.2 times the noise variance" in reason


@pytest.mark.parametrize(
    ("flaw", "status", "reason"),
    [
        ({"chi2": 41.0}, Status.NOT_EXPLAINED, "even the best fit leaves residuals of 41 times"),
        ({"chi2": float("nan")}, Status.NOT_EXPLAINED, "even the best fit leaves residuals of nan"),
        ({"converged": False}, Status.DID_NOT_CONVERGE, "did not converge within"),
        (
            {"bounds_hit": ("seebeck",), "values": np.array([0.2, 0.6, 30.0])},
            Status.BOUNDS_HIT,
            "seebeck ended on its bound at 0.2",
        ),
        ({"condition": 1001.0}, Status.NOT_IDENTIFIABLE, "condition number 1e+03 is above 1000"),
        ({"condition": float("inf")}, Status.NOT_IDENTIFIABLE, "condition number inf"),
        (
            {"standard_errors": np.array([0.005, 0.4, 2.0])},
            Status.NOT_IDENTIFIABLE,
            "conductance is 0.6 ± 0.4: this window does not determine it",
        ),
        (
            {"standard_errors": np.array([np.inf, 0.1, 2.0])},
            Status.NOT_IDENTIFIABLE,
            "seebeck is 0.075 ± inf",
        ),
        ({"held_back_chi2": 1.7}, Status.NOT_BETTER, "residuals are 1.7 times"),
        ({"held_back_chi2": float("nan")}, Status.NOT_BETTER, "residuals are nan times"),
    ],
)
def test_each_flaw_has_its_status(flaw: dict[str, object], status: Status, reason: str) -> None:
    found, sentence = judge(replace(GOOD, **flaw), GateLimits())
    assert found is status
    assert reason in sentence


def test_the_first_flaw_in_order_names_the_status() -> None:
    order = list(FLAWS)
    for i, status in enumerate(order):
        flaws = {name: value for later in order[i:] for name, value in FLAWS[later].items()}
        assert judge(replace(GOOD, **flaws), GateLimits())[0] is status


def test_chance_may_make_the_held_back_part_a_little_worse() -> None:
    assert judge(replace(GOOD, held_back_chi2=1.64), GateLimits())[0] is Status.ACCEPTED
    assert judge(replace(GOOD, held_back_chi2=1.64), GateLimits(slack=1.0))[0] is Status.NOT_BETTER


def test_a_temperature_is_not_measured_by_its_distance_from_absolute_zero() -> None:
    ambient = replace(
        GOOD, free=unknown("seebeck", "conductance", "ambient"), values=np.array([0.075, 0.6, 296.0])
    )
    loose = replace(ambient, standard_errors=np.array([0.005, 0.03, 6.0]))
    assert (
        judge(replace(ambient, standard_errors=np.array([0.005, 0.03, 4.0])), GateLimits())[0]
        is Status.ACCEPTED
    )
    assert judge(loose, GateLimits())[0] is Status.NOT_IDENTIFIABLE


def test_what_was_kept_is_said_and_not_asked_for_its_error() -> None:
    two = replace(
        GOOD,
        free=unknown("seebeck", "heat_capacity"),
        values=np.array([0.13, 60.0]),
        standard_errors=np.array([0.01, 3.0]),
        kept="conductance at 0.35 (possible: 0 to 0.4)",
    )
    status, reason = judge(two, GateLimits())
    assert status is Status.ACCEPTED
    assert reason.endswith("not determined and kept: conductance at 0.35 (possible: 0 to 0.4)")
    assert judge(replace(two, bounds_hit=("seebeck",)), GateLimits())[0] is Status.BOUNDS_HIT
    loose = replace(two, standard_errors=np.array([0.01, 40.0]))
    assert judge(loose, GateLimits())[0] is Status.NOT_IDENTIFIABLE


@given(
    chi2=st.floats(0.0, 1e6),
    condition=st.floats(1.0, 1e9),
    errors=st.lists(st.floats(0.0, 100.0), min_size=3, max_size=3),
    held=st.floats(0.0, 100.0),
    stands=st.floats(0.0, 100.0),
)
def test_only_what_passes_every_limit_is_accepted(
    chi2: float, condition: float, errors: list[float], held: float, stands: float
) -> None:
    evidence = replace(
        GOOD,
        chi2=chi2,
        condition=condition,
        standard_errors=np.array(errors),
        held_back_chi2=held,
        incumbent_chi2=stands,
    )
    passes = (
        chi2 <= 40.0
        and condition <= 1000.0
        and bool(np.all(np.array(errors) <= 0.5 * GOOD.values))
        and held <= 1.1 * stands
    )
    assert (judge(evidence, GateLimits())[0] is Status.ACCEPTED) == passes


def excited(reference: list[float]) -> int | None:
    return first_excited(np.array(reference), 2.0)


def test_excitation_is_a_movement_of_the_set_point() -> None:
    assert excited([30.0, 30.0, 30.0, 32.0, 32.0]) == 3
    assert excited([30.0, 30.0, 31.0, 30.5, 29.0]) == 4
    assert excited([30.0, 30.5, 31.0, 31.5, 32.0, 32.5, 33.0]) == 5  # a ramp excites as well
    assert excited([30.0, 40.0, 40.0, 40.0]) is None  # stepped before the twin starts
    assert excited([30.0, 31.9, 30.0]) is None
    assert excited([30.0]) is None


def test_limits_have_a_meaning() -> None:
    with pytest.raises(FittingError, match="the limit condition is 0; it must be positive"):
        GateLimits(condition=0)
    with pytest.raises(FittingError, match=r"held_back is 1\.0; give a share of the window"):
        GateLimits(held_back=1.0)


def test_status_values_are_words() -> None:
    assert {status.value for status in Status} == {status.name.lower() for status in Status}
