from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.comparing import (
    DiscriminationError,
    aic,
    bic,
    loss,
    mdl,
    mdl_as_printed,
    naic,
    naic_as_printed,
)


def test_published_example_of_another_program() -> None:
    """N = 300, six parameters, V = 1.6575: the figures MathWorks prints, to their last digit."""
    assert naic(1.6575, 6, 300) == pytest.approx(0.5453, abs=5e-5)
    assert aic(1.6575, 6, 300) == pytest.approx(1015.0, abs=0.05)
    assert bic(1.6575, 6, 300) == pytest.approx(1037.2, abs=0.05)


def test_printed_forms_are_printed_forms() -> None:
    assert naic_as_printed(2.0, 12, 300) == pytest.approx(300 * math.log(2) + 24 / 300)
    assert mdl_as_printed(2.0, 12, 300) == pytest.approx(2 * 1.04 * math.log(300))


def test_loss_is_the_determinant_of_the_covariance() -> None:
    rng = np.random.default_rng(3)
    errors = rng.normal(size=(50, 3)) @ rng.normal(size=(3, 3))
    assert loss(errors) == pytest.approx(float(np.linalg.det(errors.T @ errors / 50)), rel=1e-12)
    assert loss(errors[:, 0]) == pytest.approx(float(np.mean(errors[:, 0] ** 2)), rel=1e-14)
    assert loss(errors[:, [0, 0]]) == pytest.approx(0, abs=1e-28)
    assert loss(errors[:2]) == 0.0


def test_two_outputs_count_twice_in_the_constant_only() -> None:
    assert bic(0.5, 8, 100, n_outputs=2) - bic(0.5, 8, 100) == pytest.approx(100 * math.log(2 * math.pi))
    assert aic(0.5, 8, 100, n_outputs=2) - aic(0.5, 8, 100) == pytest.approx(100 * math.log(2 * math.pi))


def test_a_perfect_prediction_beats_any_penalty() -> None:
    assert naic(0.0, 30, 100) == -math.inf
    assert aic(0.0, 30, 100) == -math.inf
    assert bic(0.0, 30, 100) == -math.inf
    assert mdl(0.0, 30, 100) == 0.0


@given(st.floats(1e-6, 1e6), st.integers(0, 60), st.integers(8, 10_000))
def test_more_parameters_for_the_same_loss_never_help(v: float, n_p: int, n: int) -> None:
    for criterion in (naic, aic, bic, mdl):
        assert criterion(v, n_p + 1, n) > criterion(v, n_p, n)
        assert criterion(v * 1.01, n_p, n) > criterion(v, n_p, n)


@pytest.mark.parametrize("criterion", [naic, aic, bic, mdl, mdl_as_printed, naic_as_printed])
@pytest.mark.parametrize("bad", [-1e-9, math.nan, math.inf])
def test_an_impossible_loss_is_refused(criterion: object, bad: float) -> None:
    assert callable(criterion)
    with pytest.raises(DiscriminationError, match=f"the loss is {bad}"):
        criterion(bad, 3, 100)


def test_impossible_counts_are_refused() -> None:
    with pytest.raises(DiscriminationError, match="3 parameters and 0 samples"):
        naic(1.0, 3, 0)
    with pytest.raises(DiscriminationError, match="-1 parameters and 10 samples"):
        mdl(1.0, -1, 10)
    with pytest.raises(DiscriminationError, match="0 outputs"):
        bic(1.0, 3, 10, n_outputs=0)


def test_errors_that_give_no_loss_are_refused() -> None:
    with pytest.raises(DiscriminationError, match=r"shape \(0,\)"):
        loss([])
    with pytest.raises(DiscriminationError, match=r"shape \(2, 2, 2\)"):
        loss(np.zeros((2, 2, 2)))
    with pytest.raises(DiscriminationError, match="error at sample 1 is"):
        loss([1.0, math.nan])
