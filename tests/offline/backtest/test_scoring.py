"""Marks of one forecast: the interval score against others' and its defining property, errors by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.offline.backtest.forecasts import forecast_of
from twinmatch.offline.backtest.peer import BacktestError
from twinmatch.offline.backtest.scoring import interval_score, marks, samples_within
from twinmatch.plants import Peltier
from twinmatch.signals import Window

values = st.lists(st.floats(-1e3, 1e3).map(lambda x: round(x, 3)), min_size=1, max_size=40)
ends = st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)).map(sorted)
confidences = st.floats(0.05, 0.95)


def test_interval_score_by_hand() -> None:
    """Width 4; 1 below the band and 3 above it cost 2/0.2 = 10 times as much more."""
    score = interval_score(np.zeros(3), np.full(3, 4.0), np.array([2.0, -1.0, 7.0]), 0.8)
    np.testing.assert_allclose(score, [4.0, 14.0, 34.0], rtol=1e-12)


@given(ends, values, confidences)
def test_interval_score_is_that_of_scoringrules(
    interval: list[float], came: list[float], confidence: float
) -> None:
    others = pytest.importorskip("scoringrules", reason="needs scoringrules, which needs Python 3.11")
    x, (low, high) = np.array(came), (np.full(len(came), end) for end in interval)
    theirs = others.interval_score(x, low, high, 1.0 - confidence)
    np.testing.assert_allclose(interval_score(low, high, x, confidence), theirs, rtol=1e-9)


@given(values, ends, confidences)
def test_no_interval_costs_less_than_the_quantiles(
    came: list[float], interval: list[float], confidence: float
) -> None:
    """The rule is proper: a forecaster who knows the distribution does best by giving its quantiles."""
    x = np.array(came)
    tails = ((1.0 - confidence) / 2.0, (1.0 + confidence) / 2.0)
    low, high = np.quantile(x, tails, method="inverted_cdf")
    truth = interval_score(np.full(x.size, low), np.full(x.size, high), x, confidence).mean()
    other = interval_score(np.full(x.size, interval[0]), np.full(x.size, interval[1]), x, confidence).mean()
    assert truth <= other + 1e-9 * max(1.0, other)


@pytest.mark.parametrize("confidence", [0.0, 1.0, float("nan")])
def test_an_impossible_confidence_is_refused(confidence: float) -> None:
    with pytest.raises(BacktestError, match="must lie between 0 and 1"):
        interval_score(np.zeros(1), np.ones(1), np.zeros(1), confidence)


def test_marks_count_in_units_of_the_noise() -> None:
    """0.3 and 0.1 °C are 3 and 1 times the output's noise, 14 and 0 counts 2 and 0 times the input's."""
    forecast = forecast_of(9, [50.0, 50.0, 50.0], [20.0, 20.0, 20.0], half=(0.2, 7.0))
    came = Window([60.0] * 3, [50.3, 49.9, 80.0], [34.0, 20.0, 90.0], first=10)
    found = marks(forecast, came, 2.0, Peltier)
    assert found.output.rms == pytest.approx(np.sqrt(5.0))
    assert found.input.rms == pytest.approx(np.sqrt(2.0))
    assert found.error == pytest.approx(np.sqrt(3.5))
    assert (found.output.end, found.input.end) == pytest.approx((-1.0, 0.0))
    assert (found.output.coverage, found.input.coverage) == (0.5, 0.5)
    assert (found.output.width, found.input.width) == pytest.approx((4.0, 2.0))
    assert found.output.score == pytest.approx(4.0 + 20.0 * 1.0 / 2.0)
    assert found.score == pytest.approx((found.output.score + found.input.score) / 2.0)


@given(st.integers(1, 30), st.integers(0, 100))
def test_a_forecast_of_the_measurements_has_no_error(count: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    y, u = random.normal(50.0, 20.0, count), random.uniform(-255.0, 255.0, count)
    found = marks(forecast_of(0, y, u), Window(y, y, u, first=1), float(count), Peltier)
    assert found.error == found.output.end == found.input.end == 0.0
    assert found.output.coverage == found.input.coverage == 1.0


def test_samples_that_do_not_follow_the_forecast_are_refused() -> None:
    forecast = forecast_of(9, [50.0] * 5, [0.0] * 5)
    with pytest.raises(BacktestError, match="made at sample 9 cannot be scored from 12 on"):
        marks(forecast, Window([50.0] * 5, [50.0] * 5, [0.0] * 5, first=12), 5.0, Peltier)
    with pytest.raises(BacktestError, match="10 s needs 10 samples; only 5"):
        marks(forecast, Window([50.0] * 20, [50.0] * 20, [0.0] * 20, first=10), 10.0, Peltier)


def test_horizons_in_samples() -> None:
    assert samples_within(60.0, 1.0) == 60
    assert samples_within(60.0, 0.1) == 600
    assert samples_within(10.0, 3.0) == 3
    with pytest.raises(BacktestError, match="shorter than one sample of 3 s"):
        samples_within(2.0, 3.0)
