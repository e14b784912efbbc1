"""Forecasts, and how they came true."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.comparing import TrustLevel
from twinmatch.forecasting import Band, Forecast
from twinmatch.twin.promises import Promise, Promises, promise_of, trust_level

KEPT = Promise(0.6, 0.9, 0.6, 0.9)
BROKEN = Promise(0.6, 0.9, 3.0, 0.1)
NOISE = 0.1


def forecast(mean: float, half: float, samples: int = 100) -> Forecast:
    band = Band(*(np.full(samples, v) for v in (mean, mean - half, mean + half)))
    return Forecast(
        sample=0,
        candidate="c",
        structure="s",
        confidence=0.9,
        time=np.arange(1.0, samples + 1),
        reference=np.zeros(samples),
        output=band,
        input=band,
    )


def test_errors_of_the_promised_size_leave_six_tenths_of_the_half_width() -> None:
    """A normal error has a standard deviation of 1/1.645 of the half width that holds 90 % of it."""
    errors = np.random.default_rng(3).normal(0.0, 2.0 / 1.6449, (2, 20_000))
    found = promise_of(forecast(50.0, 2.0, 20_000), 50.0 + errors[0], 50.0 + errors[1])
    assert found.miss_y == pytest.approx(0.608, abs=0.01)  # 20 000 draws: standard error 0.003
    assert found.inside_y == pytest.approx(0.9, abs=0.01)
    assert found.inside_u == pytest.approx(0.9, abs=0.01)


@given(st.floats(0.1, 10.0), st.floats(0.0, 5.0))
def test_a_miss_counts_in_half_widths(half: float, off: float) -> None:
    values = np.full(60, 20.0 + off * half)
    found = promise_of(forecast(20.0, half), values, values)
    assert found.miss_y == pytest.approx(off, abs=1e-9)
    assert found.miss == max(found.miss_y, found.miss_u)


def test_the_newest_samples_are_held_against_the_end_of_the_forecast() -> None:
    band = Band(np.arange(100.0), np.arange(100.0) - 1, np.arange(100.0) + 1)
    told = forecast(0.0, 1.0)
    told = Forecast(0, "c", "s", 0.9, told.time, told.reference, band, band)
    newest = np.arange(90.0, 100.0)
    assert promise_of(told, newest, newest) == Promise(0.0, 1.0, 0.0, 1.0)


def test_a_band_on_the_limit_of_the_controller_has_one_side() -> None:
    """Where the mean is the limit, what comes below is judged by the side that is there."""
    on_limit = Band(np.full(60, 255.0), np.full(60, 253.0), np.full(60, 255.0))
    told = Forecast(0, "c", "s", 0.9, np.arange(1.0, 61.0), np.zeros(60), on_limit, on_limit)
    found = promise_of(told, np.full(60, 255.0), np.full(60, 251.0))
    assert found.miss_y == 0.0
    assert found.miss_u == pytest.approx(2.0)


def test_since_when_and_between_which_levels() -> None:
    promises = Promises(2.0, NOISE)
    assert promises.held is None
    promises.push(KEPT, 0, np.array([30.0, 40.0]))
    promises.push(KEPT, 60, np.array([40.5, 50.0]))
    assert promises.held == (30.0, 50.0)
    assert promises.since is None
    promises.push(BROKEN, 120, np.array([50.0, 70.0]))
    promises.push(BROKEN, 180, np.array([70.0, 75.0]))
    assert promises.since == 120
    assert promises.held == (30.0, 50.0), "a level at which it failed is not one to trust it at"
    promises.push(KEPT, 240, np.array([80.0, 82.0]))
    assert promises.since is None
    assert promises.held == (80.0, 82.0), "what lies between was not seen to hold"
    promises.push(KEPT, 300, np.array([49.0, 80.5]))
    assert promises.held == (30.0, 82.0)


def test_the_level_says_whether_the_promise_was_kept() -> None:
    assert trust_level(KEPT, 2.0) is TrustLevel.TRUSTED
    assert trust_level(BROKEN, 2.0) is TrustLevel.DOUBTFUL
    assert trust_level(Promise(*[float("nan")] * 4), 2.0) is TrustLevel.UNKNOWN
