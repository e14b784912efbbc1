"""How wide a band has to be to hold what it promises."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from twinmatch.forecasting import (
    CONFIDENCE,
    Calibration,
    leads_of,
)
from twinmatch.signals import FloatArray

MEAN = float(norm.expect(abs))
MEMORY = float(np.exp(-1 / 60))
RECENT = float(np.exp(-1 / 10))


def learned(
    quotients: FloatArray, forgetting: float = MEMORY, recent: float = RECENT
) -> tuple[FloatArray, FloatArray]:
    """The widths before each of the quotients, shape (n, signals), and whether it lay within."""
    calibration = Calibration((1,), forgetting, recent, quotients.shape[1])
    widths = []
    for row in quotients:
        widths.append(calibration.widths[:, 0])
        calibration.add([0], row[:, None])
    return np.array(widths), quotients <= np.array(widths)


def test_it_begins_as_a_normal_distribution_would_have_it() -> None:
    """Of twelve points of |z| the greatest is taken, ⌈0.9·13⌉ being twelve: its level is 12/13."""
    expected = norm.ppf(0.5 + 0.5 * 12 / 13)
    assert Calibration((1, 10), 1.0, 1.0).widths == pytest.approx(
        np.full((2, 2), expected), rel=1e-12
    )


@pytest.mark.parametrize("kind", ["normal", "laplace", "narrow", "wide"])
def test_it_holds_what_it_promises_whatever_the_errors_are_like(kind: str) -> None:
    """In 1000 draws the share within has a standard error of 0.01; what is learned first costs some more."""
    random = np.random.default_rng(7)
    draws = {
        "normal": random.normal(size=(1000, 2)),
        "laplace": random.laplace(size=(1000, 2)),
        "narrow": 0.1 * random.normal(size=(1000, 2)),
        "wide": 7.0 * random.standard_t(3, size=(1000, 2)),
    }[kind]
    _, inside = learned(np.abs(draws), forgetting=0.99)
    assert inside.mean(axis=0) == pytest.approx([CONFIDENCE, CONFIDENCE], abs=0.025)


def test_it_follows_errors_that_grow() -> None:
    """They are three times as large from the 200th of 240 forecasts on, in 50 signals: the share of a
    thousand readings has a standard error of 0.01."""
    sizes = np.abs(np.random.default_rng(8).normal(size=(240, 50)))
    sizes[200:] *= 3.0
    _, inside = learned(sizes)
    assert inside[200:210].mean() < 0.75, "this test has to see the change"
    assert inside[220:240].mean() == pytest.approx(CONFIDENCE, abs=0.02)
    _, slow = learned(sizes, recent=MEMORY)
    assert slow[210:240].mean() < inside[210:240].mean() - 0.05


def test_it_holds_while_the_noise_drifts() -> None:
    """Noise that grows to four times and falls again within 120 forecasts, an hour: the share held in the
    worst twenty minutes, and the interval score over that of the true quantile, with a local scale and with
    one that is as slow as the quantile."""
    sizes = np.exp(np.log(2.0) * np.sin(2.0 * np.pi * np.arange(480) / 120.0))[:, None]
    drawn = np.abs(sizes * np.random.default_rng(9).normal(size=(480, 40)))

    def scored(widths: FloatArray) -> float:
        return float(np.mean(2.0 * widths + 20.0 * np.maximum(drawn - widths, 0.0)))

    def share_and_loss(recent: float) -> tuple[float, float]:
        widths, inside = learned(drawn, recent=recent)
        rolling = np.convolve(inside[60:].mean(axis=1), np.full(40, 1 / 40), "valid")
        return rolling.min(), scored(widths) / scored(norm.ppf(0.95) * sizes) - 1.0

    worst, lost = share_and_loss(RECENT)
    worst_without, lost_without = share_and_loss(MEMORY)
    assert worst > max(0.8, worst_without + 0.04)
    assert lost < min(0.13, lost_without - 0.1)


def test_a_long_lead_begins_with_what_the_shorter_one_has_shown() -> None:
    calibration = Calibration((1, 10), 1.0, 1.0, 1)
    for _ in range(997):
        calibration.add([0], np.array([[3.0]]))
    # The mean of 997 quotients of 3, and of three as expected, in units of the mean of |z|.
    scale = (997 * 3.0 / norm.expect(abs) + 3.0) / 1000
    assert calibration.widths[0, 1] == pytest.approx(
        norm.ppf(0.5 + 0.5 * 12 / 13) * scale, rel=1e-9
    )


@settings(deadline=None, max_examples=40)
@given(st.lists(st.floats(0.0, 100.0), max_size=120), st.sampled_from([1, 2, 20]))
def test_it_is_the_empirical_quantile_in_units_of_a_mean(
    values: list[float], lead: int
) -> None:
    """With equal weights, by independent formulas. The scale is the mean of the past quotients and of three
    forecasts as expected, where of forecasts that reach over `lead` of their intervals each counts a
    `lead`-th; the quantile leaves room for the next, which overlaps: rank ⌈0.9·(n + √`lead`)⌉ (with 1 for the
    root: Vovk et al.)."""
    calibration = Calibration((lead,), 1.0, 1.0, 1)
    scaled = norm.ppf(0.5 + 0.5 * np.arange(1, 13) / 13).tolist()
    for n, value in enumerate([*values, 0.0]):
        weights = np.array([3.0, *[1.0 / lead] * n])
        scale = np.average([MEAN, *values[:n]], weights=weights) / MEAN
        rank = min(
            int(np.ceil(CONFIDENCE * (len(scaled) + math.sqrt(lead)) - 1e-9)),
            len(scaled),
        )
        assert calibration.widths[0, 0] == pytest.approx(
            np.sort(scaled)[rank - 1] * scale, rel=1e-9
        )
        calibration.add([0], np.array([[value]]))
        scaled.append(value / scale)


@pytest.mark.parametrize("size", [0.1, 1.0, 4.0])
def test_a_twin_that_misjudges_its_errors_soon_holds(size: float) -> None:
    """300 twins whose errors are so many times what they expect, forecasts 20 to 60 of each.

    The share is known to 0.3 %; a prior that still counts costs up to 8 % (without a scale 10 %).
    """
    widths, inside = learned(
        np.abs(size * np.random.default_rng(4).normal(size=(60, 300)))
    )
    assert 0.88 < inside[20:].mean() < 0.985
    assert np.median(widths[-1]) / size == pytest.approx(norm.ppf(0.95), rel=0.3)


def test_a_copy_learns_on_its_own() -> None:
    first = Calibration((1,), MEMORY, RECENT, 1)
    for _ in range(500):  # until the prior is forgotten
        first.add([0], np.array([[0.3]]))
    second = first.copy()
    before = first.widths
    for _ in range(30):
        second.add([0], np.array([[9.0]]))
    np.testing.assert_array_equal(first.widths, before)
    assert second.widths[0, 0] > 9.0


def test_leads_fit_the_sample_time() -> None:
    assert leads_of(1.0, 300) == (1, 3, 10, 30, 60, 120, 300)
    assert leads_of(3.0, 20) == (1, 3, 10, 20)
    assert leads_of(0.1, 50) == (10, 30, 50)
