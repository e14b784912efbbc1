"""The constant band of a twin whose residuals are known."""

from __future__ import annotations

import numpy as np
import pytest

from tests.offline.backtest.forecasts import forecast_of, set_points
from twinmatch.dynamics import begin, simulate_closed_loop
from twinmatch.offline.backtest.run import with_constant_band
from twinmatch.plants import Peltier
from twinmatch.signals import Window


def test_the_band_is_that_of_the_residuals_so_far() -> None:
    """Residuals with standard deviations of 0.5 °C and 4 counts: a band of ±1.645 times these at any horizon.

    2000 residuals tell a quantile to some percent.
    """
    rig = Peltier.model().parameters()
    reference = set_points(2000, 5)
    run = simulate_closed_loop(rig, reference, states=begin(rig, 25.0))
    random = np.random.default_rng(6)
    y = run.output + 0.5 * random.standard_normal(2000) * (np.arange(2000) > 5)
    u = run.input + 4.0 * random.standard_normal(2000) * (np.arange(2000) > 5)
    forecast = forecast_of(1999, np.full(300, 50.0), np.full(300, 253.0))
    made = with_constant_band(forecast, rig, Window(reference, y, u), Peltier.loop)
    np.testing.assert_array_equal(made.output.mean, np.full(300, 50.0))
    assert np.ptp(made.output.low) == np.ptp(made.output.high) == 0.0
    assert made.output.high[0] - 50.0 == pytest.approx(0.5 * 1.645, rel=0.1)
    assert made.output.low[0] - 50.0 == pytest.approx(-0.5 * 1.645, rel=0.1)
    assert made.input.low[0] - 253.0 == pytest.approx(-4.0 * 1.645, rel=0.1)
    assert made.input.high[0] == 255.0
