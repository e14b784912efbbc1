"""How wide a band has to be to hold what it promises."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from twinmatch.forecasting import CONFIDENCE, Calibration, leads_of
from twinmatch.signals import FloatArray


def learned(quotients: FloatArray, kept: float = 1.0) -> tuple[Calibration, FloatArray]:
    """A calibration after quotients, shape (n, 2), and whether each lay within the width before it."""
    calibration, inside = Calibration((1,), kept), []
    for row in quotients:
        inside.append(row <= calibration.widths[:, 0])
        calibration.add(0, row)
    return calibration, np.array(inside)


def test_it_begins_as_a_normal_distribution_would_have_it() -> None:
    """Of twelve points of |z| the greatest is taken, ⌈0.9·13⌉ being twelve: its level is 23/24."""
    expected = norm.ppf(0.5 + 0.5 * 23 / 24)
    assert Calibration((1, 10), 1.0).widths == pytest.approx(np.full((2, 2), expected), rel=1e-12)


@pytest.mark.parametrize("of", ["normal", "laplace", "narrow", "wide"])
def test_it_holds_what_it_promises_whatever_the_errors_are_like(of: str) -> None:
    """In 3000 draws the share within has a standard error of 0.005; what is learned first costs some more."""
    random = np.random.default_rng(7)
    draws = {
        "normal": random.normal(size=(3000, 2)),
        "laplace": random.laplace(size=(3000, 2)),
        "narrow": 0.1 * random.normal(size=(3000, 2)),
        "wide": 7.0 * random.standard_t(3, size=(3000, 2)),
    }[of]
    _, inside = learned(np.abs(draws), kept=0.99)
    assert inside.mean(axis=0) == pytest.approx([CONFIDENCE, CONFIDENCE], abs=0.025)


def test_it_follows_errors_that_grow() -> None:
    random = np.random.default_rng(8)
    sizes = np.abs(random.normal(size=(600, 2))) * np.repeat([1.0, 3.0], 300)[:, None]
    _, inside = learned(sizes, kept=float(np.exp(-1 / 60)))
    assert inside[300:330].mean() < 0.75, "this test has to see the change"
    assert inside[400:].mean() == pytest.approx(CONFIDENCE, abs=0.04)  # 400 draws: standard error 0.015


@settings(deadline=None, max_examples=40)
@given(st.lists(st.floats(0.0, 100.0), min_size=200, max_size=260))
def test_with_equal_weights_it_is_the_empirical_quantile(values: list[float]) -> None:
    """The one that leaves room for the next: rank ⌈0.9·(n + 1)⌉, an independent formula (Vovk et al.)."""
    calibration, _ = learned(np.repeat(np.array(values)[:, None], 2, axis=1))
    start = Calibration((1,), 1.0)._quotients[0][:, 0]
    everything = np.sort(np.append(start, values))
    rank = int(np.ceil(CONFIDENCE * (everything.size + 1) - 1e-9))
    assert calibration.widths[0, 0] == everything[rank - 1]


def test_leads_fit_the_sample_time() -> None:
    assert leads_of(1.0, 300) == (1, 3, 10, 30, 60, 120, 300)
    assert leads_of(3.0, 20) == (1, 3, 10, 20)
    assert leads_of(0.1, 50) == (10, 30, 50)
