"""Peers that are given the inputs that came, on plants whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.support.plants import Box, Lag
from twinmatch.offline.backtest.arx import InputArx
from twinmatch.offline.backtest.peers import OutputPersistence, peers
from twinmatch.offline.backtest.scoring import Marked, cards, marks
from twinmatch.signals import FloatArray, Window


def second_order(size: int, noise: float, seed: int) -> tuple[FloatArray, FloatArray]:
    """y[k] = 1.6 y[k−1] − 0.64 y[k−2] + 0.05 u[k−1] + 0.03 u[k−2] + e[k], by somebody else's filter."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-5.0, 5.0, -(-size // 40)), 40)[:size]
    a = [1.0, -1.6, 0.64]
    y = lfilter([0.0, 0.05, 0.03], a, u) + lfilter([1.0], a, noise * rng.standard_normal(size))
    return u, np.asarray(y, dtype=np.float64)


def test_without_noise_least_squares_forecast_exactly() -> None:
    u, y = second_order(400, 0.0, 1)
    past = Window(np.zeros(300), y[:300], u[:300])
    forecast = InputArx(Lag).forecast(past, u[300:])
    np.testing.assert_allclose(forecast.output.mean, y[300:], atol=1e-3)
    np.testing.assert_array_equal(forecast.input.mean, u[300:])
    assert np.isnan(forecast.reference).all()


def test_what_else_was_measured_is_taken_into_account() -> None:
    """A room that moves the output: without noise the forecast is exact, given the room that came.

    If the room is assumed to stay, or was not measured, errors are about as large as what the room does.
    """
    rng = np.random.default_rng(5)
    u, y = second_order(400, 0.0, 1)
    room = 21.0 + np.cumsum(rng.normal(0.0, 0.05, 400))
    room[300:] += 2.0
    y = y + lfilter([0.0, 0.02], [1.0, -0.9], room - 21.0)
    past = Window(np.zeros(300), y[:300], u[:300], disturbances=room[:300, None])
    told = InputArx(Lag).forecast(past, u[300:], room[300:, None])
    np.testing.assert_allclose(told.output.mean, y[300:], atol=2e-3)
    untold = InputArx(Lag).forecast(past, u[300:])  # the room stays: as good until it jumps
    assert abs(untold.output.mean[0] - y[300]) < 2e-3
    assert np.abs(untold.output.mean - y[300:]).max() > 0.2
    blind = InputArx(Lag).forecast(Window(np.zeros(300), y[:300], u[:300]), u[300:])
    assert np.abs(blind.output.mean - y[300:]).max() > 0.2


def test_a_room_that_never_moved_changes_nothing() -> None:
    u, y = second_order(400, 0.05, 2)
    with_room = Window(np.zeros(300), y[:300], u[:300], disturbances=np.full((300, 1), 21.1))
    forecast = InputArx(Lag).forecast(with_room, u[300:], np.full((100, 1), 21.1))
    same = InputArx(Lag).forecast(Window(np.zeros(300), y[:300], u[:300]), u[300:])
    np.testing.assert_array_equal(forecast.output.mean, same.output.mean)
    np.testing.assert_array_equal(forecast.output.high, same.output.high)


def test_the_band_holds_nine_in_ten() -> None:
    """Of 40 sessions, 60 samples ahead; errors last, so that the share is known to some per cent."""
    held = []
    for seed in range(40):
        u, y = second_order(560, 0.05, seed)
        forecast = InputArx(Lag).forecast(Window(np.zeros(500), y[:500], u[:500]), u[500:])
        held.append(np.mean((forecast.output.low <= y[500:]) & (y[500:] <= forecast.output.high)))
    assert np.mean(held) == pytest.approx(0.9, abs=0.06)


def test_they_are_those_that_are_asked_and_nothing_is_said_of_the_input() -> None:
    found, absent = peers(Box, driven=True)
    assert [peer.name for peer in found] == ["persistence", "ARX"]
    assert [one.name for one in absent] == ["statsmodels VAR"]
    u, y = second_order(260, 0.05, 3)
    past, came = Window(np.zeros(200), y[:200], u[:200]), Window(np.zeros(60), y[200:], u[200:], first=200)
    marked = [
        Marked("s", 199, 30.0, p.name, marks(p.forecast(past, came.input), came, 30.0, Lag))
        for p in (OutputPersistence(Lag), InputArx(Lag))
    ]
    assert all(one.marks.input is None for one in marked)
    assert all(one.marks.error == one.marks.output.rms for one in marked)
    for card in cards(marked):
        assert np.isnan([card.end_input, card.coverage_input, card.width_input]).all()
        assert np.isfinite([card.median, card.end_output, card.score]).all()
