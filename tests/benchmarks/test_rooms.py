"""The benchmark of rooms runs, and its plant file says what the simulated rooms are."""

from __future__ import annotations

import numpy as np

from benchmarks.rooms import FREE, HORIZONS, PERIOD, forecasts
from tests.support.rooms import StoredRoom, recorded_room


def test_an_exact_room_is_forecast_to_its_noise() -> None:
    """Four days of a heated floor. The noise of a reading is 0.05 K; what the fits leave is less."""
    scored = forecasts(StoredRoom, recorded_room(0, 2, PERIOD).part(0, 4 * 144))
    errors = np.array(scored.errors)
    assert errors.shape == np.shape(scored.arx) == np.shape(scored.held) == (len(errors), len(HORIZONS))
    assert len(errors) > 10
    assert np.sqrt(np.mean(errors**2, axis=0)).max() < 0.1


def test_free_heat_may_be_none_at_all() -> None:
    """A match of a parameter whose bounds reach below zero, and whose interval does, has a result."""
    assert not StoredRoom.model().declared["free"].relative
    assert forecasts(StoredRoom, recorded_room(0, 1, PERIOD, FREE).part(0, 3 * 144)).errors
