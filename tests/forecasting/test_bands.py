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


MEMORY = float(np.exp(-1 / 60))


@pytest.mark.parametrize("size", [0.1, 1.0, 4.0])
def test_scaled_by_past_errors_it_soon_holds(size: float) -> None:
    """300 twins whose errors are so many times what they expect, forecasts 20 to 60 of each.

    The share is known to 0.3 %; a prior that still counts costs up to 6 % (without scaling 10 %).
    """
    random = np.random.default_rng(4)
    inside, wide = [], []
    for _ in range(300):
        calibration = Calibration((1,), MEMORY, 1, 1)
        for k, quotient in enumerate(np.abs(size * random.normal(size=60))):
            if k >= 20:
                inside.append(quotient <= calibration.widths[0, 0])
            calibration.add(0, np.array([quotient]))
        wide.append(calibration.widths[0, 0] / size)
    assert 0.89 < np.mean(inside) < 0.97
    assert np.median(wide) == pytest.approx(norm.ppf(0.95), rel=0.2)


def test_unscaled_it_stays_wide_much_longer() -> None:
    """Errors are a tenth of what the twin expects: after 20 forecasts, and after 60."""
    quotients = np.abs(0.1 * np.random.default_rng(5).normal(size=60))
    plain, scaled = Calibration((1,), MEMORY, 1), Calibration((1,), MEMORY, 1, 1)
    for k, quotient in enumerate(quotients):
        plain.add(0, np.array([quotient]))
        scaled.add(0, np.array([quotient]))
        if k == 19:
            assert scaled.widths[0, 0] < 0.6
            assert plain.widths[0, 0] > 1.2
    assert scaled.widths[0, 0] < 0.25


@settings(deadline=None, max_examples=40)
@given(st.lists(st.floats(0.0, 100.0), max_size=60), st.sampled_from([1, 2, 20]))
def test_the_scale_is_a_mean_of_past_quotients_and_three_forecasts_as_expected(
    values: list[float], lead: int
) -> None:
    """With equal weights; of forecasts that reach over `lead` of their intervals each counts a `lead`-th."""
    calibration = Calibration((lead,), 1.0, 1, 1)
    for value in values:
        calibration.add(0, np.array([value]))
    weights = np.array([3.0, *[1.0 / lead] * len(values)])
    scale = np.average([norm.expect(abs), *values], weights=weights) / norm.expect(abs)
    prior = norm.ppf(0.5 + 0.5 * (np.arange(12) + 0.5) / 12) * scale
    everything = np.sort([*prior, *values])
    rank = min(int(np.ceil(CONFIDENCE * (everything.size + 1) - 1e-9)), everything.size)
    assert calibration.widths[0, 0] == pytest.approx(everything[rank - 1], rel=1e-9)


def test_a_copy_learns_on_its_own() -> None:
    first = Calibration((1,), MEMORY, 1, 1)
    for _ in range(500):  # until the prior is forgotten
        first.add(0, np.array([0.3]))
    second = first.copy()
    second.add(0, np.array([9.0]))
    assert first.widths[0, 0] == pytest.approx(0.3)
    for _ in range(30):
        second.add(0, np.array([9.0]))
        first.add(0, np.array([0.3]))
    assert second.widths[0, 0] == pytest.approx(9.0)
    assert first.widths[0, 0] == pytest.approx(0.3)


def test_leads_fit_the_sample_time() -> None:
    assert leads_of(1.0, 300) == (1, 3, 10, 30, 60, 120, 300)
    assert leads_of(3.0, 20) == (1, 3, 10, 20)
    assert leads_of(0.1, 50) == (10, 30, 50)
