"""Residual tests: right models pass, wrong ones do not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from twinmatch.identification import IdentificationError, estimate, examine_residuals


def test_false_alarms_come_as_often_as_promised() -> None:
    white = independent = 0
    for seed in range(400):
        rng = np.random.default_rng(seed)
        test = examine_residuals(rng.standard_normal(500), rng.standard_normal(500))
        white += not test.white
        independent += not test.independent
    # Binomial(400, 0.01): mean 4, and 13 or more has a probability below 2e-4.
    assert white < 13
    assert independent < 13


def test_single_lags_stay_below_their_limits() -> None:
    rng = np.random.default_rng(0)
    tests = [examine_residuals(rng.standard_normal(800), rng.standard_normal(800)) for _ in range(100)]
    beyond = np.mean([np.abs(t.autocorrelation) > t.autocorrelation_limit for t in tests])
    assert 0.004 < beyond < 0.02  # one in a hundred of 2500
    beyond = np.mean([np.abs(t.cross_correlation) > t.cross_correlation_limit for t in tests])
    assert 0.004 < beyond < 0.02


def test_coloured_errors_are_found() -> None:
    rng = np.random.default_rng(1)
    e = lfilter([1.0], [1.0, -0.4], rng.standard_normal(600))
    assert not examine_residuals(e, rng.standard_normal(600)).white


def test_a_missed_input_is_found() -> None:
    rng = np.random.default_rng(2)
    u = rng.standard_normal(600)
    e = rng.standard_normal(600) + 0.4 * np.roll(u, 3)
    test = examine_residuals(e, u)
    assert not test.independent
    assert int(np.argmax(np.abs(test.cross_correlation))) == 3


def test_a_right_model_passes_and_a_poor_one_fails() -> None:
    rng = np.random.default_rng(3)
    u = rng.standard_normal(1000)
    y = lfilter([0, 1.0, 0.5], [1, -1.5, 0.7], u)
    y = y + lfilter([1, -0.5, 0.2], [1, -1.2, 0.5], 0.1 * rng.standard_normal(1000))
    right = estimate(u, y, "22221").examine(u, y)
    assert right.white
    assert right.independent
    assert not estimate(u, y, "10011").examine(u, y).white


def test_errors_of_zero_are_white() -> None:
    assert examine_residuals(np.zeros(100), np.arange(100.0)).white


def test_too_short() -> None:
    with pytest.raises(IdentificationError, match="25 lags need more than 51"):
        examine_residuals(np.zeros(40), np.zeros(40))
