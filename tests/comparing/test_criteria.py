from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.comparing import DiscriminationError, bic, mdl, naic


def test_published_example_of_another_program() -> None:
    """N = 300, six parameters, V = 1.6575: the figures MathWorks prints, to their last digit."""
    assert naic(1.6575, 6, 300) == pytest.approx(0.5453, abs=5e-5)
    assert bic(1.6575, 6, 300) == pytest.approx(1037.2, abs=0.05)


def test_a_perfect_prediction_beats_any_penalty() -> None:
    assert naic(0.0, 30, 100) == -math.inf
    assert bic(0.0, 30, 100) == -math.inf
    assert mdl(0.0, 30, 100) == 0.0


@given(st.floats(1e-6, 1e6), st.integers(0, 60), st.integers(8, 10_000))
def test_more_parameters_for_the_same_loss_never_help(v: float, n_p: int, n: int) -> None:
    for criterion in (naic, bic, mdl):
        assert criterion(v, n_p + 1, n) > criterion(v, n_p, n)
        assert criterion(v * 1.01, n_p, n) > criterion(v, n_p, n)


@pytest.mark.parametrize("criterion", [naic, bic, mdl])
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
