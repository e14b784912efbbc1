"""The benchmark of rooms runs, and its plant file says what the simulated rooms are."""

from __future__ import annotations

import numpy as np

from benchmarks.rooms import HORIZONS, PERIOD, forecasts
from tests.support.rooms import StoredRoom, recorded_room


def test_a_room_is_forecast_hours_ahead() -> None:
    """One store, for two days and a half, without free heat: a parameter whose bounds reach below zero.

    The noise of a reading is 0.05 K; the most that the fits of two days may add is as much again.
    """
    assert not StoredRoom.model().declared["free"].relative
    scored = forecasts(StoredRoom, recorded_room(1, 1, PERIOD).part(0, 360))
    errors = np.array(scored.errors)
    assert (
        errors.shape
        == np.shape(scored.arx)
        == np.shape(scored.held)
        == (3, len(HORIZONS))
    )
    assert np.sqrt(np.mean(errors**2, axis=0)).max() < 0.1
